//! White noise (eq 16): angle random walk of a gyroscope, velocity random walk of an accelerometer.
//!
//! y\[k\] = N/√Δt w\[k\], w standard normal. N is the two-sided density in unit/√Hz, which is the standard deviation
//! of one-second means; a datasheet's one-sided density is √2 N. N does not depend on the sample rate: the Allan
//! deviation is N/√τ at 100 Hz and at 1 kHz.

use flight_core::geometry::Vec3;
use serde::Deserialize;

use super::DEG;
use crate::effects::{BoxedSensorEffect, BuildContext, EffectParams, SensorEffect, Snapshot};
use input::InputError;
use input::check;
use random::NormalStreams;

/// `[effects.gyro.white_noise]`: angle random walk. 1 deg/√h is 1/60 deg/s/√Hz.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GyroWhiteNoise {
    /// N, deg/√h.
    pub n_deg_per_sqrt_h: [f64; 3],
}

/// `[effects.accel.white_noise]`: velocity random walk.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AccelWhiteNoise {
    /// N, m/s²/√Hz.
    pub n_m_s2_per_sqrt_hz: [f64; 3],
}

/// `[effects.mag.white_noise]`: A of eq 17, as a density.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MagWhiteNoise {
    /// N, µT/√Hz.
    pub n_ut_per_sqrt_hz: [f64; 3],
}

impl EffectParams for GyroWhiteNoise {
    type Effect = BoxedSensorEffect;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        check::keys_in_range(key, "n_deg_per_sqrt_h", self.n_deg_per_sqrt_h, 0.0, 1e3, "deg/√h")
    }

    fn build(&self, context: &BuildContext) -> BoxedSensorEffect {
        Box::new(WhiteNoise::new(self.n_deg_per_sqrt_h.map(|n| n * DEG / 60.0).into(), context))
    }
}

impl EffectParams for AccelWhiteNoise {
    type Effect = BoxedSensorEffect;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        check::keys_in_range(key, "n_m_s2_per_sqrt_hz", self.n_m_s2_per_sqrt_hz, 0.0, 10.0, "m/s²/√Hz")
    }

    fn build(&self, context: &BuildContext) -> BoxedSensorEffect {
        Box::new(WhiteNoise::new(self.n_m_s2_per_sqrt_hz.into(), context))
    }
}

impl EffectParams for MagWhiteNoise {
    type Effect = BoxedSensorEffect;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        check::keys_in_range(key, "n_ut_per_sqrt_hz", self.n_ut_per_sqrt_hz, 0.0, 100.0, "µT/√Hz")
    }

    fn build(&self, context: &BuildContext) -> BoxedSensorEffect {
        Box::new(WhiteNoise::new(self.n_ut_per_sqrt_hz.into(), context))
    }
}

/// White noise of a given density.
#[derive(Debug)]
pub struct WhiteNoise {
    deviation: Vec3<f64>,
    streams: NormalStreams,
}

impl WhiteNoise {
    /// Creates noise of density `n`, unit/√Hz.
    pub fn new(n: Vec3<f64>, context: &BuildContext) -> Self {
        Self {
            deviation: n * libm::sqrt(context.rate_hz),
            streams: NormalStreams::new(context.seed, context.name),
        }
    }
}

impl SensorEffect for WhiteNoise {
    #[inline]
    fn apply_to(&mut self, reading: &mut Vec3<f64>, _: &Snapshot) {
        *reading += self.deviation.scale_by(self.streams.draw());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::sensor::testing::{at_rest, build};

    #[test]
    fn white_noise_density_does_not_depend_on_rate() {
        for rate_hz in [100.0, 1000.0] {
            let n = [0.032, 0.02, 0.01];
            let mut noise = build(&AccelWhiteNoise { n_m_s2_per_sqrt_hz: n }, rate_hz);
            // A mean over T seconds has the variance N²/T: 20,000 means of 0.1 s.
            let (batches, length) = (20_000, (0.1 * rate_hz) as u32);
            let mut sums = Vec3::ZERO;
            at_rest(|at| {
                for _ in 0..batches {
                    let mut mean = Vec3::ZERO;
                    for _ in 0..length {
                        mean += noise.apply(Vec3::ZERO, at) * (1.0 / f64::from(length));
                    }
                    sums += mean.scale_by(mean);
                }
            });
            for (sum, n) in <[f64; 3]>::from(sums).into_iter().zip(n) {
                let got = libm::sqrt(sum / f64::from(batches) * 0.1);
                // The bound is five standard errors of a deviation from 20,000 draws, 5/√40,000.
                assert!((got / n - 1.0).abs() < 0.025, "{got} for {n}");
            }
        }
    }

    #[test]
    fn white_noise_of_table_2_in_degrees_per_second() {
        // 1.9368 deg/√h is 0.03228 deg/s/√Hz; at 1 kHz each sample has √1000 of it.
        let mut noise = build(&GyroWhiteNoise { n_deg_per_sqrt_h: [1.9368; 3] }, 1000.0);
        let (mut squares, count) = (0.0, 300_000);
        at_rest(|at| (0..count).for_each(|_| squares += noise.apply(Vec3::ZERO, at).dot(Vec3::X).powi(2)));
        let deviation_deg_s = libm::sqrt(squares / f64::from(count)) / DEG;
        assert!((deviation_deg_s / (0.03228 * 1000.0_f64.sqrt()) - 1.0).abs() < 0.01, "{deviation_deg_s}");
    }
}
