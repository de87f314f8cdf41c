//! Scale factor error: y ← (1 + s) y, per axis.
//!
//! It corresponds to a datasheet's sensitivity tolerance: 0.5 % is 5,000 ppm.

use flight_core::geometry::Vec3;
use serde::Deserialize;

use crate::effects::{BoxedSensorEffect, BuildContext, EffectParams, SensorEffect, Snapshot};
use input::InputError;
use input::check;

/// `[effects.gyro.scale_factor]` and `[effects.accel.scale_factor]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ScaleFactor {
    /// Error s, parts per million, body axes.
    pub error_ppm: [f64; 3],
}

impl EffectParams for ScaleFactor {
    type Effect = BoxedSensorEffect;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        check::keys_in_range(key, "error_ppm", self.error_ppm, -5e5, 5e5, "ppm")
    }

    fn build(&self, _: &BuildContext) -> BoxedSensorEffect {
        Box::new(Scale(self.error_ppm.map(|ppm| 1.0 + ppm * 1e-6).into()))
    }
}

struct Scale(Vec3<f64>);

impl SensorEffect for Scale {
    #[inline]
    fn apply_to(&mut self, reading: &mut Vec3<f64>, _: &Snapshot) {
        *reading = reading.scale_by(self.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::sensor::testing::{at_rest, build};
    use flight_core::geometry::vec3;

    #[test]
    fn half_a_percent_of_a_full_turn_is_1_8_degrees() {
        let mut effect = build(&ScaleFactor { error_ppm: [5000.0, -5000.0, 0.0] }, 100.0);
        let got = at_rest(|at| effect.apply(vec3(360.0, 360.0, 360.0), at));
        assert!((got - vec3(361.8, 358.2, 360.0)).norm() < 1e-12, "{got:?}");
    }
}
