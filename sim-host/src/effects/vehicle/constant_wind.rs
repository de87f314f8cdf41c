//! Steady wind: the air moves at a constant velocity.
//!
//! v_air, m/s, north, east, down: a wind *from* the west has positive y. It acts only through drag, by the velocity
//! through the air v − v_air. Therefore a scene with wind but without drag is an error.

use flight_core::geometry::Vec3;
use serde::Deserialize;

use super::{VehicleEffect, WindEffect};
use crate::effects::{BuildContext, EffectParams, Snapshot};
use input::InputError;
use input::check;

/// `[effects.wind.constant]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ConstantWind {
    /// Velocity of the air, m/s, north, east, down.
    pub velocity_m_s: [f64; 3],
}

impl EffectParams for ConstantWind {
    type Effect = VehicleEffect;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        check::keys_in_range(key, "velocity_m_s", self.velocity_m_s, -100.0, 100.0, "m/s")
    }

    fn build(&self, _: &BuildContext) -> VehicleEffect {
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
    use crate::effects::vehicle::testing::{STATE, snapshot, wind};

    #[test]
    fn constant_wind_is_the_same_at_any_time() {
        let mut steady = wind(&ConstantWind { velocity_m_s: [3.0, -2.0, 0.5] }, 1);
        for time_s in [0.0, 10.0] {
            assert_eq!(
                <[f64; 3]>::from(steady.velocity(&snapshot(&STATE, time_s, [0.0; 4]))),
                [3.0, -2.0, 0.5]
            );
        }
    }
}
