//! Rate ramp: y ← y + R t, a drift in one direction.
//!
//! Its Allan deviation is R τ/√2 (IEEE Std 952-1997, C.1.5).

use flight_core::geometry::Vec3;
use serde::Deserialize;

use super::DEG;
use crate::effects::{BoxedSensorEffect, BuildContext, EffectParams, SensorEffect, Snapshot};
use input::InputError;
use input::check;

/// `[effects.gyro.rate_ramp]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GyroRateRamp {
    /// Slope R, deg/s per second.
    pub r_deg_s_per_s: [f64; 3],
}

/// `[effects.accel.rate_ramp]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AccelRateRamp {
    /// Slope R, m/s² per second.
    pub r_m_s2_per_s: [f64; 3],
}

impl EffectParams for GyroRateRamp {
    type Effect = BoxedSensorEffect;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        check::keys_in_range(key, "r_deg_s_per_s", self.r_deg_s_per_s, -100.0, 100.0, "deg/s/s")
    }

    fn build(&self, _: &BuildContext) -> BoxedSensorEffect {
        Box::new(Ramp(self.r_deg_s_per_s.map(|r| r * DEG).into()))
    }
}

impl EffectParams for AccelRateRamp {
    type Effect = BoxedSensorEffect;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        check::keys_in_range(key, "r_m_s2_per_s", self.r_m_s2_per_s, -10.0, 10.0, "m/s²/s")
    }

    fn build(&self, _: &BuildContext) -> BoxedSensorEffect {
        Box::new(Ramp(self.r_m_s2_per_s.into()))
    }
}

struct Ramp(Vec3<f64>);

impl SensorEffect for Ramp {
    #[inline]
    fn apply_to(&mut self, reading: &mut Vec3<f64>, at: &Snapshot) {
        *reading += self.0 * at.time_s;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::sensor::testing::{STATE, build, snapshot};

    #[test]
    fn rate_ramp_of_1_deg_s_per_hour_is_1_deg_s_after_1_hour() {
        let mut effect = build(&GyroRateRamp { r_deg_s_per_s: [1.0 / 3600.0, 0.0, -1.0] }, 100.0);
        let got = effect.apply(Vec3::X, &snapshot(&STATE, 3600.0));
        assert!((got.x - (1.0 + DEG)).abs() < 1e-15 && got.y == 0.0, "{got:?}");
        assert!((got.z + 3600.0 * DEG).abs() < 1e-12, "{got:?}");
    }
}
