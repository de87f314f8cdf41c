//! Constant bias: y ← y + b.
//!
//! The part of the zero error that stays the same at every power-on and over time: the rest that a calibration
//! leaves, or a datasheet's zero-rate (zero-g) output. An accelerometer bias of 1 mg makes a position error of
//! 17.65 m in 60 s (eqs 2-3). A gyroscope bias of 1 deg/h tilts the accelerometer, which makes 1.71 m in 60 s.

use flight_core::geometry::Vec3;
use serde::Deserialize;

use super::DEG;
use crate::effects::{BoxedSensorEffect, BuildContext, EffectParams, SensorEffect, Snapshot};
use input::InputError;
use input::check;

/// `[effects.gyro.constant_bias]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GyroConstantBias {
    /// Bias b, deg/s, body axes.
    pub bias_deg_s: [f64; 3],
}

/// `[effects.accel.constant_bias]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AccelConstantBias {
    /// Bias b, m/s², body axes. 1 mg is 0.00980665 m/s².
    pub bias_m_s2: [f64; 3],
}

impl EffectParams for GyroConstantBias {
    type Effect = BoxedSensorEffect;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        check::keys_in_range(key, "bias_deg_s", self.bias_deg_s, -1e3, 1e3, "deg/s")
    }

    fn build(&self, _: &BuildContext) -> BoxedSensorEffect {
        Box::new(Offset(self.bias_deg_s.map(|b| b * DEG).into()))
    }
}

impl EffectParams for AccelConstantBias {
    type Effect = BoxedSensorEffect;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        check::keys_in_range(key, "bias_m_s2", self.bias_m_s2, -100.0, 100.0, "m/s²")
    }

    fn build(&self, _: &BuildContext) -> BoxedSensorEffect {
        Box::new(Offset(self.bias_m_s2.into()))
    }
}

/// A constant that is added to every reading.
#[derive(Debug)]
pub(super) struct Offset(pub Vec3<f64>);

impl SensorEffect for Offset {
    #[inline]
    fn apply_to(&mut self, reading: &mut Vec3<f64>, _: &Snapshot) {
        *reading += self.0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::sensor::testing::{at_rest, build};
    use flight_core::geometry::vec3;

    #[test]
    fn bias_integrates_to_the_figures_of_equations_2_and_3() {
        let milli_g = 9.80665e-3;
        let mut accel = build(&AccelConstantBias { bias_m_s2: [milli_g, 0.0, 0.0] }, 1000.0);
        let mut gyro = build(&GyroConstantBias { bias_deg_s: [1.0 / 3600.0, 0.0, 0.0] }, 1000.0);
        let (dt, mut speed, mut way, mut angle, mut tilt_speed, mut tilt_way) =
            (1e-3, 0.0, 0.0, 0.0, 0.0, 0.0);
        at_rest(|at| {
            for _ in 0..60_000 {
                speed += accel.apply(Vec3::ZERO, at).x * dt;
                way += speed * dt;
                angle += gyro.apply(Vec3::ZERO, at).x * dt;
                tilt_speed += 9.80665 * angle * dt;
                tilt_way += tilt_speed * dt;
            }
        });
        // b t²/2 and g b t³/6.
        assert!((way - 17.65).abs() < 5e-3 && (tilt_way - 1.7116).abs() < 5e-4, "{way} {tilt_way}");
        at_rest(|at| assert_eq!(accel.apply(vec3(1.0, 2.0, 3.0), at), vec3(1.0 + milli_g, 2.0, 3.0)));
    }
}
