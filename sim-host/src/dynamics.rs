//! The true motion of the quadrotor: eqs 8-14 as a rigid body.
//!
//! The paper's eqs 8-10 equate the accelerations of Euler angles with those of the body, which holds only for
//! small angles. Its eqs 11-12 have the opposite sign of yaw from eqs 7-10 and 13. Here the rotation follows Euler's
//! equations with a quaternion, and the rotation matrix gives the direction of the thrust:
//!
//! ```text
//!  m a = R (0, 0, −U1) + m g + ground + effects     a: north, east, down
//!  I ω̇ = (l U2, l U3, U4) − ω × I ω + ground + effects
//!  q̇   = ½ q ⊗ (0, ω)
//!  Ω̇   = (Ω_wanted − Ω)/τ, or Ω = Ω_wanted
//! ```
//!
//! Everything else, such as drag and the rotors' momentum and lag, is an effect that a scene names: see
//! [`crate::effects::vehicle`]. The ground is always present unless the vehicle is on the ball joint.
//!
//! A step is a classical 4th-order Runge-Kutta step in position, velocity, attitude and rate. The rotors' lag does not
//! depend on them, so the rotor speeds inside a step are exact for any τ. All numbers are f64.

mod ground;

use flight_core::geometry::{Mat3, Quaternion, Vec3, vec3};

pub use ground::Ground;

use crate::effects::vehicle::{
    Body, BodyEffect, CommandEffect, Lag, Load, Point, Stage, ThrustEffect, VehicleEffect, WindEffect,
};
use crate::effects::{OPTIONAL_EFFECTS, Snapshot};

pub use vehicle::{GRAVITY, VehicleParams};

pub use crate::state::State;

/// The mounting of the vehicle in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Mount {
    /// Free, above a ground plane.
    Free(Ground),
    /// A test stand: the centre of gravity is fixed, and the body turns about it.
    BallJoint,
}

/// Time derivative of a [`State`].
#[derive(Clone, Copy, Debug)]
struct Slope {
    velocity: Vec3<f64>,
    acceleration: Vec3<f64>,
    attitude: Quaternion<f64>,
    angular_acceleration: Vec3<f64>,
}

impl Slope {
    /// Returns the state after a time `h`, s, from `state`, at this constant slope.
    fn extrapolate(&self, state: &State, h: f64) -> State {
        let turned = Quaternion {
            w: state.attitude.w + self.attitude.w * h,
            v: state.attitude.v + self.attitude.v * h,
        };
        State {
            position: state.position + self.velocity * h,
            velocity: state.velocity + self.acceleration * h,
            attitude: turned,
            rates: state.rates + self.angular_acceleration * h,
        }
    }
}

/// The vehicle and its state.
pub struct Vehicle {
    params: VehicleParams,
    mount: Mount,
    commands: Vec<Box<dyn CommandEffect>>,
    lag: Option<Lag>,
    winds: Vec<Box<dyn WindEffect>>,
    thrusts: Vec<Box<dyn ThrustEffect>>,
    bodies: Vec<Body>,
    step_s: f64,
    /// Steps so far. Time is this count times `step_s`, because a sum of 86.4 million times 0.001 s is 26 µs less than
    /// a day.
    steps: u64,
    state: State,
    rotors: [f64; 4],
    wanted: [f64; 4],
    /// True if there is an effect on thrust or body.
    has_load_effects: bool,
    /// Velocity of the air in this step, m/s, north, east, down.
    wind: Vec3<f64>,
    /// Slope at the present state, for the sensors and the next step.
    slope: Slope,
    /// True if the loads jump with a command: see [`BodyEffect::follows_command_at_once`].
    jumps: bool,
    /// True if `slope` must be computed again before the next step.
    stale: bool,
    /// ±d/b: yaw torque of the front left rotor per thrust, m.
    torque_per_thrust: f64,
    per_mass: f64,
    per_inertia: Vec3<f64>,
}

impl Vehicle {
    /// Creates a vehicle at rest: on the ground, or level on its ball joint. `step_s` is the length of a step.
    pub fn at_rest(
        params: VehicleParams,
        mount: Mount,
        effects: Vec<(&'static str, VehicleEffect)>,
        step_s: f64,
    ) -> Self {
        let down = match mount {
            Mount::Free(ground) => ground.rest_position_m(&params),
            Mount::BallJoint => 0.0,
        };
        let mut vehicle = Self {
            params,
            mount,
            commands: Vec::new(),
            lag: None,
            winds: Vec::new(),
            thrusts: Vec::new(),
            bodies: Vec::new(),
            step_s,
            steps: 0,
            state: State {
                position: vec3(0.0, 0.0, down),
                velocity: Vec3::ZERO,
                attitude: Quaternion::IDENTITY,
                rates: Vec3::ZERO,
            },
            rotors: [0.0; 4],
            wanted: [0.0; 4],
            has_load_effects: false,
            wind: Vec3::ZERO,
            slope: Slope {
                velocity: Vec3::ZERO,
                acceleration: Vec3::ZERO,
                attitude: Quaternion::new(0.0, 0.0, 0.0, 0.0),
                angular_acceleration: Vec3::ZERO,
            },
            jumps: false,
            stale: false,
            torque_per_thrust: f64::from(params.spin.sign()) * params.torque_coefficient
                / params.thrust_coefficient,
            per_mass: 1.0 / params.mass_kg,
            per_inertia: vec3(
                1.0 / params.inertia_kg_m2.x,
                1.0 / params.inertia_kg_m2.y,
                1.0 / params.inertia_kg_m2.z,
            ),
        };
        for (_, effect) in effects {
            match effect {
                VehicleEffect::Command(effect) => vehicle.commands.push(effect),
                VehicleEffect::Lag(lag) => vehicle.lag = Some(lag),
                VehicleEffect::Wind(effect) => vehicle.winds.push(effect),
                VehicleEffect::Thrust(effect) => vehicle.thrusts.push(effect),
                VehicleEffect::Body(effect) => vehicle.bodies.push(effect),
            }
        }
        vehicle.has_load_effects = !(vehicle.thrusts.is_empty() && vehicle.bodies.is_empty());
        vehicle.jumps = vehicle.bodies.iter().any(|effect| effect.follows_command_at_once());
        vehicle.update_wind();
        vehicle.slope = vehicle.slope_now();
        vehicle
    }

    /// Returns the present state.
    #[inline]
    pub fn state(&self) -> &State {
        &self.state
    }

    /// Sets the state, for tests.
    pub fn set_state(&mut self, state: State, rotors: [f64; 4]) {
        self.state = state;
        self.rotors = rotors;
        self.slope = self.slope_now();
    }

    /// Returns the rotor speeds, rad/s.
    #[inline]
    pub fn rotors(&self) -> [f64; 4] {
        self.rotors
    }

    /// Returns the specific force f = a − g in body axes, m/s²: the present reading of a perfect accelerometer at the
    /// centre of gravity.
    #[inline]
    pub fn specific_force(&self) -> Vec3<f64> {
        let f = self.slope.acceleration - vec3(0.0, 0.0, GRAVITY);
        self.state.attitude.to_matrix().transpose() * f
    }

    /// Returns the acceleration of the centre of gravity, north, east, down, m/s².
    pub fn acceleration(&self) -> Vec3<f64> {
        self.slope.acceleration
    }

    /// Returns the angular acceleration in body axes, rad/s².
    pub fn angular_acceleration(&self) -> Vec3<f64> {
        self.slope.angular_acceleration
    }

    /// Returns true if a foot touches the ground.
    pub fn touches_ground(&self) -> bool {
        match self.mount {
            Mount::Free(ground) => ground.touches(&self.params, &self.state),
            Mount::BallJoint => false,
        }
    }

    /// Returns true if the vehicle is on its test stand, so that its position is fixed.
    #[inline]
    pub fn is_held(&self) -> bool {
        self.mount == Mount::BallJoint
    }

    /// Returns the terminal voltage of the battery, V, if the scene simulates one.
    #[inline(always)]
    pub fn battery_v(&self) -> Option<f64> {
        self.commands.iter().find_map(|effect| effect.battery_v())
    }

    /// Returns the present truth, for sensors and effects.
    #[inline(always)]
    pub fn snapshot(&self) -> Snapshot<'_> {
        Snapshot {
            time_s: self.steps as f64 * self.step_s,
            state: &self.state,
            specific_force: self.specific_force(),
            angular_acceleration: self.slope.angular_acceleration,
            rotors: self.rotors,
        }
    }

    /// Sets the commanded rotor speeds, rad/s.
    #[inline]
    pub fn command(&mut self, mut wanted: [f64; 4]) {
        if OPTIONAL_EFFECTS && !self.commands.is_empty() {
            let mut effects = std::mem::take(&mut self.commands);
            let at = self.snapshot();
            effects.iter_mut().for_each(|effect| effect.apply(&mut wanted, &at));
            self.commands = effects;
        }
        self.wanted = wanted;
        if !OPTIONAL_EFFECTS || self.lag.is_none() {
            self.rotors = wanted;
            self.slope = self.slope_now();
        }
        self.stale |= OPTIONAL_EFFECTS && self.jumps;
    }

    /// Advances the vehicle by one step.
    #[inline]
    pub fn advance(&mut self) {
        if OPTIONAL_EFFECTS && self.stale {
            self.stale = false;
            self.slope = self.slope_now();
        }
        let h = self.step_s;
        let middle = self.rotors_at(Point::Middle);
        let end = self.rotors_at(Point::End);
        let at = self.state;

        let k1 = self.slope;
        let k2 = self.slope_at(&k1.extrapolate(&at, 0.5 * h), &middle);
        let k3 = self.slope_at(&k2.extrapolate(&at, 0.5 * h), &middle);
        let k4 = self.slope_at(&k3.extrapolate(&at, h), &end);

        let sixth = h / 6.0;
        let mean = |f: fn(&Slope) -> Vec3<f64>| (f(&k1) + (f(&k2) + f(&k3)) * 2.0 + f(&k4)) * sixth;
        let turn_w = (k1.attitude.w + (k2.attitude.w + k3.attitude.w) * 2.0 + k4.attitude.w) * sixth;
        let attitude =
            Quaternion { w: at.attitude.w + turn_w, v: at.attitude.v + mean(|k| k.attitude.v) }.normalized();
        self.state = State {
            position: at.position + mean(|k| k.velocity),
            velocity: at.velocity + mean(|k| k.acceleration),
            attitude,
            rates: at.rates + mean(|k| k.angular_acceleration),
        };
        self.rotors = end;
        self.steps += 1;
        if OPTIONAL_EFFECTS && !self.winds.is_empty() {
            self.update_wind();
        }
        self.slope = self.slope_at(&self.state, &end);
    }

    /// Updates the velocity of the air. The caller must compute the slope again afterwards.
    fn update_wind(&mut self) {
        let mut effects = std::mem::take(&mut self.winds);
        let at = self.snapshot();
        self.wind = effects.iter_mut().fold(Vec3::ZERO, |sum, effect| sum + effect.velocity(&at));
        self.winds = effects;
    }

    #[inline(always)]
    fn rotors_at(&self, point: Point) -> [f64; 4] {
        let mut rotors = self.rotors;
        if let Some(lag) = &self.lag
            && OPTIONAL_EFFECTS
        {
            for (rotor, wanted) in rotors.iter_mut().zip(self.wanted) {
                *rotor = lag.at(point, *rotor, wanted);
            }
        }
        rotors
    }

    fn slope_now(&self) -> Slope {
        self.slope_at(&self.state, &self.rotors)
    }

    #[inline(always)]
    fn slope_at(&self, state: &State, rotors: &[f64; 4]) -> Slope {
        let p = &self.params;
        let matrix = state.attitude.to_matrix();
        let thrusts = rotors.map(|speed| p.thrust_coefficient * (speed * speed));
        let mut load = if OPTIONAL_EFFECTS && self.has_load_effects {
            self.load_with_effects(state, &matrix, rotors, thrusts)
        } else {
            self.load(state, &matrix, thrusts, thrusts)
        };
        let acceleration = match &self.mount {
            Mount::BallJoint => Vec3::ZERO,
            Mount::Free(ground) => {
                if ground.is_near(p, state) {
                    let contact = ground.contact(p, state, &matrix);
                    load.force += contact.force;
                    load.torque += contact.torque;
                }
                load.force * self.per_mass + vec3(0.0, 0.0, GRAVITY)
            }
        };
        let Vec3 { x: p_rate, y: q_rate, z: r_rate } = state.rates * 0.5;
        let [w, x, y, z] = state.attitude.to_array();
        Slope {
            velocity: state.velocity,
            acceleration,
            attitude: Quaternion::new(
                -x * p_rate - y * q_rate - z * r_rate,
                w * p_rate + y * r_rate - z * q_rate,
                w * q_rate + z * p_rate - x * r_rate,
                w * r_rate + x * q_rate - y * p_rate,
            ),
            angular_acceleration: load.torque.scale_by(self.per_inertia),
        }
    }
}

impl Vehicle {
    /// Returns the load of rotors with these thrusts, with the gyroscopic torque of the body. The reaction torque comes
    /// from the drag of the propellers, so it is proportional to the thrusts without effects (`unchanged`).
    #[inline(always)]
    fn load(&self, state: &State, matrix: &Mat3<f64>, thrusts: [f64; 4], unchanged: [f64; 4]) -> Load {
        let ([t1, t2, t3, t4], [q1, q2, q3, q4]) = (thrusts, unchanged);
        Load {
            force: thrust_direction(matrix) * -(t1 + t2 + t3 + t4),
            torque: vec3(
                self.params.right_m * (t1 - t2 - t3 + t4),
                self.params.forward_m * (t1 + t2 - t3 - t4),
                self.torque_per_thrust * (q1 - q2 + q3 - q4),
            ) - state.rates.cross(state.rates.scale_by(self.params.inertia_kg_m2)),
        }
    }

    /// Returns the load with the effects of the scene. It is a separate function, so that a flight without effects does
    /// not set up its stack frame.
    #[inline(never)]
    fn load_with_effects(
        &self,
        state: &State,
        matrix: &Mat3<f64>,
        rotors: &[f64; 4],
        unchanged: [f64; 4],
    ) -> Load {
        let mut rotor_accelerations = [0.0; 4];
        if let Some(lag) = &self.lag {
            for (i, acceleration) in rotor_accelerations.iter_mut().enumerate() {
                *acceleration = lag.acceleration(rotors[i], self.wanted[i]);
            }
        }
        let at = Stage {
            state,
            matrix,
            rotors: *rotors,
            rotor_accelerations,
            airspeed: state.velocity - self.wind,
        };
        let mut thrusts = unchanged;
        for effect in &self.thrusts {
            effect.apply(&mut thrusts, &at);
        }
        let mut load = self.load(state, matrix, thrusts, unchanged);
        for effect in &self.bodies {
            effect.apply(&mut load, &thrusts, &at);
        }
        load
    }
}

/// Returns the body's z axis in world axes. Thrust acts in the opposite direction.
#[inline(always)]
fn thrust_direction(matrix: &Mat3<f64>) -> Vec3<f64> {
    vec3(matrix[0].z, matrix[1].z, matrix[2].z)
}

#[cfg(test)]
mod tests;
