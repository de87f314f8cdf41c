//! Turn-on bias: y ← y + b, with b drawn once per run from a normal distribution of standard deviation σ.
//!
//! The run-to-run part of the zero error (*bias repeatability* of a datasheet): it differs at every power-on, so an
//! earlier calibration cannot include it. The seed of the run determines it.

use serde::Deserialize;

use super::DEG;
use super::constant_bias::Offset;
use crate::effects::{BoxedSensorEffect, BuildContext, EffectParams};
use input::InputError;
use input::check;
use random::NormalStreams;

/// `[effects.gyro.turn_on_bias]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GyroTurnOnBias {
    /// Standard deviation σ, deg/s.
    pub sigma_deg_s: [f64; 3],
}

/// `[effects.accel.turn_on_bias]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AccelTurnOnBias {
    /// Standard deviation σ, m/s².
    pub sigma_m_s2: [f64; 3],
}

impl EffectParams for GyroTurnOnBias {
    type Effect = BoxedSensorEffect;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        check::keys_in_range(key, "sigma_deg_s", self.sigma_deg_s, 0.0, 1e3, "deg/s")
    }

    fn build(&self, context: &BuildContext) -> BoxedSensorEffect {
        Box::new(drawn(self.sigma_deg_s.map(|sigma| sigma * DEG), context))
    }
}

impl EffectParams for AccelTurnOnBias {
    type Effect = BoxedSensorEffect;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        check::keys_in_range(key, "sigma_m_s2", self.sigma_m_s2, 0.0, 100.0, "m/s²")
    }

    fn build(&self, context: &BuildContext) -> BoxedSensorEffect {
        Box::new(drawn(self.sigma_m_s2, context))
    }
}

fn drawn(sigma: [f64; 3], context: &BuildContext) -> Offset {
    Offset(NormalStreams::new(context.seed, context.name).draw().scale_by(sigma.into()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::sensor::testing::{at_rest, build_seeded};
    use flight_core::geometry::Vec3;

    #[test]
    fn turn_on_bias_is_constant_in_a_run_and_varies_over_runs() {
        let params = GyroTurnOnBias { sigma_deg_s: [1.0, 2.0, 0.0] };
        let runs = 20_000_u32;
        let mut squares = Vec3::ZERO;
        for seed in 0..u64::from(runs) {
            let mut effect = build_seeded(&params, 100.0, seed);
            at_rest(|at| {
                let first = effect.apply(Vec3::ZERO, at);
                assert_eq!(effect.apply(Vec3::ZERO, at), first);
                squares += first.scale_by(first);
            });
        }
        let deviations = <[f64; 3]>::from(squares).map(|sum| libm::sqrt(sum / f64::from(runs)) / DEG);
        // The bound is five standard errors of a deviation from 20,000 draws, 5/√40,000.
        for (got, want) in deviations.into_iter().zip([1.0, 2.0, 0.0]) {
            assert!((got - want).abs() <= 0.025 * want, "{got} for {want}");
        }
    }
}
