//! The attitude controller: an angle loop around a rate loop, from stick positions to torques.
//!
//! ```text
//!  sticks ──► down setpoint ──► tilt error ────┐
//!         ──► heading target ─► heading error ─┴─► rate setpoint ──► PID ──► angular acceleration ──► · I = torque
//! ```
//!
//! The outer loop uses the direction of down in body axes instead of Euler angles, so that it has no singularity and
//! does not mix heading errors into tilt. The gains of the inner loop are angular acceleration per unit of rate
//! error; the inertia turns them into torque, so that the same gains fit a larger vehicle.

use crate::arithmetic::{max, min, sin_cos, sqrt, wrap_pi};
use crate::geometry::{Vec3, vec3};
use crate::mixer::Saturation;
use crate::range::{ConfigError, check};
use crate::rc::{FlightMode, Gesture, Sticks};

/// Gains and limits of the cascade.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ControlParams {
    /// Roll or pitch angle at full stick in [`FlightMode::Angle`], rad: 0.01 to 1.4.
    pub max_tilt_rad: f32,
    /// Roll or pitch rate at full stick in [`FlightMode::Rate`], rad/s: 0.01 to 35.
    pub max_stick_rate_rad_s: f32,
    /// Yaw rate at full stick, rad/s: 0.01 to 35.
    pub max_yaw_rate_rad_s: f32,
    /// Largest tilt rate that the angle loop commands, rad/s: 0.01 to 35.
    pub max_tilt_rate_rad_s: f32,
    /// Angle loop: rate per tilt error, 1/s: 0 to 100.
    pub tilt_p: f32,
    /// Angle loop: rate per heading error, 1/s: 0 to 100.
    pub heading_p: f32,
    /// Rate loop, per axis: angular acceleration per rate error, 1/s: 0 to 1,000.
    pub rate_p: Vec3<f32>,
    /// Rate loop, per axis: angular acceleration per integrated rate error, 1/s²: 0 to 10,000.
    pub rate_i: Vec3<f32>,
    /// Rate loop, per axis: angular acceleration per measured angular acceleration, dimensionless: 0 to 10.
    pub rate_d: Vec3<f32>,
    /// Largest angular acceleration of the integrator, per axis, rad/s²: 0 to 1,000.
    pub max_integral_rad_s2: Vec3<f32>,
    /// Throttle from which the vehicle counts as airborne, 0 to 0.5: by default a fifth of the hover throttle. Before
    /// the throttle first reaches this value the rotors idle: a controller that works against the ground winds up and
    /// tips the vehicle over.
    pub begin_throttle: f32,
}

impl ControlParams {
    /// Gains for OS4 with a motor time constant of 50 ms and a 30 Hz prefilter.
    ///
    /// With the loop opened at the rotors, the open-loop transfer function is (P + I/s + D s + K (P + I/s)/s) F(s)
    /// M(s)/s, with M = 1/(1 + 0.05 s) the lag of the rotors, F the prefilter (7.5 ms of delay at low frequency) and
    /// K the gain of the angle loop. D/P = 40 ms compensates the lag of M. At P = 25 /s the crossover is at 20 rad/s
    /// with a phase margin of 61°, and a 30° step overshoots by 3 %.
    pub const OS4: Self = Self {
        max_tilt_rad: core::f32::consts::FRAC_PI_4,
        max_stick_rate_rad_s: core::f32::consts::PI,
        max_yaw_rate_rad_s: core::f32::consts::FRAC_PI_2,
        max_tilt_rate_rad_s: 4.5,
        tilt_p: 5.5,
        heading_p: 2.5,
        rate_p: vec3(25.0, 25.0, 6.0),
        rate_i: vec3(15.0, 15.0, 4.0),
        rate_d: vec3(1.0, 1.0, 0.0),
        max_integral_rad_s2: vec3(20.0, 20.0, 4.0),
        begin_throttle: 0.1,
    };

    fn validate(&self) -> Result<(), ConfigError> {
        check("control.max_tilt_rad", self.max_tilt_rad, 0.01, 1.4)?;
        check("control.max_stick_rate_rad_s", self.max_stick_rate_rad_s, 0.01, 35.0)?;
        check("control.max_yaw_rate_rad_s", self.max_yaw_rate_rad_s, 0.01, 35.0)?;
        check("control.max_tilt_rate_rad_s", self.max_tilt_rate_rad_s, 0.01, 35.0)?;
        check("control.tilt_p", self.tilt_p, 0.0, 100.0)?;
        check("control.heading_p", self.heading_p, 0.0, 100.0)?;
        check("control.begin_throttle", self.begin_throttle, 0.0, 0.5)?;
        for (field, gains, maximum) in [
            ("control.rate_p", self.rate_p, 1.0e3),
            ("control.rate_i", self.rate_i, 1.0e4),
            ("control.rate_d", self.rate_d, 10.0),
            ("control.max_integral_rad_s2", self.max_integral_rad_s2, 1.0e3),
        ] {
            for gain in <[f32; 3]>::from(gains) {
                check(field, gain, 0.0, maximum)?;
            }
        }
        Ok(())
    }
}

/// Yaw stick deflection up to which the heading is held.
const YAW_DEADBAND: f32 = 0.02;

/// The setpoint of the cascade.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Setpoint {
    rotation: Rotation,
    throttle: f32,
    /// Whether the throttle has reached `begin_throttle`.
    takes_off: bool,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Rotation {
    /// Attitude setpoint.
    Attitude {
        /// Direction of down in body axes at the commanded tilt, unit vector.
        down: Vec3<f32>,
        /// Commanded rate about the vertical, rad/s, if the yaw stick is outside its deadband; otherwise the heading
        /// is held.
        yaw_rate: Option<f32>,
    },
    /// Setpoint of the body rates, rad/s.
    Rates(Vec3<f32>),
}

impl Setpoint {
    const LEVEL: Self = Self {
        rotation: Rotation::Attitude { down: Vec3::Z, yaw_rate: None },
        throttle: 0.0,
        takes_off: false,
    };
}

/// The attitude controller: parameters, setpoint, and state of the loops.
#[derive(Clone, Copy, Debug)]
pub struct Controller {
    params: ControlParams,
    inertia_kg_m2: Vec3<f32>,
    setpoint: Setpoint,
    heading_target: f32,
    integral: Vec3<f32>,
    last_rates: Vec3<f32>,
    flying: bool,
}

impl Controller {
    /// Creates a controller for a vehicle with the inertia I_xx, I_yy, I_zz (kg·m²).
    ///
    /// # Errors
    /// Returns the first gain or limit outside its range, or an inertia outside 10⁻⁹ to 10⁶ kg·m².
    pub fn new(params: &ControlParams, inertia_kg_m2: Vec3<f32>) -> Result<Self, ConfigError> {
        params.validate()?;
        for axis in <[f32; 3]>::from(inertia_kg_m2) {
            check("airframe.inertia_kg_m2", axis, 1.0e-9, 1.0e6)?;
        }
        Ok(Self {
            params: *params,
            inertia_kg_m2,
            setpoint: Setpoint::LEVEL,
            heading_target: 0.0,
            integral: Vec3::ZERO,
            last_rates: Vec3::ZERO,
            flying: false,
        })
    }

    /// Sets new stick positions. This happens 50 to 150 times per second, so the sines are computed here and not in
    /// [`Self::step`].
    pub fn set_sticks(&mut self, sticks: &Sticks, mode: FlightMode) {
        let p = &self.params;
        // A full yaw stick at low throttle is a request to arm or disarm, not to turn.
        let yaw_commanded = sticks.yaw.abs() > YAW_DEADBAND && sticks.gesture() == Gesture::None;
        let yaw_rate = yaw_commanded.then_some(sticks.yaw * p.max_yaw_rate_rad_s);
        let rotation = match mode {
            FlightMode::Angle => {
                let (sin_roll, cos_roll) = sin_cos(sticks.roll * p.max_tilt_rad);
                let (sin_pitch, cos_pitch) = sin_cos(-sticks.pitch * p.max_tilt_rad);
                Rotation::Attitude {
                    down: vec3(-sin_pitch, sin_roll * cos_pitch, cos_roll * cos_pitch),
                    yaw_rate,
                }
            }
            FlightMode::Rate => Rotation::Rates(vec3(
                sticks.roll * p.max_stick_rate_rad_s,
                -sticks.pitch * p.max_stick_rate_rad_s,
                yaw_rate.unwrap_or(0.0),
            )),
        };
        self.setpoint = Setpoint { rotation, ..self.level_at(sticks.throttle) };
    }

    /// Sets the setpoint to level, held heading and this throttle (0 to 1), independent of the sticks.
    pub fn set_level(&mut self, throttle: f32) {
        self.setpoint = self.level_at(throttle);
    }

    fn level_at(&self, throttle: f32) -> Setpoint {
        // The comparison is false for a NaN throttle: the controller then stays active.
        let below = throttle < self.params.begin_throttle;
        Setpoint { throttle, takes_off: !below, ..Setpoint::LEVEL }
    }

    /// Returns the throttle of the setpoint, 0 to 1.
    #[inline(always)]
    pub fn throttle(&self) -> f32 {
        self.setpoint.throttle
    }

    /// Returns whether the controller holds a tilt: in angle mode, after take-off.
    #[inline(always)]
    pub fn holds_tilt(&self) -> bool {
        self.flying && matches!(self.setpoint.rotation, Rotation::Attitude { .. })
    }

    /// Resets the integrator, the derivative and the heading target to the present rates (rad/s) and heading (rad).
    /// Call it in every step in which the motors are stopped.
    pub fn reset(&mut self, rates: Vec3<f32>, heading: f32) {
        self.integral = Vec3::ZERO;
        self.last_rates = rates;
        self.heading_target = heading;
        self.flying = false;
    }

    /// Runs one step. Returns the torque about the body axes x, y, z, N·m, that moves the vehicle towards the
    /// setpoint.
    ///
    /// `down` is the estimated direction of down in body axes (unit vector), `heading` the estimated heading (rad),
    /// `rates` the body rates (rad/s), `saturation` what the mixer reduced in the last step, and `dt_s` the time
    /// since the last step (s). The integrator of a saturated axis is frozen, to prevent windup.
    #[inline]
    pub fn step(
        &mut self,
        down: Vec3<f32>,
        heading: f32,
        rates: Vec3<f32>,
        saturation: Saturation,
        dt_s: f32,
    ) -> Vec3<f32> {
        if !self.flying {
            if !self.setpoint.takes_off {
                self.reset(rates, heading);
                return Vec3::ZERO;
            }
            self.flying = true;
        }
        let error = self.rate_setpoint(down, heading) - rates;
        let p = &self.params;

        let slope = (rates - self.last_rates) * if dt_s > 0.0 { 1.0 / dt_s } else { 0.0 };
        self.last_rates = rates;

        let integration_s = vec3(
            if saturation.roll_pitch { 0.0 } else { dt_s },
            if saturation.roll_pitch { 0.0 } else { dt_s },
            if saturation.yaw { 0.0 } else { dt_s },
        );
        let integral = self.integral + p.rate_i.scale_by(error).scale_by(integration_s);
        self.integral = limit(integral, p.max_integral_rad_s2);

        let acceleration = p.rate_p.scale_by(error) + self.integral - p.rate_d.scale_by(slope);
        acceleration.scale_by(self.inertia_kg_m2)
    }

    /// Returns the commanded body rates, rad/s: from the sticks directly, or from the angle loop.
    #[inline(always)]
    fn rate_setpoint(&mut self, down: Vec3<f32>, heading: f32) -> Vec3<f32> {
        let p = &self.params;
        let (wanted, yaw_rate) = match self.setpoint.rotation {
            Rotation::Attitude { down, yaw_rate } => (down, yaw_rate),
            Rotation::Rates(rates) => {
                // After a change back to angle mode the present heading is held.
                self.heading_target = heading;
                return rates;
            }
        };
        // A body rate `ω` moves the direction of down in body axes at `−ω × down`. So a rate along `wanted × down`
        // reduces the angle `a` between `wanted` and `down`. The length of `wanted × down` is `sin a`, which falls
        // above 90°: the larger the error, the slower the vehicle would turn back. Divided by `(1 + cos a)/2` the
        // length is `2 tan(a/2)`, which rises up to 180° and nearly equals `a` for small angles.
        let axis = wanted.cross(down);
        let one_plus_cos = 1.0 + wanted.dot(down);
        let error = if one_plus_cos > 1.0e-3 {
            axis * (2.0 / one_plus_cos)
        } else {
            // Upside down every horizontal axis is equivalent; roll has the most authority.
            vec3(core::f32::consts::PI, 0.0, 0.0)
        };
        let mut tilt_rate = error * p.tilt_p;
        let square = tilt_rate.dot(tilt_rate);
        if square > p.max_tilt_rate_rad_s * p.max_tilt_rate_rad_s {
            tilt_rate = tilt_rate * (p.max_tilt_rate_rad_s / sqrt(square));
        }
        let yaw_rate = match yaw_rate {
            Some(rate) => {
                self.heading_target = heading;
                rate
            }
            None => min(
                max(p.heading_p * wrap_pi(self.heading_target - heading), -p.max_yaw_rate_rad_s),
                p.max_yaw_rate_rad_s,
            ),
        };
        // This is the rotation about the vertical, in body axes.
        tilt_rate + down * yaw_rate
    }
}

fn limit(v: Vec3<f32>, bound: Vec3<f32>) -> Vec3<f32> {
    vec3(min(max(v.x, -bound.x), bound.x), min(max(v.y, -bound.y), bound.y), min(max(v.z, -bound.z), bound.z))
}

#[cfg(test)]
mod tests;
