//! Identification of the noise's power law at a τ: the exponent α of S(f) ∝ f^α of the rate.
//!
//! The method uses the lag-1 autocorrelation r of averages over τ (W. J. Riley, C. A. Greenhall, *Power law noise
//! identification using the lag 1 autocorrelation*, 18th EFTF, 2004). A fractionally integrated process has
//! r = δ/(1 − δ), so δ = r/(1 + r). While δ is at least 1/4 the averages are not stationary and are replaced by their
//! differences; after d of these steps α = −2 (δ + d).

use super::phase::Phase;
use super::statistic::Statistic;

/// Minimum number of averages for an identification.
const MIN_AVERAGES: usize = 30;
/// Maximum number of averages that are used. With this number r is known to 0.003. Of longer records only the middle is
/// used.
const MAX_AVERAGES: usize = 1 << 17;

/// Returns the exponent at averaging factor m, for the statistic's edf; `None` if the record is too short.
pub fn exponent(phase: &Phase, m: usize, statistic: Statistic) -> Option<i32> {
    let x = phase.sums();
    let all = phase.samples() / m;
    if all < MIN_AVERAGES {
        return None;
    }
    let used = all.min(MAX_AVERAGES);
    let first = (all - used) / 2;
    let mut z: Vec<f64> = (first..first + used).map(|k| (x[(k + 1) * m] - x[k * m]) / m as f64).collect();
    // Differences of order d resolve spectra down to f^−2d.
    let max_differences = statistic.order();
    for differences in 0..=max_differences {
        let delta = delta(&z);
        if delta < 0.25 || differences == max_differences {
            let alpha = libm::round(-2.0 * delta) as i32 - 2 * differences as i32;
            return Some(alpha.clamp(2 - 2 * statistic.order() as i32, 2));
        }
        for k in 1..z.len() {
            z[k - 1] = z[k] - z[k - 1];
        }
        z.pop();
    }
    None
}

/// Returns δ of a series.
fn delta(z: &[f64]) -> f64 {
    let mean = z.iter().sum::<f64>() / z.len() as f64;
    let squares: f64 = z.iter().map(|z| (z - mean) * (z - mean)).sum();
    let products: f64 = z.windows(2).map(|w| (w[0] - mean) * (w[1] - mean)).sum();
    // An exactly constant series counts as white noise.
    let r = if squares > 0.0 { products / squares } else { 0.0 };
    // Values below −1/2 are noise of the estimate.
    let r = r.max(-0.499);
    r / (1.0 + r)
}

#[cfg(test)]
mod tests {
    use super::*;
    use random::NormalStream;

    #[test]
    fn power_laws_are_identified() {
        let mut stream = NormalStream::new(3, "noise", 0);
        let white: Vec<f64> = (0..40_000).map(|_| stream.draw()).collect();
        let sum = |y: &[f64]| {
            let mut total = 0.0;
            y.iter()
                .map(|y| {
                    total += y;
                    total
                })
                .collect::<Vec<f64>>()
        };
        let difference: Vec<f64> = white.windows(2).map(|w| w[1] - w[0]).collect();
        let (walk, run) = (sum(&white), sum(&sum(&white)));
        for (rate, statistic, expected) in [
            (&difference, Statistic::Overlapping, 2),
            (&white, Statistic::Overlapping, 0),
            (&walk, Statistic::Overlapping, -2),
            (&walk, Statistic::Hadamard, -2),
            // The Allan variance does not converge for this law: the result is the steepest law that it accepts.
            (&run, Statistic::Overlapping, -2),
            (&run, Statistic::Hadamard, -4),
        ] {
            let phase = Phase::of_rate(rate.clone(), 0.01);
            for m in [1, 4, 16] {
                assert_eq!(exponent(&phase, m, statistic), Some(expected), "{statistic:?} {m}");
            }
            assert_eq!(exponent(&phase, 2000, statistic), None);
        }
    }
}
