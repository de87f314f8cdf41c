//! The coefficients of the five classical errors, from the Allan deviation.
//!
//! ```text
//!  σ²(τ) = 3 Q²/τ²  +  N²/τ  +  (2 ln 2/π) B²  +  K² τ/3  +  R² τ²/2
//!  slope of σ  −1       −½          0              +½         +1
//! ```
//! (IEEE Std 952-1997, annex C). Q is the quantization of the *angle*, N the white noise (two-sided: eq 16), B
//! the bias instability, whose plateau is 0.664 B, K the rate random walk, R the rate ramp.
//!
//! # Method
//! The estimates s at octave τ are χ² distributed with their edf. The deviance, −2 ln of the likelihood ratio to a
//! perfect fit, is therefore Σ edf (s/σ² − 1 − ln s/σ²). It is minimised by least squares with the weights edf/2σ⁴ of
//! the model (Fisher scoring); weights from the *estimates* would prefer estimates that are too low. All 31 subsets of
//! terms are fitted, and those with a negative square are dropped. Of the others, the one with the lowest deviance +
//! `TERM_PENALTY` for each term is chosen, so that only coefficients which the data require are given. Their
//! uncertainty is from the Fisher information. A coefficient that is not given has an upper bound instead.
//!
//! # Limits of the model
//! A sum of powers of τ with positive factors is convex on logarithmic axes. At short τ a low-pass filter (the
//! sensor's or a prefilter) bends σ the other way, and converter steps, tones and jitter have other shapes. The fit can
//! therefore leave out the shortest τ, with the same penalty for each as for a term. If it leaves out any, it begins at
//! four times the τ at which the model begins to hold, because the effect of a filter on N² decreases only as 1/τ. If
//! the noise is less than half a converter's step, the rounding error is not noise, and nothing is fitted.

use super::confidence::chi_squared_quantile;

/// The error coefficients, in the order of their slopes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Coefficient {
    /// Quantization of the angle Q.
    Quantization,
    /// White noise N.
    WhiteNoise,
    /// Bias instability B.
    BiasInstability,
    /// Rate random walk K.
    RateRandomWalk,
    /// Rate ramp R.
    RateRamp,
}

impl Coefficient {
    /// All coefficients.
    pub const ALL: [Self; 5] =
        [Self::Quantization, Self::WhiteNoise, Self::BiasInstability, Self::RateRandomWalk, Self::RateRamp];

    /// Returns the name in results.
    pub fn name(self) -> &'static str {
        match self {
            Self::Quantization => "quantization",
            Self::WhiteNoise => "white_noise",
            Self::BiasInstability => "bias_instability",
            Self::RateRandomWalk => "rate_random_walk",
            Self::RateRamp => "rate_ramp",
        }
    }

    /// Returns the letter.
    pub fn letter(self) -> char {
        match self {
            Self::Quantization => 'Q',
            Self::WhiteNoise => 'N',
            Self::BiasInstability => 'B',
            Self::RateRandomWalk => 'K',
            Self::RateRamp => 'R',
        }
    }

    /// Returns the unit for a signal with the unit `of`.
    pub fn unit(self, of: &str) -> String {
        match self {
            // Q has the unit of the signal times s, R that of the signal divided by s; powers of s are combined.
            Self::Quantization => match of.strip_suffix("/s") {
                Some(angle) => angle.into(),
                None => format!("{of}·s").replace("/s²·s", "/s"),
            },
            Self::WhiteNoise => format!("{of}/√Hz"),
            Self::BiasInstability => of.into(),
            Self::RateRandomWalk => format!("{of}/√s"),
            Self::RateRamp => match (of.strip_suffix("/s"), of.strip_suffix("/s²")) {
                (Some(angle), _) => format!("{angle}/s²"),
                (_, Some(velocity)) => format!("{velocity}/s³"),
                _ => format!("{of}/s"),
            },
        }
    }

    /// Returns the Allan variance at τ for a coefficient of 1.
    pub fn variance(self, tau_s: f64) -> f64 {
        match self {
            Self::Quantization => 3.0 / (tau_s * tau_s),
            Self::WhiteNoise => 1.0 / tau_s,
            Self::BiasInstability => 2.0 * std::f64::consts::LN_2 / std::f64::consts::PI,
            Self::RateRandomWalk => tau_s / 3.0,
            Self::RateRamp => 0.5 * tau_s * tau_s,
        }
    }

    /// Returns the τ at which the coefficient's line equals the coefficient, where it is read in a graph: √3, 1, 3, √2 s.
    pub fn read_at_s(self) -> Option<f64> {
        match self {
            Self::Quantization => Some(libm::sqrt(3.0)),
            Self::WhiteNoise => Some(1.0),
            Self::BiasInstability => None,
            Self::RateRandomWalk => Some(3.0),
            Self::RateRamp => Some(std::f64::consts::SQRT_2),
        }
    }

    /// Returns the feature of the curve that is missing if the coefficient is not found.
    fn missing_feature(self) -> &'static str {
        match self {
            Self::Quantization => "no slope of −1 at short τ",
            Self::WhiteNoise => "no slope of −1/2",
            Self::BiasInstability => "no flat part",
            Self::RateRandomWalk => "no slope of +1/2 at long τ",
            Self::RateRamp => "no slope of +1 at long τ",
        }
    }
}

/// An estimate of the overlapping Allan variance.
#[derive(Clone, Copy, Debug)]
pub struct Point {
    /// Averaging time τ, s.
    pub tau_s: f64,
    /// Estimated variance.
    pub variance: f64,
    /// Equivalent degrees of freedom.
    pub edf: f64,
}

/// The result for one coefficient.
#[derive(Clone, Debug, PartialEq)]
pub enum Found {
    /// The data show the coefficient.
    Value {
        /// Value of the coefficient.
        value: f64,
        /// Standard deviation of the value.
        uncertainty: f64,
    },
    /// The data do not show the coefficient.
    Hidden {
        /// Reason.
        reason: String,
        /// Upper bound of the coefficient with 95 % confidence, if the data give one.
        at_most: Option<f64>,
    },
}

impl Found {
    /// Returns the value, if the data show the coefficient.
    pub fn value(&self) -> Option<f64> {
        match self {
            Self::Value { value, .. } => Some(*value),
            Self::Hidden { .. } => None,
        }
    }
}

/// The result of a fit.
#[derive(Clone, Debug, PartialEq)]
pub struct Fit {
    /// Results for the coefficients, in the order of [`Coefficient::ALL`].
    pub found: [Found; 5],
    /// Shortest and longest fitted τ, s; `None` if nothing was fitted.
    pub range_s: Option<(f64, f64)>,
    /// Note about the whole fit.
    pub note: Option<String>,
}

/// Minimum improvement of the deviance by a further term: 5² for 5 standard deviations, or about 4 because
/// neighbouring τ are not independent.
const TERM_PENALTY: f64 = 25.0;
/// Minimum of a term's largest part of the variance. A smaller part is within the difference between a sensor and any
/// model.
const MIN_PART: f64 = 0.15;
/// Relative deviation of a sensor from the model that is accepted.
const MODEL_ERROR: f64 = 0.01;
/// Minimum number of averages over τ in a record for τ to be fitted.
const AVERAGES: f64 = 8.0;
/// Minimum number of points in a fit.
const MIN_POINTS: usize = 5;
/// Factor on the uncertainty: neighbouring octaves share samples, so their errors are correlated and a fit is less
/// certain than with independent points. Measured on simulated records: see the tests.
const CORRELATION: f64 = 1.3;

/// Squares of the coefficients, 0 for those not in the model.
type Squares = [f64; 5];

/// Returns the model's variance at τ.
fn model(squares: &Squares, tau_s: f64) -> f64 {
    Coefficient::ALL.iter().zip(squares).map(|(c, square)| c.variance(tau_s) * square).sum()
}

/// Returns the degrees of freedom of a point, reduced by the model error.
fn edf(point: &Point) -> f64 {
    1.0 / (1.0 / point.edf + 2.0 * MODEL_ERROR * MODEL_ERROR)
}

fn deviance_of(point: &Point, squares: &Squares) -> f64 {
    let ratio = point.variance / model(squares, point.tau_s);
    edf(point) * (ratio - 1.0 - libm::log(ratio))
}

fn deviance(points: &[Point], squares: &Squares) -> f64 {
    points.iter().map(|point| deviance_of(point, squares)).sum()
}

/// Returns the best model with these terms and its information matrix; the squares of the other terms are `fixed`. Returns
/// `None` if a square is negative or the terms cannot be separated.
#[expect(clippy::needless_range_loop, reason = "matrices are indexed by row and column")]
fn best(points: &[Point], terms: &[usize], fixed: &Squares) -> Option<(Squares, [[f64; 5]; 5])> {
    let mut squares = *fixed;
    let mut expected: Vec<f64> = points.iter().map(|point| point.variance).collect();
    let mut information = [[0.0; 5]; 5];
    for _ in 0..40 {
        information = [[0.0; 5]; 5];
        let mut right = [0.0; 5];
        for (point, expected) in points.iter().zip(&expected) {
            let relative = |i: usize| Coefficient::ALL[terms[i]].variance(point.tau_s) / expected;
            let left = point.variance / expected - model(fixed, point.tau_s) / expected;
            let weight = 0.5 * edf(point);
            for i in 0..terms.len() {
                right[i] += weight * relative(i) * left;
                for j in 0..terms.len() {
                    information[i][j] += weight * relative(i) * relative(j);
                }
            }
        }
        let solved = solve(&information, &right, terms.len())?;
        let mut change = 0.0_f64;
        for (i, &term) in terms.iter().enumerate() {
            if solved[i] <= 0.0 {
                return None;
            }
            change = change.max((solved[i] - squares[term]).abs() / solved[i]);
            squares[term] = solved[i];
        }
        for (expected, point) in expected.iter_mut().zip(points) {
            *expected = model(&squares, point.tau_s);
        }
        if change < 1e-10 {
            break;
        }
    }
    Some((squares, information))
}

/// Solves the equations with the inverse of the matrix.
fn solve(matrix: &[[f64; 5]; 5], right: &[f64; 5], n: usize) -> Option<[f64; 5]> {
    let inverse = inverse(matrix, n)?;
    let mut solved = [0.0; 5];
    for i in 0..n {
        solved[i] = (0..n).map(|j| inverse[i][j] * right[j]).sum();
    }
    Some(solved)
}

/// Inverts the matrix by Cholesky's method. The matrix is scaled first, because its entries span the powers of τ.
#[expect(clippy::needless_range_loop, reason = "matrices are indexed by row and column")]
fn inverse(matrix: &[[f64; 5]; 5], n: usize) -> Option<[[f64; 5]; 5]> {
    let scale = |i: usize| libm::sqrt(matrix[i][i]);
    if (0..n).any(|i| !(matrix[i][i] > 0.0 && matrix[i][i].is_finite())) {
        return None;
    }
    let mut lower = [[0.0; 5]; 5];
    for i in 0..n {
        for j in 0..=i {
            let known: f64 = (0..j).map(|k| lower[i][k] * lower[j][k]).sum();
            let left = matrix[i][j] / (scale(i) * scale(j)) - known;
            if i == j {
                if left < 1e-10 {
                    return None;
                }
                lower[i][i] = libm::sqrt(left);
            } else {
                lower[i][j] = left / lower[j][j];
            }
        }
    }
    let mut inverse = [[0.0; 5]; 5];
    for column in 0..n {
        let mut y = [0.0; 5];
        for i in 0..n {
            let known: f64 = (0..i).map(|k| lower[i][k] * y[k]).sum();
            y[i] = (f64::from(u8::from(i == column)) - known) / lower[i][i];
        }
        for i in (0..n).rev() {
            let known: f64 = (i + 1..n).map(|k| lower[k][i] * inverse[k][column]).sum();
            inverse[i][column] = (y[i] - known) / lower[i][i];
        }
    }
    for i in 0..n {
        for j in 0..n {
            inverse[i][j] /= scale(i) * scale(j);
        }
    }
    Some(inverse)
}

/// Returns the largest part of the variance that a term has at any τ.
fn largest_part(points: &[Point], squares: &Squares, term: usize) -> f64 {
    let part = |point: &Point| {
        Coefficient::ALL[term].variance(point.tau_s) * squares[term] / model(squares, point.tau_s)
    };
    points.iter().map(part).fold(0.0, f64::max)
}

/// A chosen model.
struct Chosen {
    terms: Vec<usize>,
    squares: Squares,
    information: [[f64; 5]; 5],
    deviance: f64,
}

/// Chooses the model with the lowest deviance plus penalties. `shortest` says whether the points include the shortest τ. If
/// not, an unknown error acts at short τ, and a slope of −1 can be its tail instead of Q, so Q is not tried.
fn choose(points: &[Point], shortest: bool) -> Option<Chosen> {
    let mut chosen: Option<Chosen> = None;
    for subset in (1_u32..32).filter(|subset| shortest || subset & 1 == 0) {
        let terms: Vec<usize> = (0..5).filter(|i| subset & (1 << i) != 0).collect();
        if terms.len() >= points.len() {
            continue;
        }
        let Some((squares, information)) = best(points, &terms, &[0.0; 5]) else { continue };
        if terms.len() > 1 && terms.iter().any(|&term| largest_part(points, &squares, term) < MIN_PART) {
            continue;
        }
        let deviance = deviance(points, &squares);
        let cost = |terms: usize, deviance: f64| deviance + TERM_PENALTY * terms as f64;
        if chosen.as_ref().is_none_or(|c| cost(terms.len(), deviance) < cost(c.terms.len(), c.deviance)) {
            chosen = Some(Chosen { terms, squares, information, deviance });
        }
    }
    chosen
}

/// Returns whether the deviance is plausible for a right model.
fn describes(points: &[Point], chosen: &Chosen) -> bool {
    let freedom = (points.len() - chosen.terms.len()) as f64;
    chosen.deviance <= CORRELATION * CORRELATION * chi_squared_quantile(0.999, freedom)
}

/// Fits points at octave τ of a record of length `record_s`, s. `step` is the step of the converter, if the samples show
/// one.
pub fn fit(points: &[Point], record_s: f64, step: Option<f64>) -> Fit {
    // Longer τ have fewer than eight independent averages, and add little information.
    let usable = |p: &Point| p.variance > 0.0 && p.variance.is_finite() && p.tau_s <= record_s / AVERAGES;
    let points: Vec<Point> = points.iter().copied().filter(usable).collect();
    let hidden = |reason: &str| Fit {
        found: std::array::from_fn(|_| Found::Hidden { reason: reason.into(), at_most: None }),
        range_s: None,
        note: None,
    };
    if points.len() < MIN_POINTS {
        return hidden(&format!(
            "too short: {} octaves of τ, must be at least {MIN_POINTS}; record longer",
            points.len()
        ));
    }
    if let Some(step) = step {
        let deviation = libm::sqrt(points[0].variance);
        // Below about 0.4 steps of true noise (half a step together with the rounding error), the rounding errors
        // depend on the signal and are not noise (Widrow and Kollár, *Quantization noise*, 2008).
        if deviation < 0.5 * step {
            return hidden(&format!(
                "the converter's steps of {step:.3e} are {:.1} times the noise between samples and hide it; \
                 record with a finer resolution",
                step / deviation
            ));
        }
    }
    let suffix = |from: usize| {
        let points = &points[from..];
        choose(points, from == 0).map(|chosen| (points, chosen))
    };
    let last_start = points.len() - MIN_POINTS;
    // A point that is left out counts as a parameter, with the same penalty as a term.
    let cost = |from: usize| {
        suffix(from).map(|(_, chosen)| chosen.deviance + TERM_PENALTY * (chosen.terms.len() + from) as f64)
    };
    let costs = (0..=last_start).filter_map(|from| cost(from).map(|cost| (cost, from)));
    let first = costs.min_by(|a, b| a.0.total_cmp(&b.0)).map_or(0, |(_, from)| from);
    let start = if first == 0 { 0 } else { (first + 2).min(last_start) };
    let Some((points, chosen)) = suffix(start) else {
        return hidden("no sum of the five errors describes this record");
    };
    let freedom = (points.len() - chosen.terms.len()).max(1) as f64;
    let widening = (CORRELATION * CORRELATION).max(chosen.deviance / freedom);
    let Some(covariance) = inverse(&chosen.information, chosen.terms.len()) else {
        return hidden("the five errors cannot be separated in this record");
    };
    let note = if !describes(points, &chosen) {
        Some(
            "no sum of the five errors describes this record well: the uncertainties are widened accordingly",
        )
    } else if start > 0 {
        Some("shorter τ are left out: a filter, converter steps or tones dominate there, not the five errors")
    } else if chosen.terms == [4] {
        Some("the drift of the record hides all other errors: let the sensor warm up")
    } else {
        None
    };
    let found = std::array::from_fn(|term| {
        match chosen.terms.iter().position(|&t| t == term) {
            Some(i) => {
                let value = libm::sqrt(chosen.squares[term]);
                // The fit gives the σ of the square. The σ of the value is the σ of the square, divided by twice the
                // value.
                let uncertainty = libm::sqrt(covariance[i][i] * widening) / (2.0 * value);
                Found::Value { value, uncertainty }
            }
            None if term == 0 && start > 0 => Found::Hidden {
                reason: "the short τ, which would show it, are left out".into(),
                at_most: at_most(points, &chosen, term, widening),
            },
            None => Found::Hidden {
                reason: format!(
                    "{}: the other errors hide it up to τ = {:.4} s",
                    Coefficient::ALL[term].missing_feature(),
                    points[points.len() - 1].tau_s
                ),
                at_most: at_most(points, &chosen, term, widening),
            },
        }
    });
    Fit {
        found,
        range_s: Some((points[0].tau_s, points[points.len() - 1].tau_s)),
        note: note.map(Into::into),
    }
}

/// Returns the upper bound of a term that is not in the model: the value at which the deviance has risen by 1.645², for a
/// one-sided confidence of 95 %.
fn at_most(points: &[Point], chosen: &Chosen, term: usize, widening: f64) -> Option<f64> {
    let rise = 1.645 * 1.645 * widening;
    let with = |square: f64| {
        let mut fixed = [0.0; 5];
        fixed[term] = square;
        // A large fixed term can make another term negative: models without one of the terms are tried, too.
        let kept =
            |terms: &[usize]| best(points, terms, &fixed).map(|(squares, _)| deviance(points, &squares));
        let mut lowest = kept(&chosen.terms);
        for drop in 0..chosen.terms.len() {
            let mut fewer = chosen.terms.clone();
            fewer.remove(drop);
            if let Some(d) = kept(&fewer) {
                lowest = Some(lowest.map_or(d, |l| l.min(d)));
            }
        }
        lowest.unwrap_or(f64::INFINITY)
    };
    // The search starts near the value at which the term alone is the whole variance.
    let unit = |point: &Point| point.variance / Coefficient::ALL[term].variance(point.tau_s);
    let mut high = points.iter().map(unit).fold(f64::INFINITY, f64::min);
    let mut low = 0.0;
    let base = with(low).min(chosen.deviance);
    let mut doublings = 0;
    while with(high) < base + rise {
        low = high;
        high *= 2.0;
        doublings += 1;
        if doublings > 30 {
            return None;
        }
    }
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if with(middle) < base + rise { low = middle } else { high = middle }
    }
    Some(libm::sqrt(high))
}
