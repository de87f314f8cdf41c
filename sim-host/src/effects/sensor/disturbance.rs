//! Magnetic disturbance: the vehicle passes a magnetic object, such as a car, a gate or a reinforced wall.
//!
//! m ← m + Rᵀ B ½ (1 − cos(2π (t − t₀)/T)) for t₀ ≤ t ≤ t₀ + T, where R is the attitude. The field is fixed in the
//! world: it does not turn with the vehicle, so a calibration cannot remove it. A raised cosine rises and falls
//! without a step, reaches B at half time, and has the mean B/2. (The shape is our own choice: the field of a dipole
//! depends on the path.)

use std::f64::consts::TAU;

use flight_core::geometry::Vec3;
use serde::Deserialize;

use crate::effects::{BoxedSensorEffect, BuildContext, EffectParams, SensorEffect, Snapshot};
use input::InputError;
use input::check;

/// `[effects.mag.disturbance]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Disturbance {
    /// Start t₀, s.
    pub at_s: f64,
    /// Duration T, s.
    pub for_s: f64,
    /// Peak field B, µT, north, east, down.
    pub field_ut: [f64; 3],
}

impl EffectParams for Disturbance {
    type Effect = BoxedSensorEffect;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        check::key_in_range(key, "at_s", self.at_s, 0.0, 1e6, "s")?;
        check::key_in_range(key, "for_s", self.for_s, 1e-3, 1e6, "s")?;
        check::keys_in_range(key, "field_ut", self.field_ut, -1e4, 1e4, "µT")
    }

    fn at_s(&self) -> Option<f64> {
        Some(self.at_s)
    }

    fn build(&self, _: &BuildContext) -> BoxedSensorEffect {
        Box::new(Passing { at_s: self.at_s, per_second: 1.0 / self.for_s, field: self.field_ut.into() })
    }
}

struct Passing {
    at_s: f64,
    per_second: f64,
    field: Vec3<f64>,
}

impl SensorEffect for Passing {
    fn apply_to(&mut self, reading: &mut Vec3<f64>, at: &Snapshot) {
        let passed = (at.time_s - self.at_s) * self.per_second;
        if !(0.0..=1.0).contains(&passed) {
            return;
        }
        let strength = 0.5 * (1.0 - libm::cos(TAU * passed));
        *reading += at.state.attitude.conjugate().rotate(self.field * strength);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::sensor::testing::{STATE, build, snapshot};
    use crate::state::State;
    use flight_core::geometry::{Quaternion, vec3};

    #[test]
    fn disturbance_rises_to_its_peak_and_falls() {
        let mut effect = build(&Disturbance { at_s: 10.0, for_s: 4.0, field_ut: [20.0, -10.0, 5.0] }, 100.0);
        let peak = vec3(20.0, -10.0, 5.0);
        for (time_s, of_peak) in
            [(0.0, 0.0), (9.99, 0.0), (10.0, 0.0), (11.0, 0.5), (12.0, 1.0), (13.0, 0.5), (14.5, 0.0)]
        {
            let read = effect.apply(Vec3::X, &snapshot(&STATE, time_s)) - Vec3::X;
            assert!((read - peak * of_peak).norm() < 1e-12, "at {time_s} s: {read:?}");
        }
        // The mean over the passage is half the peak.
        let mean =
            (0..400).map(|k| effect.apply(Vec3::ZERO, &snapshot(&STATE, 10.0 + 0.01 * f64::from(k))).x);
        assert!((mean.sum::<f64>() / 400.0 - 10.0).abs() < 1e-9);
    }

    #[test]
    fn disturbance_does_not_turn_with_the_vehicle() {
        // The vehicle faces east, so north is on its left.
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let east = State { attitude: Quaternion::new(half, 0.0, 0.0, half), ..STATE };
        let mut effect = build(&Disturbance { at_s: 0.0, for_s: 2.0, field_ut: [20.0, 0.0, 0.0] }, 100.0);
        let read = effect.apply(Vec3::ZERO, &snapshot(&east, 1.0));
        assert!((read - vec3(0.0, -20.0, 0.0)).norm() < 1e-12, "{read:?}");
    }
}
