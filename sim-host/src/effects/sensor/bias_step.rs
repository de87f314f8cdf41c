//! A step of the bias: y ← y + b for t ≥ t₀.
//!
//! What a knock does to a gyroscope, or the self-heating when something is switched on: the zero that was learnt
//! before take-off no longer holds, from one sample to the next. It is the hardest drift for an estimator: it
//! has everything to learn at once.

use flight_core::geometry::Vec3;
use serde::Deserialize;

use super::DEG;
use crate::effects::{BoxedSensorEffect, Build, Recipe, SensorEffect, Snapshot};
use input::InputError;
use input::check;

/// `[effects.gyro.bias_step]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GyroBiasStep {
    /// t₀, s.
    pub at_s: f64,
    /// b, deg/s, body axes.
    pub bias_deg_s: [f64; 3],
}

impl Recipe for GyroBiasStep {
    type Effect = BoxedSensorEffect;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        check::key_in_range(key, "at_s", self.at_s, 0.0, 1e6, "s")?;
        check::keys_in_range(key, "bias_deg_s", self.bias_deg_s, -1e3, 1e3, "deg/s")
    }

    fn build(&self, _: &Build) -> BoxedSensorEffect {
        Box::new(Step { at_s: self.at_s, by: self.bias_deg_s.map(|b| b * DEG).into() })
    }
}

struct Step {
    at_s: f64,
    by: Vec3<f64>,
}

impl SensorEffect for Step {
    #[inline]
    fn apply_to(&mut self, reading: &mut Vec3<f64>, at: &Snapshot) {
        if at.time_s >= self.at_s {
            *reading += self.by;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::sensor::testing::{STATE, build, moment};
    use flight_core::geometry::vec3;

    #[test]
    fn a_step_of_a_degree_per_second_turns_by_a_degree_for_every_second_since() {
        let mut effect = build(&GyroBiasStep { at_s: 20.0, bias_deg_s: [1.0, -2.0, 0.0] }, 100.0);
        let mut angle = Vec3::ZERO;
        for k in 0..6000 {
            angle += effect.apply(Vec3::ZERO, &moment(&STATE, 0.01 * f64::from(k))) * 0.01;
        }
        // From the sample at 20 s on, each for its 10 ms.
        assert!((angle - vec3(40.0, -80.0, 0.0) * DEG).norm() < 1e-9, "{angle:?}");
        assert_eq!(effect.apply(Vec3::X, &moment(&STATE, 19.99)), Vec3::X);
    }
}
