//! Confidence bounds of the estimated deviations.
//!
//! The distribution of an estimated variance is that of χ² with a number of *equivalent degrees of freedom*, edf, which
//! depends on statistic, τ, length and power law. The edf of all statistics except the total variance is from C. A.
//! Greenhall, W. J. Riley, *Uncertainty of stability variances based on finite differences*, 35th PTTI, 2003: a sum over
//! the correlations between terms if the sum is short, and the paper's fits (tables 1 to 3) if it is long. The edf of the
//! total variance is b T/τ − c (NIST SP 1065, table 7). That table has no values for α > 0: then the overlapping
//! variance's edf is used, because the total variance is not better there.

use super::statistic::Statistic;

/// Maximum number of lags in a sum over correlations.
const LONGEST_SUM: f64 = 100.0;

/// The quantities on which the edf depends.
#[derive(Clone, Copy, Debug)]
pub struct Estimate {
    /// Statistic.
    pub statistic: Statistic,
    /// Exponent of the power law.
    pub alpha: i32,
    /// Averaging factor.
    pub m: usize,
    /// Number of sums, one more than samples.
    pub sums: usize,
}

impl Estimate {
    /// Returns the equivalent degrees of freedom.
    pub fn edf(&self) -> f64 {
        if self.statistic == Statistic::Total && self.alpha <= 0 {
            let (b, c) = match self.alpha {
                0 => (1.5, 0.0),
                -1 => (1.17, 0.22),
                _ => (0.93, 0.36),
            };
            return (b * self.sums as f64 / self.m as f64 - c).max(1.0);
        }
        Differences::of(self).edf()
    }
}

/// The variables of Greenhall and Riley's paper.
struct Differences {
    alpha: i32,
    /// Order of the difference.
    d: i32,
    m: f64,
    /// Number of averages in the variance's filter: m, or 1 for the modified variance.
    filter: f64,
    /// Number of terms in a τ: m, or 1 without overlap.
    stride: f64,
    /// Number of terms.
    terms: f64,
}

impl Differences {
    fn of(estimate: &Estimate) -> Self {
        let Estimate { statistic, alpha, m, sums } = *estimate;
        let m = m as f64;
        let d = statistic.order() as i32;
        let filter = if statistic == Statistic::Modified { 1.0 } else { m };
        let stride = if statistic == Statistic::Standard { 1.0 } else { m };
        let length = m / filter + m * f64::from(d);
        let terms = 1.0 + libm::floor(stride * (sums as f64 - length) / m);
        Self { alpha, d, m, filter, stride, terms: terms.max(1.0) }
    }

    fn edf(&self) -> f64 {
        let d = f64::from(self.d);
        // Length of the estimator in units of τ, and lags at which its terms are correlated.
        let r = self.terms / self.stride;
        let lags = self.terms.min((d + 1.0) * self.stride);
        let long = r >= d + 1.0;
        let modified = self.filter == 1.0 && self.stride == self.m && self.m > 1.0;
        if lags <= LONGEST_SUM && (modified || self.alpha != 2) {
            // For averages of this length the discrete filter equals the continuous one.
            let continuous = !modified && self.alpha <= 0 && self.m * (d + 1.0) > LONGEST_SUM;
            let filter = if continuous { f64::INFINITY } else { self.filter };
            return self.terms / self.correlations(lags, self.terms, self.stride, filter);
        }
        let continuous = if modified { 1.0 } else { f64::INFINITY };
        if self.alpha == 2 && !modified {
            // White phase noise: terms are correlated only at multiples of τ.
            let a0 = if self.d == 2 { 35.0 / 18.0 } else { 231.0 / 100.0 };
            if r > d {
                return self.terms / (a0 - 0.5 * d / r);
            }
            return self.terms / self.few_white_phase(r);
        }
        if self.alpha == 1 && !modified {
            let (a0, a1, b0, b1) =
                if self.d == 2 { (790.0, 410.0, 15.23, 12.0) } else { (9950.0, 6520.0, 47.8, 40.0) };
            let own = b0 + b1 * libm::log(self.m);
            if long {
                return own * own * r / (a0 - a1 / r);
            }
            let short = LONGEST_SUM / r;
            return LONGEST_SUM * own * own / self.sum(LONGEST_SUM, LONGEST_SUM, short, short);
        }
        if long {
            let (a0, a1) = self.fitted(modified);
            return r / (a0 - a1 / r);
        }
        LONGEST_SUM / self.correlations(LONGEST_SUM, LONGEST_SUM, LONGEST_SUM / r, continuous)
    }

    /// Returns the sum of squared correlations between the terms, for white phase noise in a short estimator: its
    /// length is r τ, with r at most d, the order of the differences.
    ///
    /// Terms are correlated if they are k τ apart, with k = 1 … d. In an estimator of the length r τ such pairs exist
    /// only for k below r, and only for a share 1 − k/r of the terms. So the sum is 1 + 2 Σ ρ_k² (1 − k/r) over k < r.
    /// The correlation ρ_k is a binomial coefficient, C(2d, d − k)/C(2d, d).
    fn few_white_phase(&self, r: f64) -> f64 {
        let row: &[f64] = if self.d == 2 { &[6.0, 4.0, 1.0] } else { &[20.0, 15.0, 6.0, 1.0] };
        let sum: f64 = row
            .iter()
            .enumerate()
            .skip(1)
            .map(|(k, c)| {
                let rho = c / row[0];
                2.0 * rho * rho * (1.0 - k as f64 / r).max(0.0)
            })
            .sum();
        1.0 + sum
    }

    /// Returns the coefficients of tables 1 (modified) and 2 of the paper.
    fn fitted(&self, modified: bool) -> (f64, f64) {
        match (modified, self.d, self.alpha) {
            (true, 2, 2) => (7.0 / 9.0, 0.5),
            (true, 2, 1) => (0.997, 0.616),
            (true, 2, 0) => (1.033, 0.607),
            (true, 2, -1) => (1.048, 0.534),
            (true, 2, _) => (1.302, 0.535),
            (true, _, 2) => (22.0 / 25.0, 2.0 / 3.0),
            (true, _, 1) => (1.141, 0.843),
            (true, _, 0) => (1.184, 0.848),
            (true, _, -1) => (1.180, 0.816),
            (true, _, -2) => (1.175, 0.777),
            (true, _, -3) => (1.194, 0.703),
            (true, ..) => (1.489, 0.702),
            (false, 2, 0) => (2.0 / 3.0, 1.0 / 3.0),
            (false, 2, -1) => (0.852, 0.375),
            (false, 2, _) => (1.079, 0.368),
            (false, _, 0) => (7.0 / 9.0, 0.5),
            (false, _, -1) => (0.997, 0.617),
            (false, _, -2) => (1.033, 0.607),
            (false, _, -3) => (1.053, 0.553),
            (false, ..) => (1.302, 0.535),
        }
    }

    /// Returns the sum over lags of the squared correlation between terms.
    fn correlations(&self, lags: f64, terms: f64, stride: f64, filter: f64) -> f64 {
        let own = self.covariance(0.0, filter);
        self.sum(lags, terms, stride, filter) / (own * own)
    }

    /// Returns the sum over lags of the squared covariance: eq 10 of the paper.
    fn sum(&self, lags: f64, terms: f64, stride: f64, filter: f64) -> f64 {
        let squared = |lag: f64| {
            let c = self.covariance(lag / stride, filter);
            c * c
        };
        let between: f64 =
            (1..lags as usize).map(|j| j as f64).map(|j| 2.0 * (1.0 - j / terms) * squared(j)).sum();
        squared(0.0) + between + (1.0 - lags / terms) * squared(lags)
    }

    /// Returns the covariance of two d-th differences at a distance of t τ: eq 9.
    fn covariance(&self, t: f64, filter: f64) -> f64 {
        let s = |t: f64| self.averaged(t, filter);
        let pair = |k: f64| s(t - k) + s(t + k);
        match self.d {
            2 => 6.0 * s(t) - 4.0 * pair(1.0) + pair(2.0),
            _ => 20.0 * s(t) - 15.0 * pair(1.0) + 6.0 * pair(2.0) - pair(3.0),
        }
    }

    /// Returns the generalized autocovariance of phase averaged over 1/filter of τ: eq 8.
    fn averaged(&self, t: f64, filter: f64) -> f64 {
        if filter == f64::INFINITY {
            return continuous(t, self.alpha + 2);
        }
        let step = 1.0 / filter;
        let s = |t: f64| continuous(t, self.alpha);
        filter * filter * (2.0 * s(t) - s(t - step) - s(t + step))
    }
}

/// Returns the generalized autocovariance of phase with power law α: eq 7. Arguments up to 4 (α + 2) are for phase without
/// averaging.
fn continuous(t: f64, alpha: i32) -> f64 {
    let t = t.abs();
    if t == 0.0 {
        return 0.0;
    }
    let t2 = t * t;
    match alpha {
        2 => -t,
        1 => t2 * libm::log(t),
        0 => t2 * t,
        -1 => -t2 * t2 * libm::log(t),
        -2 => -t2 * t2 * t,
        -3 => t2 * t2 * t2 * libm::log(t),
        _ => t2 * t2 * t2 * t,
    }
}

/// Returns the bounds between which the true deviation lies with probability `level`, for an estimated deviation.
pub fn bounds(deviation: f64, edf: f64, level: f64) -> (f64, f64) {
    let beyond = 0.5 * (1.0 - level);
    let at = |p: f64| deviation * libm::sqrt(edf / chi_squared_quantile(p, edf));
    (at(1.0 - beyond), at(beyond))
}

/// Confidence level of one standard deviation to both sides, 68 %.
pub const LEVEL: f64 = 0.682_689_492_137_085_9;

/// Returns the quantile of χ² with k degrees of freedom: the value below which it stays with probability p.
pub fn chi_squared_quantile(p: f64, k: f64) -> f64 {
    // Wilson and Hilferty (1931): the cube root of χ²/k is nearly normal. Precise to 1e-6 for large k.
    let c = 2.0 / (9.0 * k);
    let root = 1.0 - c + normal_quantile(p) * libm::sqrt(c);
    let start = k * root * root * root;
    if k > 1e4 {
        return start;
    }
    // Bisection, because the distribution function rises.
    let mut low = 0.0;
    let mut high = start.max(k) + 1.0;
    while gamma_p(0.5 * k, 0.5 * high) < p {
        high *= 2.0;
    }
    while high - low > 1e-12 * high {
        let middle = 0.5 * (low + high);
        if middle <= low || middle >= high {
            break;
        }
        if gamma_p(0.5 * k, 0.5 * middle) < p { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}

/// Returns the inverse of the normal distribution function, by Newton's method on erfc.
fn normal_quantile(p: f64) -> f64 {
    let mut z = 0.0;
    for _ in 0..60 {
        let below = 0.5 * libm::erfc(-z / std::f64::consts::SQRT_2);
        let density = libm::exp(-0.5 * z * z) / libm::sqrt(2.0 * std::f64::consts::PI);
        z -= ((below - p) / density).clamp(-1.0, 1.0);
    }
    z
}

/// Returns the regularized lower incomplete gamma function: by its series for x below a + 1, else by its continued
/// fraction (Abramowitz and Stegun 6.5.29 and 6.5.31, the latter by Lentz's method).
fn gamma_p(a: f64, x: f64) -> f64 {
    if x <= 0.0 {
        return 0.0;
    }
    let factor = libm::exp(a * libm::log(x) - x - libm::lgamma(a));
    if x < a + 1.0 {
        let (mut term, mut sum, mut n) = (1.0 / a, 1.0 / a, a);
        while term > sum * 1e-16 {
            n += 1.0;
            term *= x / n;
            sum += term;
        }
        return factor * sum;
    }
    let mut b = x + 1.0 - a;
    let mut c = f64::MAX;
    let mut d = 1.0 / b;
    let mut fraction = d;
    for n in 1..100_000 {
        let a_n = -f64::from(n) * (f64::from(n) - a);
        b += 2.0;
        d = 1.0 / (a_n * d + b);
        c = b + a_n / c;
        let change = c * d;
        fraction *= change;
        if (change - 1.0).abs() < 1e-15 {
            break;
        }
    }
    1.0 - factor * fraction
}
