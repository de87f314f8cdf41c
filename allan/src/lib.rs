//! Allan analysis: deviations of a sensor's averages over τ, and the error coefficients that fit them.
//!
//! ```text
//!  samples ──phase──► running sums ──statistic──► σ(τ) with bounds from noise and confidence
//!     mean removed, compensated   octave τ, all cores        │
//!                                                            ▼
//!        N, B, K … or a reason ◄──fit── σ²(τ) = 3Q²/τ² + N²/τ + 0.44 B² + K²τ/3 + R²τ²/2
//! ```
//! The units follow from those of the samples: for a signal in rad/s, N is in rad/s/√Hz, B in rad/s, K in rad/s/√s, Q
//! in rad and R in rad/s². N² is the two-sided density.
//!
//! ```
//! use allan::{Phase, Statistic, Taus, deviations};
//! let samples: Vec<f64> = (0..1_000).map(|n| f64::from(n * n % 7)).collect();
//! let phase = Phase::of_rate(samples, 0.01);
//! let factors = Taus::Octave.factors(phase.samples() / 2);
//! for point in deviations(&phase, Statistic::Overlapping, &factors, 1, &|_, _| ()) {
//!     println!("{} s: {} ({} to {})", point.tau_s, point.deviation, point.lower, point.upper);
//! }
//! ```
#![forbid(unsafe_code)]
#![warn(missing_docs)]
// Tests may compare with the C library's functions: see clippy.toml.
#![cfg_attr(test, allow(clippy::disallowed_methods))]

pub mod confidence;
pub mod fit;
pub mod noise;
pub mod phase;
pub mod statistic;
pub mod taus;

pub use fit::{Coefficient, Fit, Found};
pub use phase::Phase;
pub use statistic::Statistic;
pub use taus::Taus;

use confidence::{Estimate, LEVEL, bounds};

/// The deviation at a τ.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Averaging time τ, s.
    pub tau_s: f64,
    /// Estimated deviation.
    pub deviation: f64,
    /// Lower 68 % bound of the true deviation.
    pub lower: f64,
    /// Upper 68 % bound of the true deviation.
    pub upper: f64,
    /// Number of terms of the estimate.
    pub pairs: usize,
    /// Equivalent degrees of freedom.
    pub edf: f64,
    /// Exponent of the power law at this τ.
    pub alpha: i32,
}

/// Minimum number of averages to accept a flatter power law: the autocorrelation is then known to 0.03.
const ENOUGH_AVERAGES: usize = 1000;

/// Returns the deviations at these averaging factors, with their bounds. The record must not be constant.
pub fn deviations(
    phase: &Phase,
    statistic: Statistic,
    factors: &[usize],
    threads: usize,
    progress: &(dyn Fn(usize, usize) + Sync),
) -> Vec<Point> {
    let variances = statistic::variances(phase, statistic, factors, threads, progress);
    // The first assumption is white noise. At τ for which the record is too short, the law of the last τ is kept.
    // With few averages, a steeper law is accepted, because it only widens the bounds even if it is wrong. A flatter
    // law would narrow them, so it needs enough averages.
    let mut alpha = 0;
    // Neighbouring τ of a long list follow the same law: it is identified once in a 32nd of an octave.
    let mut identified_at = 0;
    let points = factors.iter().zip(variances).map(|(&m, variance)| {
        if identified_at == 0 || m >= identified_at + identified_at / 32 {
            identified_at = m;
            let found = noise::exponent(phase, m, statistic).unwrap_or(alpha);
            if found < alpha || phase.samples() / m >= ENOUGH_AVERAGES {
                alpha = found;
            }
        }
        let edf = Estimate { statistic, alpha, m, sums: phase.sums().len() }.edf();
        let deviation = libm::sqrt(variance.value);
        let (lower, upper) = bounds(deviation, edf, LEVEL);
        let tau_s = m as f64 * phase.interval_s();
        Point { tau_s, deviation, lower, upper, pairs: variance.terms, edf, alpha }
    });
    points.collect()
}

/// Fits the coefficients to overlapping deviations at octave τ of a record of length `record_s`, s. `step` is the step of
/// the converter, if the samples show one.
pub fn fitted(octaves: &[Point], record_s: f64, step: Option<f64>) -> Fit {
    let point = |p: &Point| fit::Point { tau_s: p.tau_s, variance: p.deviation * p.deviation, edf: p.edf };
    fit::fit(&octaves.iter().map(point).collect::<Vec<_>>(), record_s, step)
}

#[cfg(test)]
mod published;
#[cfg(test)]
mod tests;
