//! Steady wind: the air moves at a constant velocity.
//!
//! v_air, m/s, north, east, down: a wind *from* the west blows with +y. Only drag feels it, by the velocity
//! through the air v − v_air, so a scene that names a wind without any drag is refused.

use flight_core::geometry::Vec3;
use serde::Deserialize;

use super::{VehicleEffect, WindEffect};
use crate::effects::{Build, Recipe, Snapshot};
use input::InputError;
use input::check;

/// `[effects.wind.constant]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ConstantWind {
    /// Where the air goes, m/s, north, east, down.
    pub velocity_m_s: [f64; 3],
}

impl Recipe for ConstantWind {
    type Effect = VehicleEffect;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        check::keys_in_range(key, "velocity_m_s", self.velocity_m_s, -100.0, 100.0, "m/s")
    }

    fn build(&self, _: &Build) -> VehicleEffect {
        VehicleEffect::Wind(Box::new(Steady(self.velocity_m_s.into())))
    }
}

struct Steady(Vec3<f64>);

impl WindEffect for Steady {
    fn velocity(&mut self, _: &Snapshot) -> Vec3<f64> {
        self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::vehicle::testing::{STATE, moment, wind};

    #[test]
    fn blows_the_same_at_any_time() {
        let mut steady = wind(&ConstantWind { velocity_m_s: [3.0, -2.0, 0.5] }, 1);
        for time_s in [0.0, 10.0] {
            assert_eq!(
                <[f64; 3]>::from(steady.velocity(&moment(&STATE, time_s, [0.0; 4]))),
                [3.0, -2.0, 0.5]
            );
        }
    }
}
