//! Allan analysis: how much a sensor's averages over τ still differ, and which errors that shows.
//!
//! ```text
//!  samples ──phase──► running sums ──statistic──► σ(τ) with bounds from noise and confidence
//!     mean off, compensated       octave τ, all cores        │
//!                                                            ▼
//!        N, B, K … or why not ◄──fit── σ²(τ) = 3Q²/τ² + N²/τ + 0.44 B² + K²τ/3 + R²τ²/2
//! ```
//! The units are those of the samples: for a signal in rad/s, N is in rad/s/√Hz, B in rad/s, K in rad/s/√s, Q
//! in rad, R in rad/s². N² is the two-sided density.
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
// Tests may take the C library's functions as a second opinion: see clippy.toml.
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

/// A deviation at a τ.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// τ, s.
    pub tau_s: f64,
    /// The deviation.
    pub deviation: f64,
    /// Lower 68 % bound of the true one.
    pub lower: f64,
    /// Upper 68 % bound of the true one.
    pub upper: f64,
    /// Terms that it is the mean of.
    pub pairs: usize,
    /// Equivalent degrees of freedom.
    pub edf: f64,
    /// Exponent of the power law at this τ.
    pub alpha: i32,
}

/// Averages that it takes to believe in a flatter power law: the autocorrelation is then known to 0.03.
const ENOUGH_AVERAGES: usize = 1000;

/// The deviations at these averaging factors, with their bounds. The record is not constant.
pub fn deviations(
    phase: &Phase,
    statistic: Statistic,
    factors: &[usize],
    threads: usize,
    progress: &(dyn Fn(usize, usize) + Sync),
) -> Vec<Point> {
    let variances = statistic::variances(phase, statistic, factors, threads, progress);
    // White until the data say otherwise; where the record gets too short to tell, as at the τ before. With
    // few averages a steeper law may be chance and only widens the bounds; a flatter one would narrow them on
    // a guess.
    let mut alpha = 0;
    // Neighbouring τ of a long list follow the same law: it is asked for once in a 32nd of an octave.
    let mut asked = 0;
    let points = factors.iter().zip(variances).map(|(&m, variance)| {
        if asked == 0 || m >= asked + asked / 32 {
            asked = m;
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

/// The coefficients, from overlapping deviations at octave τ of a record of this length.
pub fn fitted(octaves: &[Point], record_s: f64, step: Option<f64>) -> Fit {
    let point = |p: &Point| fit::Point { tau_s: p.tau_s, variance: p.deviation * p.deviation, edf: p.edf };
    fit::fit(&octaves.iter().map(point).collect::<Vec<_>>(), record_s, step)
}

#[cfg(test)]
mod published;
#[cfg(test)]
mod tests;
