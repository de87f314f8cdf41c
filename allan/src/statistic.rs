//! The variances of the statistics.
//!
//! x are the P running sums, and τ = m Δt (W. J. Riley, *Handbook of Frequency Stability Analysis*, NIST SP 1065, 2008,
//! section 5.2). The sums are over each k for which all terms exist; n is the number of terms:
//!
//! | statistic | variance at m | terms |
//! |---|---|---|
//! | standard (eq 15) | Σ (x\[k+2m\] − 2x\[k+m\] + x\[k\])² / 2m²n, k = 0, m, 2m … | ⌊(P−1)/m⌋ − 1 |
//! | overlapping | the same for each k | P − 2m |
//! | modified | Σ (Σ_{i<m} x\[k+i+2m\] − 2x\[k+i+m\] + x\[k+i\])² / 2m⁴n | P − 3m + 1 |
//! | Hadamard, overlapping | Σ (x\[k+3m\] − 3x\[k+2m\] + 3x\[k+m\] − x\[k\])² / 6m²n | P − 3m |
//! | total | Σ (x\[k+m\] − 2x\[k\] + x\[k−m\])² / 2m²n, k = 1 … P−2, x mirrored about its two ends | P − 2 |
//!
//! # Speed
//! Memory bandwidth limits the speed, because the sums of a long record do not fit into a cache. Therefore all m of a
//! batch are computed together, block by block: the end of one octave's differences is the middle of the next octave's,
//! and is still in the cache. A batch and a segment of the record are a piece of work. The pieces are distributed to the
//! cores, and their sums are added in the order of the record, so that the result is bit for bit the same on any number
//! of cores.

use std::sync::atomic::{AtomicUsize, Ordering};

use super::phase::Phase;

/// The statistic.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Statistic {
    /// Allan variance by eq 15: differences of neighbouring averages, without overlap.
    Standard,
    /// Allan variance with averages that start at each sample. Its expectation is that of `Standard`, with less
    /// scatter.
    Overlapping,
    /// Modified Allan variance: averages over m differences, which separates white and flicker phase noise.
    Modified,
    /// Hadamard variance: overlapping third differences, which are insensitive to a linear drift.
    Hadamard,
    /// Total variance: overlapping, on a record mirrored about its ends, which is more precise at τ near half the record.
    Total,
}

/// Number of averaging factors in a piece of work.
const BATCH: usize = 32;
/// Number of terms in a piece of work.
const SEGMENT: usize = 1 << 20;
/// Number of terms of one factor that are computed before the next factor: three streams of it fit into the L1 cache.
const BLOCK: usize = 1024;

/// Time of a term on one core, ns, measured on a 2-core x86-64 machine. Only [`estimate_s`] uses it.
const NS_PER_TERM: f64 = 0.7;

impl Statistic {
    /// Returns the largest averaging factor for which the record has enough terms.
    pub fn largest_factor(self, samples: usize) -> usize {
        match self {
            Self::Standard | Self::Overlapping | Self::Modified | Self::Hadamard => samples / 3,
            Self::Total => samples / 2,
        }
    }

    /// Returns the order of the difference: 2, or 3 for Hadamard.
    pub fn order(self) -> u32 {
        if self == Self::Hadamard { 3 } else { 2 }
    }

    /// Returns the number of terms at averaging factor m, for a number of sums.
    pub fn terms(self, sums: usize, m: usize) -> usize {
        let all_but = |excluded: usize| sums.saturating_sub(excluded);
        match self {
            Self::Standard => (sums.saturating_sub(1) / m).saturating_sub(1),
            Self::Overlapping => all_but(2 * m),
            Self::Modified => all_but(3 * m - 1),
            Self::Hadamard => all_but(3 * m),
            Self::Total => all_but(2),
        }
    }

    /// Converts the sum of squares of the terms to the variance.
    fn normalised(self, sum: f64, m: usize, terms: usize) -> f64 {
        let m = m as f64;
        let per_term = match self {
            Self::Standard | Self::Overlapping | Self::Total => 2.0 * m * m,
            Self::Modified => 2.0 * m * m * m * m,
            Self::Hadamard => 6.0 * m * m,
        };
        sum / (per_term * terms as f64)
    }

    /// Returns the sum of squares of the terms `from..to`.
    fn sum(self, x: &[f64], m: usize, from: usize, to: usize) -> f64 {
        let at = |k: usize| &x[from + k * m..to + k * m];
        match self {
            Self::Standard => (from..to).map(|k| second(x[k * m], x[(k + 1) * m], x[(k + 2) * m])).sum(),
            Self::Overlapping => seconds(at(0), at(1), at(2)),
            Self::Modified => modified(x, m, from, to),
            Self::Hadamard => thirds(at(0), at(1), at(2), at(3)),
            Self::Total => (from + 1..to + 1).map(|k| mirrored(x, m, k)).sum(),
        }
    }
}

#[inline(always)]
fn second(a: f64, b: f64, c: f64) -> f64 {
    let d = (c - b) - (b - a);
    d * d
}

/// Returns the sum of squared second differences. Eight lanes let the compiler use the processor's vectors; the order of the
/// additions is the same on all processors.
fn seconds(a: &[f64], b: &[f64], c: &[f64]) -> f64 {
    let ((a, a_rest), (b, b_rest), (c, c_rest)) =
        (a.as_chunks::<8>(), b.as_chunks::<8>(), c.as_chunks::<8>());
    let mut lanes = [0.0; 8];
    for ((a, b), c) in a.iter().zip(b).zip(c) {
        for i in 0..8 {
            lanes[i] += second(a[i], b[i], c[i]);
        }
    }
    let rest = a_rest.iter().zip(b_rest).zip(c_rest).map(|((&a, &b), &c)| second(a, b, c));
    lanes.iter().sum::<f64>() + rest.sum::<f64>()
}

fn thirds(a: &[f64], b: &[f64], c: &[f64], d: &[f64]) -> f64 {
    a.iter().zip(b).zip(c.iter().zip(d)).map(|((a, b), (c, d))| (d - a) - 3.0 * (c - b)).map(|t| t * t).sum()
}

/// Returns the sum of squares of the modified variance. The inner sum is updated from term to term: one second difference is
/// added and one is removed.
fn modified(x: &[f64], m: usize, from: usize, to: usize) -> f64 {
    let mut inner: f64 = (from..from + m).map(|i| (x[i + 2 * m] - x[i + m]) - (x[i + m] - x[i])).sum();
    let mut sum = inner * inner;
    for k in from..to - 1 {
        inner += (x[k + 3 * m] - x[k]) - 3.0 * (x[k + 2 * m] - x[k + m]);
        sum += inner * inner;
    }
    sum
}

/// Returns a squared term of the total variance. Beyond an end, the record is rotated by 180° about that end.
fn mirrored(x: &[f64], m: usize, k: usize) -> f64 {
    let last = x.len() - 1;
    let before = if k >= m { x[k - m] } else { 2.0 * x[0] - x[m - k] };
    let after = if k + m <= last { x[k + m] } else { 2.0 * x[last] - x[2 * last - k - m] };
    second(before, x[k], after)
}

/// A variance and its number of terms.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Variance {
    /// Variance, in the squared unit of the rate.
    pub value: f64,
    /// Number of terms.
    pub terms: usize,
}

/// Returns the pieces of work: index of a batch of factors, index of a segment of their terms.
fn pieces(statistic: Statistic, sums: usize, factors: &[usize]) -> Vec<(usize, usize)> {
    let batches = factors.chunks(BATCH).enumerate();
    batches
        .flat_map(|(batch, factors)| {
            let terms = factors.iter().map(|&m| statistic.terms(sums, m)).max().unwrap_or(0);
            (0..terms.div_ceil(SEGMENT)).map(move |segment| (batch, segment))
        })
        .collect()
}

/// Returns the sums of squares of a piece, one for each factor of its batch.
fn work(statistic: Statistic, x: &[f64], factors: &[usize], segment: usize) -> Vec<f64> {
    let mut sums = vec![0.0; factors.len()];
    let (from, to) = (segment * SEGMENT, (segment + 1) * SEGMENT);
    // The modified variance's running inner sum makes each restart expensive, so it uses the whole segment as one block.
    let block = if statistic == Statistic::Modified { SEGMENT } else { BLOCK };
    for from in (from..to).step_by(block) {
        for (sum, &m) in sums.iter_mut().zip(factors) {
            let to = (from + block).min(statistic.terms(x.len(), m));
            if from < to {
                *sum += statistic.sum(x, m, from, to);
            }
        }
    }
    sums
}

/// Computes the variances at these averaging factors on a number of threads. `progress` is called after each piece of work
/// with the number of finished pieces and of all pieces.
pub fn variances(
    phase: &Phase,
    statistic: Statistic,
    factors: &[usize],
    threads: usize,
    progress: &(dyn Fn(usize, usize) + Sync),
) -> Vec<Variance> {
    let x = phase.sums();
    let batches: Vec<&[usize]> = factors.chunks(BATCH).collect();
    let pieces = pieces(statistic, x.len(), factors);
    let (next, done) = (AtomicUsize::new(0), AtomicUsize::new(0));
    let worker = || {
        let mut mine = Vec::new();
        while let Some(&(batch, segment)) = pieces.get(next.fetch_add(1, Ordering::Relaxed)) {
            mine.push((batch, segment, work(statistic, x, batches[batch], segment)));
            progress(done.fetch_add(1, Ordering::Relaxed) + 1, pieces.len());
        }
        mine
    };
    let mut results = if threads.min(pieces.len()) > 1 {
        std::thread::scope(|scope| {
            let workers: Vec<_> = (0..threads.min(pieces.len())).map(|_| scope.spawn(worker)).collect();
            workers.into_iter().flat_map(|w| w.join().expect("a sum does not panic")).collect()
        })
    } else {
        worker()
    };
    results.sort_by_key(|&(batch, segment, _)| (batch, segment));
    let mut sums = vec![0.0; factors.len()];
    for (batch, _, partial) in results {
        for (sum, partial) in sums[batch * BATCH..].iter_mut().zip(partial) {
            *sum += partial;
        }
    }
    let finished = |(&sum, &m): (&f64, &usize)| {
        let terms = statistic.terms(x.len(), m);
        Variance { value: statistic.normalised(sum, m, terms), terms }
    };
    sums.iter().zip(factors).map(finished).collect()
}

/// Time of the bounds of a factor, ns, measured on the same machine. Only [`estimate_s`] uses it.
const NS_PER_FACTOR: f64 = 60_000.0;

/// Estimates the time of [`variances`] and of the bounds, s.
pub fn estimate_s(statistic: Statistic, samples: usize, factors: &[usize], threads: usize) -> f64 {
    let terms = |m: usize| statistic.terms(samples + 1, m) as f64;
    let weight = match statistic {
        Statistic::Overlapping => 1.0,
        Statistic::Hadamard | Statistic::Standard => 2.0,
        Statistic::Modified | Statistic::Total => 3.0,
    };
    let all_terms: f64 = factors.iter().map(|&m| terms(m)).sum();
    (all_terms * weight * NS_PER_TERM / threads.max(1) as f64 + factors.len() as f64 * NS_PER_FACTOR) * 1e-9
}
