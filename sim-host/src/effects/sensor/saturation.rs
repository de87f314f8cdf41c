//! Saturation: |y| never exceeds the full scale.
//!
//! This effect is for a range narrower than that of the chip's converter, whose saturation is always simulated.

use flight_core::geometry::{Vec3, vec3};
use serde::Deserialize;

use super::DEG;
use crate::effects::{BoxedSensorEffect, BuildContext, EffectParams, SensorEffect, Snapshot};
use ::vehicle::GRAVITY;
use input::InputError;
use input::check;

/// `[effects.gyro.saturation]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GyroSaturation {
    /// Full scale, deg/s.
    pub full_scale_deg_s: f64,
}

/// `[effects.accel.saturation]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AccelSaturation {
    /// Full scale, g.
    pub full_scale_g: f64,
}

impl EffectParams for GyroSaturation {
    type Effect = BoxedSensorEffect;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        check::key_in_range(key, "full_scale_deg_s", self.full_scale_deg_s, 1.0, 1e5, "deg/s")
    }

    fn build(&self, _: &BuildContext) -> BoxedSensorEffect {
        Box::new(Limit(self.full_scale_deg_s * DEG))
    }
}

impl EffectParams for AccelSaturation {
    type Effect = BoxedSensorEffect;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        check::key_in_range(key, "full_scale_g", self.full_scale_g, 0.1, 1e3, "g")
    }

    fn build(&self, _: &BuildContext) -> BoxedSensorEffect {
        Box::new(Limit(self.full_scale_g * GRAVITY))
    }
}

struct Limit(f64);

impl SensorEffect for Limit {
    #[inline]
    fn apply_to(&mut self, reading: &mut Vec3<f64>, _: &Snapshot) {
        let limited = |y: f64| y.clamp(-self.0, self.0);
        *reading = vec3(limited(reading.x), limited(reading.y), limited(reading.z));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::sensor::testing::{at_rest, build};

    #[test]
    fn saturation_limits_to_the_full_scale() {
        let mut gyro = build(&GyroSaturation { full_scale_deg_s: 250.0 }, 100.0);
        let mut accel = build(&AccelSaturation { full_scale_g: 2.0 }, 100.0);
        at_rest(|at| {
            let (low, high) = (-250.0 * DEG, 250.0 * DEG);
            assert_eq!(gyro.apply(vec3(-300.0, 100.0, 251.0) * DEG, at), vec3(low, 100.0 * DEG, high));
            assert_eq!(accel.apply(vec3(-20.0, 19.6, 1e9), at), vec3(-19.6133, 19.6, 19.6133));
        });
    }
}
