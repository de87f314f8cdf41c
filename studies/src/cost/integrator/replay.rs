//! A whole flight, integrated anew.
//!
//! The scene `steps` is flown in closed loop; between its take-off and its landing the commands to the rotors
//! are written down, and the truth at the start. From there every method integrates the same motion under the
//! same commands: 16 s with doublets of 30° in roll and in pitch and a yaw pulse. The equations are written
//! out here once more, apart from [`sim_host::dynamics`]: a test holds the two against each other.
//!
//! The commands change every millisecond, and with them the rotors' accelerations: a step can be no longer,
//! and an adaptive method has to begin anew at each.

use flight_core::geometry::{Quaternion, Vec3, vec3};

use super::methods::{Fixed, Motion, dormand_prince};
use input::InputError;
use sim_host::dynamics::{GRAVITY, State, VehicleParams};
use sim_host::flight::{Flight, Observer, STEP_US, StepView};
use sim_host::scene::Scene;

/// The scene, and the part of it that is integrated, s.
const SCENE: &str = "steps";
const FROM_S: f64 = 13.0;
const TO_S: f64 = 29.0;
/// Time between two commands, s.
pub const INTERVAL_S: f64 = STEP_US as f64 * 1e-6;
/// Intervals between two looks at the error: a second.
const LOOK: usize = 1000;

/// What the two references take: tolerance of Dormand and Prince, steps of RKMK4 in a millisecond.
pub const REFERENCE_TOLERANCE: f64 = 1e-13;
pub const REFERENCE_STEPS: u32 = 8;

/// The flight's commands, and where it was when they began.
pub struct Replay {
    params: VehicleParams,
    drag: Vec3<f64>,
    tau_s: f64,
    start: State,
    rotors: [f64; 4],
    commands: Vec<[f64; 4]>,
    /// Where the vehicle was in the flight itself, second by second.
    pub flown: Vec<State>,
}

struct Writer {
    max_rad_s: f64,
    replay: Replay,
    steps: usize,
}

impl Observer for Writer {
    fn step(&mut self, view: &StepView) {
        let at_s = view.time_us as f64 * 1e-6;
        if !(FROM_S - 1e-9..TO_S - 1e-9).contains(&at_s) {
            // The step behind the last ends the last second.
            if self.steps > 0 && self.replay.flown.len() < self.steps / LOOK {
                self.replay.flown.push(*view.truth);
            }
            return;
        }
        if self.steps == 0 {
            self.replay.start = *view.truth;
            self.replay.rotors = view.rotors_rad_s;
        } else if self.steps.is_multiple_of(LOOK) {
            self.replay.flown.push(*view.truth);
        }
        let speed = |us: f32| self.max_rad_s * ((f64::from(us) - 1000.0) * 1e-3).clamp(0.0, 1.0);
        self.replay.commands.push(view.output.pulses_us.map(speed));
        self.steps += 1;
    }
}

impl Replay {
    /// Flies the scene and writes it down.
    ///
    /// # Errors
    /// The scene is not what this file takes it for.
    pub fn fly() -> Result<Self, InputError> {
        let scene = Scene::load(SCENE)?;
        let mut writer = Writer {
            max_rad_s: scene.vehicle.max_rad_s,
            replay: Self {
                params: scene.vehicle,
                drag: scene.vehicle.drag_kg_per_s,
                tau_s: scene.vehicle.lag_s,
                start: State {
                    position: Vec3::ZERO,
                    velocity: Vec3::ZERO,
                    attitude: Quaternion::IDENTITY,
                    rates: Vec3::ZERO,
                },
                rotors: [0.0; 4],
                commands: Vec::new(),
                flown: Vec::new(),
            },
            steps: 0,
        };
        Flight::new(&scene, scene.seed).run(&mut writer);
        Ok(writer.replay)
    }

    /// Seconds that are integrated.
    pub fn seconds(&self) -> f64 {
        self.commands.len() as f64 * INTERVAL_S
    }

    /// Goes through the intervals, each with its own zero of time at its start, and returns the state at the end
    /// of each second.
    fn through(&self, mut advance: impl FnMut(&Interval, &State) -> State) -> Vec<State> {
        let (mut state, mut rotors) = (self.start, self.rotors);
        let mut looks = Vec::with_capacity(self.commands.len() / LOOK);
        for (k, &wanted) in self.commands.iter().enumerate() {
            let interval = Interval { replay: self, rotors, wanted };
            state = advance(&interval, &state);
            rotors = interval.rotors_at(INTERVAL_S);
            if (k + 1).is_multiple_of(LOOK) {
                looks.push(state);
            }
        }
        looks
    }

    /// With so many steps of a fixed method in each interval.
    pub fn fixed(&self, method: Fixed, steps: u32) -> Vec<State> {
        let h = INTERVAL_S / f64::from(steps);
        self.through(|interval, state| {
            (0..steps).fold(*state, |state, k| method.step(interval, f64::from(k) * h, &state, h))
        })
    }

    /// With Dormand and Prince's method, and how many evaluations it took.
    pub fn adaptive(&self, tolerance: f64) -> (Vec<State>, u32) {
        let mut evaluations = 0;
        let looks = self.through(|interval, state| {
            let (state, count) = dormand_prince(interval, (0.0, INTERVAL_S), state, tolerance, INTERVAL_S);
            evaluations += count;
            state
        });
        (looks, evaluations)
    }
}

/// The motion between two commands.
struct Interval<'a> {
    replay: &'a Replay,
    rotors: [f64; 4],
    wanted: [f64; 4],
}

impl Interval<'_> {
    fn rotors_at(&self, t_s: f64) -> [f64; 4] {
        let left = libm::exp(-t_s / self.replay.tau_s);
        std::array::from_fn(|i| self.wanted[i] + (self.rotors[i] - self.wanted[i]) * left)
    }
}

impl Motion for Interval<'_> {
    /// Eqs 8-14 with body rates, as the page on the paper has them: signs of eqs 4-7.
    #[inline]
    fn accelerations(&self, t_s: f64, state: &State) -> (Vec3<f64>, Vec3<f64>) {
        let Replay { params: p, drag, .. } = self.replay;
        let [o1, o2, o3, o4] = self.rotors_at(t_s);
        let [f1, f2, f3, f4] = [o1, o2, o3, o4].map(|speed| p.thrust_coefficient * speed * speed);
        let lever = p.right_m;
        let reaction = p.torque_coefficient / p.thrust_coefficient;
        let w = state.rates;
        let spin = p.rotor_inertia_kg_m2 * (o1 - o2 + o3 - o4);
        let gyroscopic = vec3(w.y * spin, -w.x * spin, 0.0);
        let torque =
            vec3(lever * (f1 - f2 - f3 + f4), lever * (f1 + f2 - f3 - f4), reaction * (f1 - f2 + f3 - f4))
                + gyroscopic
                - w.cross(w.scale_by(p.inertia_kg_m2));
        let thrust = state.attitude.rotate(vec3(0.0, 0.0, -(f1 + f2 + f3 + f4)));
        let force = thrust - drag.scale_by(state.velocity);
        let Vec3 { x, y, z } = p.inertia_kg_m2;
        let linear = force * (1.0 / p.mass_kg) + vec3(0.0, 0.0, GRAVITY);
        (linear, vec3(torque.x / x, torque.y / y, torque.z / z))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sim_host::attitude_error::AttitudeError;

    fn apart(a: &[State], b: &[State]) -> (f64, f64) {
        assert_eq!(a.len(), b.len());
        a.iter().zip(b).fold((0.0, 0.0), |(angle, place), (a, b)| {
            let error = AttitudeError::between(a.attitude, b.attitude).total_rad;
            (f64::max(angle, error), f64::max(place, (a.position - b.position).norm()))
        })
    }

    #[test]
    fn the_equations_are_the_vehicles() {
        let replay = Replay::fly().unwrap();
        assert_eq!((replay.commands.len(), replay.flown.len()), (16_000, 16));
        // The same method with the same step: what is left is rounding, and the rotors' lag in another order.
        let (angle, place) = apart(&replay.fixed(Fixed::Rk4, 1), &replay.flown);
        assert!(angle < 1e-10 && place < 1e-9, "{angle} rad, {place} m");
    }

    #[test]
    fn the_reference_is_confirmed_by_another_method() {
        let replay = Replay::fly().unwrap();
        let (reference, _) = replay.adaptive(REFERENCE_TOLERANCE);
        let (angle, place) = apart(&replay.fixed(Fixed::Rkmk4, REFERENCE_STEPS), &reference);
        assert!(angle < 1e-11 && place < 1e-10, "{angle} rad, {place} m");
    }
}
