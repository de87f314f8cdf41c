//! Motor lag: Ω̇ = (Ω_wanted − Ω)/τ, with a τ of its own for speeding up and for slowing down.
//!
//! The lag does not depend on the body's motion, so its solution inside a step is known exactly:
//! Ω(t) = Ω_wanted + (Ω₀ − Ω_wanted) e^(−t/τ), however short τ is beside the step. A propeller is braked by
//! its drag alone where the ESC does not brake, so slowing down often takes longer.

use serde::Deserialize;

use super::VehicleEffect;
use crate::effects::{Build, Recipe};
use input::InputError;
use input::check;

/// `[effects.vehicle.motor_lag]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MotorLag {
    /// τ, s.
    pub tau_s: f64,
    /// τ while slowing down, s; as `tau_s` without it.
    pub tau_down_s: Option<f64>,
}

impl Recipe for MotorLag {
    type Effect = VehicleEffect;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        check::key_in_range(key, "tau_s", self.tau_s, 1e-5, 10.0, "s")?;
        self.tau_down_s.map_or(Ok(()), |tau_s| check::key_in_range(key, "tau_down_s", tau_s, 1e-5, 10.0, "s"))
    }

    fn build(&self, with: &Build) -> VehicleEffect {
        VehicleEffect::Lag(Lag::new(self.tau_s, self.tau_down_s.unwrap_or(self.tau_s), with.interval_s()))
    }
}

/// The lag over half a step and over a whole one.
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

/// A point in a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Point {
    /// Half of it.
    Middle,
    /// All of it.
    End,
}

impl Lag {
    /// With these time constants, for steps of `step_s`.
    pub fn new(up_s: f64, down_s: f64, step_s: f64) -> Self {
        Self { up: Decay::new(up_s, step_s), down: Decay::new(down_s, step_s) }
    }

    #[inline(always)]
    fn decay(&self, now: f64, wanted: f64) -> &Decay {
        if wanted > now { &self.up } else { &self.down }
    }

    /// Speed (rad/s) of a rotor that does `now` at the start of the step and is to do `wanted`.
    #[inline(always)]
    pub fn at(&self, point: Point, now: f64, wanted: f64) -> f64 {
        let decay = self.decay(now, wanted);
        let left = match point {
            Point::Middle => decay.half,
            Point::End => decay.whole,
        };
        wanted + (now - wanted) * left
    }

    /// Acceleration (rad/s²) of a rotor that does `now` and is to do `wanted`.
    #[inline(always)]
    pub fn acceleration(&self, now: f64, wanted: f64) -> f64 {
        (wanted - now) * self.decay(now, wanted).per_tau
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn speeds_up_and_slows_down_exponentially() {
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
