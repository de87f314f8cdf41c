//! Hard iron (eq 17): a magnetised part of the vehicle adds a field that turns with the vehicle.
//!
//! m ← m + h. The paper's magnetometer reads 200 µT more on y than on x, which is four times the Earth's field.

use flight_core::geometry::Vec3;
use serde::Deserialize;

use crate::effects::{BoxedSensorEffect, BuildContext, EffectParams, SensorEffect, Snapshot};
use input::InputError;
use input::check;

/// `[effects.mag.hard_iron]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HardIron {
    /// Field h, µT, body axes.
    pub field_ut: [f64; 3],
}

impl EffectParams for HardIron {
    type Effect = BoxedSensorEffect;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        check::keys_in_range(key, "field_ut", self.field_ut, -1e4, 1e4, "µT")
    }

    fn build(&self, _: &BuildContext) -> BoxedSensorEffect {
        Box::new(Offset(self.field_ut.into()))
    }
}

struct Offset(Vec3<f64>);

impl SensorEffect for Offset {
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
    fn hard_iron_adds_its_field_to_any_reading() {
        let mut effect = build(&HardIron { field_ut: [0.0, 200.0, 0.0] }, 100.0);
        let reading = at_rest(|at| effect.apply(vec3(25.0, 3.0, 41.0), at));
        assert_eq!(reading, vec3(25.0, 203.0, 41.0));
    }
}
