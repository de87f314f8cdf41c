//! Round numbers along an axis.

/// Which numbers count as round.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Ladder {
    /// 1, 2 and 5 times a power of ten.
    Decimal,
    /// The same up to 10, then the parts of a turn: 15, 30, 45, 90, and multiples of 180.
    Degrees,
}

/// The labelled values of an axis.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Ticks {
    pub values: Vec<f64>,
    /// Digits after the point that tell them apart; `None` where powers of ten are shorter.
    digits: Option<usize>,
}

impl Ticks {
    /// At most about `most` round values in a range.
    pub fn between((low, high): (f64, f64), most: usize, ladder: Ladder) -> Self {
        let step = step((high - low) / most.max(1) as f64, ladder);
        // Multiples of the step, and not sums of it: sums drift.
        let (first, last) = (libm::ceil(low / step) as i64, libm::floor(high / step) as i64);
        let values = (first..=last).map(|k| k as f64 * step).collect();
        let digits = (-libm::floor(libm::log10(step) + 1e-9)).max(0.0) as usize;
        Self { values, digits: (step < 1e6).then_some(digits) }
    }

    /// The value as the axis shows it.
    pub fn label(&self, value: f64) -> String {
        let shown = match self.digits {
            Some(digits) => format!("{value:.digits$}"),
            None => format!("{value:.0e}"),
        };
        match shown.strip_prefix('-') {
            Some(digits) => format!("\u{2212}{digits}"),
            None => shown,
        }
    }
}

/// The smallest round step that is not below `least`.
fn step(least: f64, ladder: Ladder) -> f64 {
    let least = least.clamp(1e-12, 1e300);
    if ladder == Ladder::Degrees && least > 10.0 {
        let part = [15.0, 30.0, 45.0, 90.0, 180.0].into_iter().find(|&part| part >= least);
        return part.unwrap_or_else(|| 180.0 * step(least / 180.0, Ladder::Decimal));
    }
    let power = libm::pow(10.0, libm::floor(libm::log10(least)));
    // A step that is the wanted one but for rounding will do.
    let enough = least * (1.0 - 1e-9);
    [1.0, 2.0, 5.0].into_iter().map(|k| k * power).find(|&s| s >= enough).unwrap_or(10.0 * power)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(range: (f64, f64), most: usize, ladder: Ladder) -> Vec<String> {
        let ticks = Ticks::between(range, most, ladder);
        ticks.values.iter().map(|&value| ticks.label(value)).collect()
    }

    #[test]
    fn steps_are_round() {
        assert_eq!(labels((0.0, 30.0), 6, Ladder::Decimal), ["0", "5", "10", "15", "20", "25", "30"]);
        assert_eq!(labels((-0.13, 0.27), 4, Ladder::Decimal), ["\u{2212}0.1", "0.0", "0.1", "0.2"]);
        assert_eq!(labels((0.0, 0.003), 3, Ladder::Decimal), ["0.000", "0.001", "0.002", "0.003"]);
        assert_eq!(labels((-1e300, 1e300), 2, Ladder::Decimal), ["\u{2212}1e300", "0e0", "1e300"]);
        assert_eq!(labels((980.0, 2040.0), 3, Ladder::Decimal), ["1000", "1500", "2000"]);
    }

    #[test]
    fn degrees_go_by_parts_of_a_turn() {
        assert_eq!(labels((-37.0, 37.0), 5, Ladder::Degrees), ["\u{2212}30", "\u{2212}15", "0", "15", "30"]);
        assert_eq!(labels((-1.0, 1.0), 4, Ladder::Degrees).len(), 5);
        assert_eq!(labels((0.0, 1500.0), 4, Ladder::Degrees), ["0", "900"]);
    }

    #[test]
    fn any_range_has_a_bounded_number() {
        for span in [1e-15, 1e-9, 1e-3, 0.7, 9.99, 360.0, 1e7, 1e12, 1e299] {
            for most in [1, 2, 5, 17] {
                for ladder in [Ladder::Decimal, Ladder::Degrees] {
                    let ticks = Ticks::between((-0.3 * span, 0.7 * span), most, ladder);
                    assert!(ticks.values.len() <= most + 1, "{span} {most} {ticks:?}");
                }
            }
        }
    }
}
