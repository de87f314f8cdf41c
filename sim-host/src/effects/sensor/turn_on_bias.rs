//! Turn-on bias: y ← y + b, with b drawn once a run from a normal distribution of deviation σ.
//!
//! The run-to-run part of the zero error (*bias repeatability* of a datasheet): another one at every
//! switching on, which a calibration before the flight cannot know. The seed of the run decides it.

use serde::Deserialize;

use super::DEG;
use super::constant_bias::Offset;
use crate::effects::{BoxedSensorEffect, Build, Recipe};
use input::InputError;
use input::check;
use random::NormalStreams;

/// `[effects.gyro.turn_on_bias]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GyroTurnOnBias {
    /// σ, deg/s.
    pub sigma_deg_s: [f64; 3],
}

/// `[effects.accel.turn_on_bias]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AccelTurnOnBias {
    /// σ, m/s².
    pub sigma_m_s2: [f64; 3],
}

impl Recipe for GyroTurnOnBias {
    type Effect = BoxedSensorEffect;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        check::keys_in_range(key, "sigma_deg_s", self.sigma_deg_s, 0.0, 1e3, "deg/s")
    }

    fn build(&self, with: &Build) -> BoxedSensorEffect {
        Box::new(drawn(self.sigma_deg_s.map(|sigma| sigma * DEG), with))
    }
}

impl Recipe for AccelTurnOnBias {
    type Effect = BoxedSensorEffect;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        check::keys_in_range(key, "sigma_m_s2", self.sigma_m_s2, 0.0, 100.0, "m/s²")
    }

    fn build(&self, with: &Build) -> BoxedSensorEffect {
        Box::new(drawn(self.sigma_m_s2, with))
    }
}

fn drawn(sigma: [f64; 3], with: &Build) -> Offset {
    Offset(NormalStreams::new(with.seed, with.name).draw().scale_by(sigma.into()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::sensor::testing::{at_rest, build_seeded};
    use flight_core::geometry::Vec3;

    #[test]
    fn is_constant_in_a_run_and_has_its_deviation_over_runs() {
        let recipe = GyroTurnOnBias { sigma_deg_s: [1.0, 2.0, 0.0] };
        let runs = 20_000_u32;
        let mut squares = Vec3::ZERO;
        for seed in 0..u64::from(runs) {
            let mut effect = build_seeded(&recipe, 100.0, seed);
            at_rest(|at| {
                let first = effect.apply(Vec3::ZERO, at);
                assert_eq!(effect.apply(Vec3::ZERO, at), first);
                squares += first.scale_by(first);
            });
        }
        let deviations = <[f64; 3]>::from(squares).map(|sum| libm::sqrt(sum / f64::from(runs)) / DEG);
        // Five standard errors of a deviation from 20,000 draws: 5/√40,000.
        for (got, want) in deviations.into_iter().zip([1.0, 2.0, 0.0]) {
            assert!((got - want).abs() <= 0.025 * want, "{got} for {want}");
        }
    }
}
