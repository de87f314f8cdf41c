//! Motor lag: Ω̇ = (Ω_wanted − Ω)/τ, with separate τ for speeding up and for slowing down.
//!
//! The lag does not depend on the body's motion, so its solution inside a step is exact for any ratio of τ and step:
//! Ω(t) = Ω_wanted + (Ω₀ − Ω_wanted) e^(−t/τ). If the ESC does not brake, only drag slows the propeller, so slowing
//! down often takes longer.

use serde::Deserialize;

use super::VehicleEffect;
use crate::effects::{BuildContext, EffectParams};
use input::InputError;
use input::check;

/// `[effects.vehicle.motor_lag]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MotorLag {
    /// Time constant τ, s.
    pub tau_s: f64,
    /// Time constant τ for slowing down, s; default `tau_s`.
    pub tau_down_s: Option<f64>,
}

impl EffectParams for MotorLag {
    type Effect = VehicleEffect;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        check::key_in_range(key, "tau_s", self.tau_s, 1e-5, 10.0, "s")?;
        self.tau_down_s.map_or(Ok(()), |tau_s| check::key_in_range(key, "tau_down_s", tau_s, 1e-5, 10.0, "s"))
    }

    fn build(&self, context: &BuildContext) -> VehicleEffect {
        VehicleEffect::Lag(Lag::new(self.tau_s, self.tau_down_s.unwrap_or(self.tau_s), context.interval_s()))
    }
}

/// The motor lag, prepared for half a step and a whole step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lag {
    up: Decay,
    down: Decay,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Decay {
    per_tau: f64,
    half: f64,
    whole: f64,
}

impl Decay {
    fn new(tau_s: f64, step_s: f64) -> Self {
        let half = libm::exp(-0.5 * step_s / tau_s);
        Self { per_tau: 1.0 / tau_s, half, whole: half * half }
    }
}

/// A point in time inside a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Point {
    /// The middle of the step.
    Middle,
    /// The end of the step.
    End,
}

impl Lag {
    /// Creates a lag with these time constants, s, for steps of `step_s`.
    pub fn new(up_s: f64, down_s: f64, step_s: f64) -> Self {
        Self { up: Decay::new(up_s, step_s), down: Decay::new(down_s, step_s) }
    }

    #[inline(always)]
    fn decay(&self, now: f64, wanted: f64) -> &Decay {
        if wanted > now { &self.up } else { &self.down }
    }

    /// Returns the speed, rad/s, of a rotor that has the speed `now` at the start of the step and the command
    /// `wanted`.
    #[inline(always)]
    pub fn at(&self, point: Point, now: f64, wanted: f64) -> f64 {
        let decay = self.decay(now, wanted);
        let left = match point {
            Point::Middle => decay.half,
            Point::End => decay.whole,
        };
        wanted + (now - wanted) * left
    }

    /// Returns the acceleration, rad/s², of a rotor that has the speed `now` and the command `wanted`.
    #[inline(always)]
    pub fn acceleration(&self, now: f64, wanted: f64) -> f64 {
        (wanted - now) * self.decay(now, wanted).per_tau
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rotor_speed_changes_exponentially() {
        for tau_s in [0.05, 1e-4] {
            let lag = Lag::new(tau_s, 2.0 * tau_s, 0.01);
            let speed = lag.at(Point::End, 100.0, 200.0);
            let left = 100.0 * libm::exp(-0.01 / tau_s);
            assert!((speed - (200.0 - left)).abs() < 1e-9);
            assert!((lag.acceleration(speed, 200.0) - left / tau_s).abs() < 1e-9 / tau_s);
            let speed = lag.at(Point::Middle, 200.0, 100.0);
            assert!((speed - (100.0 + 100.0 * libm::exp(-0.005 / (2.0 * tau_s)))).abs() < 1e-9);
            assert_eq!(lag.acceleration(150.0, 100.0), -50.0 / (2.0 * tau_s));
        }
    }
}
