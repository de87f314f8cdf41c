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
//! The estimates at octave τ are χ² distributed with their edf, so the deviance, −2 ln of the likelihood ratio
//! to a perfect fit, is Σ edf (s/σ² − 1 − ln s/σ²), and it is minimised by least squares with the weights
//! edf/2σ⁴ of the model itself (Fisher scoring): weights of the *estimates* would prefer those that came out
//! low. All 31 choices of terms are fitted, those with a negative square dropped, and of the rest the one taken
//! with the lowest deviance + `PRICE` a term: a coefficient that the data do not call for is not given. Its
//! uncertainty is from the Fisher information, and what is not given has an upper bound instead.
//!
//! # What a model cannot say
//! A sum of powers of τ with positive factors is convex on logarithmic axes. A low-pass filter (a sensor's
//! own, or a prefilter) bends σ the other way at short τ, and converter steps, tones and jitter do what they
//! like there. So the fit may leave out the shortest τ, each at the same price as a term, and if any had to go
//! it begins at four times the τ where the model begins to hold, because what a filter takes off N² fades only
//! as 1/τ. Where the noise is less than half a converter's step the rounding is no noise at all, and
//! nothing short of the steps is fitted.

use super::confidence::chi_squared_quantile;

/// The coefficients, in the order of their slopes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Coefficient {
    /// Q.
    Quantization,
    /// N.
    WhiteNoise,
    /// B.
    BiasInstability,
    /// K.
    RateRandomWalk,
    /// R.
    RateRamp,
}

impl Coefficient {
    /// All of them.
    pub const ALL: [Self; 5] =
        [Self::Quantization, Self::WhiteNoise, Self::BiasInstability, Self::RateRandomWalk, Self::RateRamp];

    /// Its name in results.
    pub fn name(self) -> &'static str {
        match self {
            Self::Quantization => "quantization",
            Self::WhiteNoise => "white_noise",
            Self::BiasInstability => "bias_instability",
            Self::RateRandomWalk => "rate_random_walk",
            Self::RateRamp => "rate_ramp",
        }
    }

    /// Its letter.
    pub fn letter(self) -> char {
        match self {
            Self::Quantization => 'Q',
            Self::WhiteNoise => 'N',
            Self::BiasInstability => 'B',
            Self::RateRandomWalk => 'K',
            Self::RateRamp => 'R',
        }
    }

    /// Its unit, for a signal in this unit.
    pub fn unit(self, of: &str) -> String {
        match self {
            // What is per second loses it to the s of Q, and gains a power from that of R.
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

    /// Allan variance at τ for a coefficient of 1.
    pub fn variance(self, tau_s: f64) -> f64 {
        match self {
            Self::Quantization => 3.0 / (tau_s * tau_s),
            Self::WhiteNoise => 1.0 / tau_s,
            Self::BiasInstability => 2.0 * std::f64::consts::LN_2 / std::f64::consts::PI,
            Self::RateRandomWalk => tau_s / 3.0,
            Self::RateRamp => 0.5 * tau_s * tau_s,
        }
    }

    /// The τ at which its line passes through its own value, where tradition reads it off: √3, 1, 3, √2 s.
    pub fn read_at_s(self) -> Option<f64> {
        match self {
            Self::Quantization => Some(libm::sqrt(3.0)),
            Self::WhiteNoise => Some(1.0),
            Self::BiasInstability => None,
            Self::RateRandomWalk => Some(3.0),
            Self::RateRamp => Some(std::f64::consts::SQRT_2),
        }
    }

    /// Which part of the axis of τ shows it.
    fn shown_by(self) -> &'static str {
        match self {
            Self::Quantization => "no slope of −1 at short τ",
            Self::WhiteNoise => "no slope of −1/2",
            Self::BiasInstability => "no level stretch",
            Self::RateRandomWalk => "no slope of +1/2 at long τ",
            Self::RateRamp => "no slope of +1 at long τ",
        }
    }
}

/// An estimate of the overlapping Allan variance.
#[derive(Clone, Copy, Debug)]
pub struct Point {
    /// τ, s.
    pub tau_s: f64,
    /// The variance.
    pub variance: f64,
    /// Equivalent degrees of freedom.
    pub edf: f64,
}

/// What the data say of one coefficient.
#[derive(Clone, Debug, PartialEq)]
pub enum Found {
    /// Its value and standard deviation.
    Value {
        /// The coefficient.
        value: f64,
        /// Its standard deviation.
        uncertainty: f64,
    },
    /// Nothing but a bound.
    Hidden {
        /// Why.
        reason: String,
        /// With 95 % confidence it is no more than this, if the data bound it.
        at_most: Option<f64>,
    },
}

impl Found {
    /// The value, if there is one.
    pub fn value(&self) -> Option<f64> {
        match self {
            Self::Value { value, .. } => Some(*value),
            Self::Hidden { .. } => None,
        }
    }
}

/// All coefficients.
#[derive(Clone, Debug, PartialEq)]
pub struct Fit {
    /// In the order of [`Coefficient::ALL`].
    pub found: [Found; 5],
    /// The τ that were fitted, s; `None` if none could be.
    pub range_s: Option<(f64, f64)>,
    /// Something to know about the fit as a whole.
    pub note: Option<String>,
}

/// What a further term has to improve the deviance by: 5 standard deviations, of which neighbouring τ, that are
/// not independent, leave about 4.
const PRICE: f64 = 25.0;
/// What a term has to amount to somewhere, as a part of the variance. Less than this is within what a
/// sensor may differ from any model.
const LEAST_PART: f64 = 0.15;
/// Relative deviation that a sensor may have from the model without the model being wrong.
const MODEL_ERROR: f64 = 0.01;
/// Averages over τ that a record has to have for τ to be fitted.
const AVERAGES: f64 = 8.0;
/// Fewest points to a fit.
const LEAST_POINTS: usize = 5;
/// Neighbouring octaves share samples, which makes their errors alike and a fit to them less certain than the
/// same number of independent points. Measured on simulated records: see the tests.
const CORRELATION: f64 = 1.3;

/// Squares of the coefficients, 0 for those not in the model.
type Squares = [f64; 5];

fn model(squares: &Squares, tau_s: f64) -> f64 {
    Coefficient::ALL.iter().zip(squares).map(|(c, square)| c.variance(tau_s) * square).sum()
}

/// Degrees of freedom with the model's own error in them.
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

/// The best model of these terms, with the squares of the others held at `fixed`; its information matrix too.
/// `None` if a square comes out negative or the terms can't be told apart.
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

/// Cholesky's method on the scaled matrix, whose entries else span the powers of τ.
fn solve(matrix: &[[f64; 5]; 5], right: &[f64; 5], n: usize) -> Option<[f64; 5]> {
    let inverse = inverse(matrix, n)?;
    let mut solved = [0.0; 5];
    for i in 0..n {
        solved[i] = (0..n).map(|j| inverse[i][j] * right[j]).sum();
    }
    Some(solved)
}

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

/// The largest part of the variance that a term makes up at any τ.
fn largest_part(points: &[Point], squares: &Squares, term: usize) -> f64 {
    let part = |point: &Point| {
        Coefficient::ALL[term].variance(point.tau_s) * squares[term] / model(squares, point.tau_s)
    };
    points.iter().map(part).fold(0.0, f64::max)
}

struct Chosen {
    terms: Vec<usize>,
    squares: Squares,
    information: [[f64; 5]; 5],
    deviance: f64,
}

/// The model that says most for its price. `shortest`: whether these are all points from the first on. Else
/// something unknown stands at short τ, and a slope of −1 may as well be its tail as Q.
fn choose(points: &[Point], shortest: bool) -> Option<Chosen> {
    let mut chosen: Option<Chosen> = None;
    for subset in (1_u32..32).filter(|subset| shortest || subset & 1 == 0) {
        let terms: Vec<usize> = (0..5).filter(|i| subset & (1 << i) != 0).collect();
        if terms.len() >= points.len() {
            continue;
        }
        let Some((squares, information)) = best(points, &terms, &[0.0; 5]) else { continue };
        if terms.len() > 1 && terms.iter().any(|&term| largest_part(points, &squares, term) < LEAST_PART) {
            continue;
        }
        let deviance = deviance(points, &squares);
        let price = |terms: usize, deviance: f64| deviance + PRICE * terms as f64;
        if chosen.as_ref().is_none_or(|c| price(terms.len(), deviance) < price(c.terms.len(), c.deviance)) {
            chosen = Some(Chosen { terms, squares, information, deviance });
        }
    }
    chosen
}

/// Whether the model describes the points as a whole.
fn describes(points: &[Point], chosen: &Chosen) -> bool {
    let freedom = (points.len() - chosen.terms.len()) as f64;
    chosen.deviance <= CORRELATION * CORRELATION * chi_squared_quantile(0.999, freedom)
}

/// Fits the points, whose τ rise by octaves, of a record of this length. `step` is that of the converter, if the samples show one.
pub fn fit(points: &[Point], record_s: f64, step: Option<f64>) -> Fit {
    // At longer τ fewer than eight independent averages are left, which are as good as one point together.
    let usable = |p: &Point| p.variance > 0.0 && p.variance.is_finite() && p.tau_s <= record_s / AVERAGES;
    let points: Vec<Point> = points.iter().copied().filter(usable).collect();
    let hidden = |reason: &str| Fit {
        found: std::array::from_fn(|_| Found::Hidden { reason: reason.into(), at_most: None }),
        range_s: None,
        note: None,
    };
    if points.len() < LEAST_POINTS {
        return hidden(&format!(
            "too short: {} octaves of τ, and it takes {LEAST_POINTS}; record longer",
            points.len()
        ));
    }
    if let Some(step) = step {
        let deviation = libm::sqrt(points[0].variance);
        // Below about 0.4 steps of true noise, which with the rounding's own is half a step, rounding errors
        // follow the signal instead of being noise on it (Widrow and Kollár, *Quantization noise*, 2008).
        if deviation < 0.5 * step {
            return hidden(&format!(
                "the converter's steps of {step:.3e} are {:.1} times the noise between samples: what they \
                 hide cannot be read back; record at a finer range",
                step / deviation
            ));
        }
    }
    let suffix = |from: usize| {
        let points = &points[from..];
        choose(points, from == 0).map(|chosen| (points, chosen))
    };
    let last_start = points.len() - LEAST_POINTS;
    // A point that is left out is a parameter of its own, at the same price.
    let price = |from: usize| {
        suffix(from).map(|(_, chosen)| chosen.deviance + PRICE * (chosen.terms.len() + from) as f64)
    };
    let priced = (0..=last_start).filter_map(|from| price(from).map(|price| (price, from)));
    let first = priced.min_by(|a, b| a.0.total_cmp(&b.0)).map_or(0, |(_, from)| from);
    let start = if first == 0 { 0 } else { (first + 2).min(last_start) };
    let Some((points, chosen)) = suffix(start) else {
        return hidden("no sum of the five errors describes this record");
    };
    let freedom = (points.len() - chosen.terms.len()).max(1) as f64;
    let widening = (CORRELATION * CORRELATION).max(chosen.deviance / freedom);
    let Some(covariance) = inverse(&chosen.information, chosen.terms.len()) else {
        return hidden("the five errors cannot be told apart in this record");
    };
    let note = if !describes(points, &chosen) {
        Some(
            "no sum of the five errors describes this record well: the uncertainties are widened accordingly",
        )
    } else if start > 0 {
        Some("shorter τ are left out: a filter, converter steps or tones show there, and not the five errors")
    } else if chosen.terms == [4] {
        Some("the drift of the record hides everything else: let the sensor warm up")
    } else {
        None
    };
    let found = std::array::from_fn(|term| {
        match chosen.terms.iter().position(|&t| t == term) {
            Some(i) => {
                let value = libm::sqrt(chosen.squares[term]);
                // The square is fitted: σ of its root is σ/2√.
                let uncertainty = libm::sqrt(covariance[i][i] * widening) / (2.0 * value);
                Found::Value { value, uncertainty }
            }
            None if term == 0 && start > 0 => Found::Hidden {
                reason: "the short τ, where it would be, are left out".into(),
                at_most: at_most(points, &chosen, term, widening),
            },
            None => Found::Hidden {
                reason: format!(
                    "{}: the rest hides it up to τ = {:.4} s",
                    Coefficient::ALL[term].shown_by(),
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

/// The value of a term that is not in the model at which the deviance has risen by what is 95 % to one side.
fn at_most(points: &[Point], chosen: &Chosen, term: usize, widening: f64) -> Option<f64> {
    let rise = 1.645 * 1.645 * widening;
    let with = |square: f64| {
        let mut fixed = [0.0; 5];
        fixed[term] = square;
        // Dropping terms that the larger one leaves nothing for only raises the deviance.
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
    // About where the term alone would be the whole variance.
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
