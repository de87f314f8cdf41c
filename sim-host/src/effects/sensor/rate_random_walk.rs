//! Rate random walk: the bias is a random walk.
//!
//! b\[k+1\] = b\[k\] + K √Δt w, w standard normal, b = 0 at the start of the run. The Allan deviation is
//! K √(τ/3) (IEEE Std 952-1997, C.1.4) and the standard deviation of b after the time t is K √t, at any rate.

use flight_core::geometry::Vec3;
use serde::Deserialize;

use super::DEG;
use crate::effects::{BoxedSensorEffect, BuildContext, EffectParams, SensorEffect, Snapshot};
use input::InputError;
use input::check;
use random::NormalStreams;

/// `[effects.gyro.rate_random_walk]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GyroRateRandomWalk {
    /// K, deg/s/√s.
    pub k_deg_s_per_sqrt_s: [f64; 3],
}

/// `[effects.accel.rate_random_walk]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AccelRateRandomWalk {
    /// K, m/s²/√s.
    pub k_m_s2_per_sqrt_s: [f64; 3],
}

impl EffectParams for GyroRateRandomWalk {
    type Effect = BoxedSensorEffect;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        check::keys_in_range(key, "k_deg_s_per_sqrt_s", self.k_deg_s_per_sqrt_s, 0.0, 100.0, "deg/s/√s")
    }

    fn build(&self, context: &BuildContext) -> BoxedSensorEffect {
        Box::new(Walk::new(self.k_deg_s_per_sqrt_s.map(|k| k * DEG).into(), context))
    }
}

impl EffectParams for AccelRateRandomWalk {
    type Effect = BoxedSensorEffect;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        check::keys_in_range(key, "k_m_s2_per_sqrt_s", self.k_m_s2_per_sqrt_s, 0.0, 10.0, "m/s²/√s")
    }

    fn build(&self, context: &BuildContext) -> BoxedSensorEffect {
        Box::new(Walk::new(self.k_m_s2_per_sqrt_s.into(), context))
    }
}

struct Walk {
    bias: Vec3<f64>,
    step: Vec3<f64>,
    streams: NormalStreams,
}

impl Walk {
    fn new(k: Vec3<f64>, context: &BuildContext) -> Self {
        let step = k * libm::sqrt(context.interval_s());
        Self { bias: Vec3::ZERO, step, streams: NormalStreams::new(context.seed, context.name) }
    }
}

impl SensorEffect for Walk {
    #[inline]
    fn apply_to(&mut self, reading: &mut Vec3<f64>, _: &Snapshot) {
        *reading += self.bias;
        self.bias += self.step.scale_by(self.streams.draw());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::sensor::testing::{at_rest, build_seeded};

    #[test]
    fn random_walk_grows_as_square_root_of_time() {
        let k = [0.3, 0.2, 0.0];
        for rate_hz in [10.0, 200.0] {
            let (runs, time_s) = (4000_u32, 4.0);
            let mut squares = Vec3::ZERO;
            for seed in 0..u64::from(runs) {
                let params = AccelRateRandomWalk { k_m_s2_per_sqrt_s: k };
                let mut effect = build_seeded(&params, rate_hz, seed);
                let end = at_rest(|at| {
                    assert_eq!(effect.apply(Vec3::X, at), Vec3::X);
                    let samples = (time_s * rate_hz) as u32;
                    (0..samples).fold(Vec3::ZERO, |_, _| effect.apply(Vec3::ZERO, at))
                });
                squares += end.scale_by(end);
            }
            for (sum, k) in <[f64; 3]>::from(squares).into_iter().zip(k) {
                let got = libm::sqrt(sum / f64::from(runs) / time_s);
                // The bound is five standard errors of a deviation from 4,000 draws, 5/√8,000.
                assert!((got - k).abs() <= 0.056 * k, "{got} for {k}");
            }
        }
    }
}
