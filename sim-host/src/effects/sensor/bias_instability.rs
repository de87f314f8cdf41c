//! Bias instability: 1/f (flicker) noise of the bias, from 1/(length of the run) to half the sample rate.
//!
//! S(f) = B²/(2π f), two-sided like N². The Allan deviation is flat at √(2 ln 2/π) B = 0.664 B (IEEE Std
//! 952-1997, C.1.3): **B is the plateau divided by 0.664**. The usual approximation, a single Gauss-Markov process,
//! has a peak of fixed width instead of a plateau.
//!
//! # Method
//! Flicker is the sum of first-order processes (poles) with equal variances at corners evenly spaced on a
//! logarithmic scale (Keshner, *1/f noise*, Proc. IEEE 70, 1982). Process i has the variance σ² and
//! S_i(f) = 2 σ² a_i/(a_i² + ω²), a_i = 2π f_i; for a ratio r of neighbouring corners the sum is
//!
//! ```text
//!  Σ S_i ≈ (σ²/ln r) ∫ 2a/(a² + ω²) d(ln a) = (σ²/ln r) π/ω      so      σ² = B² ln r/π
//! ```
//!
//! with a ripple of 2 sech(π²/ln r): 0.3 % for r = 4.
//!
//! A slow pole does not need a draw at every sample. Pole j = 1, 2 … has its corner at f_s/(32 · 4ʲ) and is updated
//! every 4ʲ samples, exactly: x ← φ x + √(1 − φ²) σ w, with the same φ = e^(−2π/32) for all slow poles. Between
//! updates it is held. So it lacks power at multiples of its own update rate, where it is 3 % of the sum. Each slow
//! pole is updated at samples n = 2 · 4^(j−1) mod 4ʲ, that is, when n has 2j − 1 trailing zero bits. So at most one
//! slow pole is updated at a sample, and any number of them costs a third of a draw per sample.
//!
//! Two fast poles, which share one draw per sample, make the rest of the spectrum, from f_s/128 up: y = x₁ + x₂,
//! xᵢ ← φᵢ xᵢ + gᵢ w, with φ and g fitted (least squares of ln S on a logarithmic scale of frequency, up to
//! f_s/2). The spectrum of the sum, computed from the formulas, is within −3.7 … +0.6 % of B²/(2π f) below
//! f_s/50 and within −6.9 … +1.8 % below f_s/4. It is 12 % too high at f_s/2, where the spectrum of any sampled
//! process is level. The slowest corner is at most 1/8 of 1/duration, so at f = 1/duration at most
//! (2/π)(1/16) = 4 % is missing.

use flight_core::geometry::Vec3;
use serde::Deserialize;

use super::DEG;
use crate::effects::{BoxedSensorEffect, BuildContext, EffectParams, SensorEffect, Snapshot};
use input::InputError;
use input::check;
use random::NormalStreams;

/// `[effects.gyro.bias_instability]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GyroBiasInstability {
    /// Bias instability B, deg/h: the plateau of the Allan deviation divided by 0.664.
    pub b_deg_per_h: [f64; 3],
}

/// `[effects.accel.bias_instability]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AccelBiasInstability {
    /// Bias instability B, m/s²: the plateau of the Allan deviation divided by 0.664.
    pub b_m_s2: [f64; 3],
}

impl EffectParams for GyroBiasInstability {
    type Effect = BoxedSensorEffect;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        check::keys_in_range(key, "b_deg_per_h", self.b_deg_per_h, 0.0, 1e6, "deg/h")
    }

    fn build(&self, context: &BuildContext) -> BoxedSensorEffect {
        Box::new(Flicker::new(self.b_deg_per_h.map(|b| b * DEG / 3600.0).into(), context))
    }
}

impl EffectParams for AccelBiasInstability {
    type Effect = BoxedSensorEffect;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        check::keys_in_range(key, "b_m_s2", self.b_m_s2, 0.0, 10.0, "m/s²")
    }

    fn build(&self, context: &BuildContext) -> BoxedSensorEffect {
        Box::new(Flicker::new(self.b_m_s2.into(), context))
    }
}

/// Corner frequency of a slow pole, divided by its update rate.
const CORNER: f64 = 1.0 / 32.0;
/// φ₁ and φ₂ of the fast poles.
const FAST_DECAYS: [f64; 2] = [0.818_286_74, 0.351_263_23];
/// g₁ and g₂, in units of B.
const FAST_GAINS: [f64; 2] = [0.277_899_44, 0.597_719_82];

/// Generator of flicker noise. The poles are in units of B.
struct Flicker {
    b: Vec3<f64>,
    fast: [Vec3<f64>; 2],
    /// Slow poles: pole j is at index j − 1.
    slow: Box<[Vec3<f64>]>,
    slow_sum: Vec3<f64>,
    slow_decay: f64,
    slow_gain: f64,
    samples: u64,
    streams: NormalStreams,
}

impl Flicker {
    fn new(b: Vec3<f64>, context: &BuildContext) -> Self {
        // The initial values have separate streams, so a longer run has additional slow poles but otherwise the same
        // noise.
        let mut starts = NormalStreams::new(context.seed, &format!("{}.start", context.name));

        // The fast poles share their draws, so they are correlated: ⟨xᵢ xⱼ⟩ = gᵢ gⱼ/(1 − φᵢ φⱼ).
        let covariance =
            |i: usize, j: usize| FAST_GAINS[i] * FAST_GAINS[j] / (1.0 - FAST_DECAYS[i] * FAST_DECAYS[j]);
        let first_deviation = libm::sqrt(covariance(0, 0));
        let along = covariance(0, 1) / first_deviation;
        let across = libm::sqrt(covariance(1, 1) - along * along);
        let (u, v) = (starts.draw(), starts.draw());
        let fast = [u * first_deviation, u * along + v * across];

        let variance = 2.0 * std::f64::consts::LN_2 / std::f64::consts::PI;
        let slow_decay = libm::exp(-std::f64::consts::TAU * CORNER);
        let mut slow = Vec::new();
        let mut corner_hz = CORNER * context.rate_hz;
        while corner_hz * context.duration_s > 0.125 {
            corner_hz *= 0.25;
            slow.push(starts.draw() * libm::sqrt(variance));
        }
        Self {
            b,
            fast,
            slow_sum: slow.iter().fold(Vec3::ZERO, |sum, &x| sum + x),
            slow: slow.into(),
            slow_decay,
            slow_gain: libm::sqrt(variance * (1.0 - slow_decay * slow_decay)),
            samples: 0,
            streams: NormalStreams::new(context.seed, context.name),
        }
    }
}

impl SensorEffect for Flicker {
    #[inline]
    fn apply_to(&mut self, reading: &mut Vec3<f64>, _: &Snapshot) {
        self.samples += 1;
        let zeros = self.samples.trailing_zeros();
        if zeros & 1 == 1
            && let Some(x) = self.slow.get_mut((zeros / 2) as usize)
        {
            let moved = *x * self.slow_decay + self.streams.draw() * self.slow_gain;
            // Each update adds a rounding error of 10⁻¹⁶ B to the sum. The errors are a random walk, which reaches
            // 10⁻¹² B after 10⁸ updates.
            self.slow_sum += moved - *x;
            *x = moved;
        }
        let draw = self.streams.draw();
        for (i, x) in self.fast.iter_mut().enumerate() {
            *x = *x * FAST_DECAYS[i] + draw * FAST_GAINS[i];
        }
        *reading += (self.fast[0] + self.fast[1] + self.slow_sum).scale_by(self.b);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::sensor::testing::{at_rest, build_seeded};
    use std::f64::consts::TAU;

    /// Returns samples of x, y and z at 1 Hz for 3600 s with B = 1: one list for each axis of each run.
    fn runs(count: u64) -> Vec<Vec<f64>> {
        let params = AccelBiasInstability { b_m_s2: [1.0; 3] };
        let mut axes = Vec::new();
        for seed in 0..count {
            let mut effect = build_seeded(&params, 1.0, seed);
            let mut run = vec![Vec::new(); 3];
            at_rest(|at| {
                for _ in 0..3600 {
                    let got = <[f64; 3]>::from(effect.apply(Vec3::ZERO, at));
                    run.iter_mut().zip(got).for_each(|(axis, y)| axis.push(y));
                }
            });
            axes.append(&mut run);
        }
        axes
    }

    /// With S = B²/(2π f), ∫ sin⁴(u)/u³ du over (0, ∞) = ln 2, so the plateau is √(2 ln 2/π).
    #[test]
    fn bias_instability_allan_deviation_is_0_664_b() {
        let axes = runs(400);
        for length in [4, 10, 30, 100, 300] {
            let (mut sum, mut count) = (0.0, 0.0);
            for axis in &axes {
                let means: Vec<f64> =
                    axis.chunks_exact(length).map(|c| c.iter().sum::<f64>() / length as f64).collect();
                for pair in means.windows(2) {
                    sum += 0.5 * (pair[1] - pair[0]).powi(2);
                    count += 1.0;
                }
            }
            let deviation = f64::sqrt(sum / count);
            println!("{length} samples: {deviation:.4}");
            // There are 1,200 lists of at least 11 pairs, so the bound is 1 % at 300 samples, plus the ripple of
            // the spectrum.
            assert!((deviation / 0.6643 - 1.0).abs() < 0.035, "{length} samples: {deviation}");
        }
    }

    /// Fourier sums with a Hann window, whose main lobe reaches two frequencies to either side.
    #[test]
    fn bias_instability_spectrum_is_b_squared_over_2_pi_f() {
        let axes = runs(400);
        let n = 3600.0;
        for (cycles, within) in
            [(4, 0.08), (8, 0.08), (20, 0.08), (60, 0.08), (200, 0.08), (650, 0.08), (1350, 0.1)]
        {
            let (mut power, mut count) = (0.0, 0.0);
            for offset in 0..4_u32 {
                let f = f64::from(cycles + offset) / n;
                let wave: Vec<(f64, f64)> = (0..3600)
                    .map(|k| {
                        let t = f64::from(k);
                        let window = 1.0 - (TAU * t / n).cos();
                        (window * (TAU * f * t).cos(), window * (TAU * f * t).sin())
                    })
                    .collect();
                for axis in &axes {
                    let (c, s) =
                        axis.iter().zip(&wave).fold((0.0, 0.0), |(c, s), (y, w)| (c + y * w.0, s + y * w.1));
                    // Σ window² = 3n/2.
                    power += (c * c + s * s) / (1.5 * n) * (TAU * f);
                    count += 1.0;
                }
            }
            let ratio = power / count;
            println!("{cycles} cycles in the run: {ratio:.4}");
            assert!((ratio - 1.0).abs() < within, "{cycles} cycles: {ratio}");
        }
    }

    #[test]
    fn longer_run_begins_with_the_same_draws() {
        let params = GyroBiasInstability { b_deg_per_h: [20.0; 3] };
        let mut short = build_seeded(&params, 100.0, 3);
        let vehicle = ::vehicle::VehicleParams::OS4;
        let mut long = params.build(&BuildContext {
            name: "test",
            seed: 3,
            rate_hz: 100.0,
            duration_s: 1e6,
            vehicle: &vehicle,
        });
        at_rest(|at| {
            let offset = long.apply(Vec3::ZERO, at) - short.apply(Vec3::ZERO, at);
            for _ in 0..10_000 {
                let apart = long.apply(Vec3::ZERO, at) - short.apply(Vec3::ZERO, at) - offset;
                assert!(apart.norm() < 1e-15, "{apart:?}");
            }
        });
    }
}
