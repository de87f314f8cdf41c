//! A step of the bias: y ← y + b for t ≥ t₀.
//!
//! A shock can change a gyroscope's bias in this way, and so can heat when a device nearby is switched on: the bias
//! that was estimated before take-off becomes wrong from one sample to the next. It is the hardest drift for an
//! estimator, which must learn the whole change at once.

use flight_core::geometry::Vec3;
use serde::Deserialize;

use super::DEG;
use crate::effects::{BoxedSensorEffect, BuildContext, EffectParams, SensorEffect, Snapshot};
use input::InputError;
use input::check;

/// `[effects.gyro.bias_step]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GyroBiasStep {
    /// Time t₀ of the step, s.
    pub at_s: f64,
    /// Bias b after the step, deg/s, body axes.
    pub bias_deg_s: [f64; 3],
}

impl EffectParams for GyroBiasStep {
    type Effect = BoxedSensorEffect;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        check::key_in_range(key, "at_s", self.at_s, 0.0, 1e6, "s")?;
        check::keys_in_range(key, "bias_deg_s", self.bias_deg_s, -1e3, 1e3, "deg/s")
    }

    fn at_s(&self) -> Option<f64> {
        Some(self.at_s)
    }

    fn build(&self, _: &BuildContext) -> BoxedSensorEffect {
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
    use crate::effects::sensor::testing::{STATE, build, snapshot};
    use flight_core::geometry::vec3;

    #[test]
    fn angle_error_grows_linearly_after_bias_step() {
        let mut effect = build(&GyroBiasStep { at_s: 20.0, bias_deg_s: [1.0, -2.0, 0.0] }, 100.0);
        let mut angle = Vec3::ZERO;
        for k in 0..6000 {
            angle += effect.apply(Vec3::ZERO, &snapshot(&STATE, 0.01 * f64::from(k))) * 0.01;
        }
        // These are the samples from 20 s on, each of which counts for 10 ms.
        assert!((angle - vec3(40.0, -80.0, 0.0) * DEG).norm() < 1e-9, "{angle:?}");
        assert_eq!(effect.apply(Vec3::X, &snapshot(&STATE, 19.99)), Vec3::X);
    }
}
