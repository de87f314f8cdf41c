//! Angle → rate cascade: from the sticks to torques.
//!
//! ```text
//!  sticks ──► down setpoint ──► tilt error ─┐
//!         ──► heading target ─► yaw error ──┴─► rate setpoint ──► P I D ──► angular acceleration ──► · I = torque
//! ```
//!
//! The outer loop works on the direction of down in body axes, not on Euler angles, so that it has no
//! singularity and does not mix heading errors into tilt. The inner loop's gains are in angular acceleration
//! per unit of rate error, and the inertia turns them into torque: the same gains fit a larger vehicle.

use crate::arithmetic::{max, min, sin_cos, sqrt, wrap_pi};
use crate::geometry::{Vec3, vec3};
use crate::mixer::Saturation;
use crate::range::{ConfigError, check};
use crate::rc::{FlightMode, Gesture, Sticks};

/// Gains and limits of the cascade.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ControlParams {
    /// Tilt at full stick, rad ([`FlightMode::Angle`]).
    pub max_tilt_rad: f32,
    /// Roll and pitch rate at full stick, rad/s ([`FlightMode::Rate`]).
    pub max_stick_rate_rad_s: f32,
    /// Yaw rate at full stick, rad/s.
    pub max_yaw_rate_rad_s: f32,
    /// Largest roll and pitch rate that the angle loop asks for, rad/s.
    pub max_tilt_rate_rad_s: f32,
    /// Angle loop: rate per tilt error, 1/s.
    pub tilt_p: f32,
    /// Angle loop: rate per heading error, 1/s.
    pub heading_p: f32,
    /// Rate loop, per axis: angular acceleration per rate error, 1/s.
    pub rate_p: Vec3<f32>,
    /// Rate loop, per axis: angular acceleration per integrated rate error, 1/s².
    pub rate_i: Vec3<f32>,
    /// Rate loop, per axis: angular acceleration per measured angular acceleration, dimensionless.
    pub rate_d: Vec3<f32>,
    /// Largest angular acceleration that the integrator may hold, per axis, rad/s².
    pub max_integral_rad_s2: Vec3<f32>,
    /// Throttle, 0 to 1, above which the vehicle is taken to have left the ground: a fifth of what it takes to hover.
    /// Below it, before the first time, the rotors idle: a controller that fights the ground winds up and tips the
    /// vehicle over.
    pub begin_throttle: f32,
}

impl ControlParams {
    /// For OS4 with 50 ms of motor lag behind a 30 Hz prefilter.
    ///
    /// Broken at the rotors, the loop is (P + I/s + D s + K (P + I/s)/s) F(s) M(s)/s, with M = 1/(1 + 0.05 s)
    /// the rotors' lag, F the prefilter (7.5 ms of delay at low frequency) and K the angle loop's gain. D/P of
    /// 40 ms leads what M lags. At P = 25 /s it crosses over at 20 rad/s with 61° of phase margin, and a 30°
    /// step overshoots by 3 %.
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

/// Stick deflection within which the pilot is taken to hold the heading.
const YAW_DEADBAND: f32 = 0.02;

/// What the cascade is to reach.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Setpoint {
    turn: Turn,
    throttle: f32,
    /// The throttle is where control begins, or above it.
    lifts: bool,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Turn {
    /// To an attitude.
    To {
        /// Down in body axes at the wanted tilt.
        down: Vec3<f32>,
        /// Wanted turn about the vertical, rad/s, when the stick is out of its deadband.
        yaw_rate: Option<f32>,
    },
    /// At body rates, rad/s.
    At(Vec3<f32>),
}

impl Setpoint {
    const LEVEL: Self =
        Self { turn: Turn::To { down: Vec3::Z, yaw_rate: None }, throttle: 0.0, lifts: false };
}

/// The cascade's state.
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
    /// A controller for a vehicle of this inertia.
    ///
    /// # Errors
    /// A gain or limit outside its range; an inertia that isn't positive.
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

    /// Takes new stick positions: 50 to 150 times a second, so the sines stand here, not in [`Self::step`].
    pub fn set_sticks(&mut self, sticks: &Sticks, mode: FlightMode) {
        let p = &self.params;
        // A full yaw stick at low throttle asks to arm or disarm, not to turn.
        let turns = sticks.yaw.abs() > YAW_DEADBAND && sticks.gesture() == Gesture::None;
        let yaw_rate = turns.then_some(sticks.yaw * p.max_yaw_rate_rad_s);
        let turn = match mode {
            FlightMode::Angle => {
                let (sin_roll, cos_roll) = sin_cos(sticks.roll * p.max_tilt_rad);
                let (sin_pitch, cos_pitch) = sin_cos(-sticks.pitch * p.max_tilt_rad);
                Turn::To { down: vec3(-sin_pitch, sin_roll * cos_pitch, cos_roll * cos_pitch), yaw_rate }
            }
            FlightMode::Rate => Turn::At(vec3(
                sticks.roll * p.max_stick_rate_rad_s,
                -sticks.pitch * p.max_stick_rate_rad_s,
                yaw_rate.unwrap_or(0.0),
            )),
        };
        self.setpoint = Setpoint { turn, ..self.level_at(sticks.throttle) };
    }

    /// Level, heading held, at this throttle (0 to 1), whatever the sticks last said.
    pub fn set_level(&mut self, throttle: f32) {
        self.setpoint = self.level_at(throttle);
    }

    fn level_at(&self, throttle: f32) -> Setpoint {
        // As a comparison that is false for a throttle that is no number: it lifted off, and control stays.
        let below = throttle < self.params.begin_throttle;
        Setpoint { throttle, lifts: !below, ..Setpoint::LEVEL }
    }

    /// The last throttle position, 0 to 1.
    #[inline(always)]
    pub fn throttle(&self) -> f32 {
        self.setpoint.throttle
    }

    /// Whether the vehicle is to be at a tilt: in angle mode, once it has taken off.
    #[inline(always)]
    pub fn holds_tilt(&self) -> bool {
        self.flying && matches!(self.setpoint.turn, Turn::To { .. })
    }

    /// Forgets what was wound up: for every step in which the motors are stopped.
    pub fn rest(&mut self, rates: Vec3<f32>, heading: f32) {
        self.integral = Vec3::ZERO;
        self.last_rates = rates;
        self.heading_target = heading;
        self.flying = false;
    }

    /// One step: the torque (N·m, body axes) that brings the vehicle to the setpoint.
    ///
    /// `down` is the estimated down direction in body axes, `heading` the estimated heading (rad), `rates`
    /// the body rates (rad/s), and `cut` what the mixer could not do in the last step: there the integrator
    /// holds rather than winds up.
    #[inline]
    pub fn step(
        &mut self,
        down: Vec3<f32>,
        heading: f32,
        rates: Vec3<f32>,
        cut: Saturation,
        dt_s: f32,
    ) -> Vec3<f32> {
        if !self.flying {
            if !self.setpoint.lifts {
                self.rest(rates, heading);
                return Vec3::ZERO;
            }
            self.flying = true;
        }
        let error = self.rate_setpoint(down, heading) - rates;
        let p = &self.params;

        let slope = (rates - self.last_rates) * if dt_s > 0.0 { 1.0 / dt_s } else { 0.0 };
        self.last_rates = rates;

        let free = vec3(
            if cut.roll_pitch { 0.0 } else { dt_s },
            if cut.roll_pitch { 0.0 } else { dt_s },
            if cut.yaw { 0.0 } else { dt_s },
        );
        let wound = self.integral + p.rate_i.scale_by(error).scale_by(free);
        self.integral = limit(wound, p.max_integral_rad_s2);

        let acceleration = p.rate_p.scale_by(error) + self.integral - p.rate_d.scale_by(slope);
        acceleration.scale_by(self.inertia_kg_m2)
    }

    /// The body rates (rad/s) that the sticks ask for, directly or through the angle loop.
    #[inline(always)]
    fn rate_setpoint(&mut self, down: Vec3<f32>, heading: f32) -> Vec3<f32> {
        let p = &self.params;
        let (wanted, yaw_rate) = match self.setpoint.turn {
            Turn::To { down, yaw_rate } => (down, yaw_rate),
            Turn::At(rates) => {
                // Back in angle mode, the heading of that moment is held.
                self.heading_target = heading;
                return rates;
            }
        };
        // Turning the body at ω moves down in body axes at −ω × down, so ω ∝ wanted × down closes the angle
        // a between them. |wanted × down| is sin a; over (1 + cos a)/2 it is 2 tan(a/2): a for small angles,
        // and still rising where sin a falls.
        let axis = wanted.cross(down);
        let one_plus_cos = 1.0 + wanted.dot(down);
        let error = if one_plus_cos > 1.0e-3 {
            axis * (2.0 / one_plus_cos)
        } else {
            // Upside down: every level axis is as good; roll has the most authority.
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
        // A turn about the vertical, in body axes.
        tilt_rate + down * yaw_rate
    }
}

fn limit(v: Vec3<f32>, bound: Vec3<f32>) -> Vec3<f32> {
    vec3(min(max(v.x, -bound.x), bound.x), min(max(v.y, -bound.y), bound.y), min(max(v.z, -bound.z), bound.z))
}

#[cfg(test)]
mod tests;
