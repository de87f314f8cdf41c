//! Round numbers along an axis.

use super::Scale;

/// Which numbers count as round.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Ladder {
    /// 1, 2 and 5 times a power of ten.
    Decimal,
    /// The same up to 10, then the parts of a turn: 15, 30, 45, 90, and multiples of 180.
    Degrees,
}

/// The round values of an axis, in coordinates of its scale: each has a line, and those with a text a label.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Ticks(Vec<(f64, Option<String>)>);

impl Ticks {
    /// Round values on an axis of this scale; which count as round is the ladder's affair on a linear one.
    pub fn on(scale: Scale, range: (f64, f64), most: usize, ladder: Ladder) -> Self {
        match scale {
            Scale::Linear => Self::between(range, most, ladder),
            Scale::Logarithmic => Self::of_decades(range, most),
        }
    }

    /// At most about `most` round values in a range.
    pub fn between((low, high): (f64, f64), most: usize, ladder: Ladder) -> Self {
        let step = step((high - low) / most.max(1) as f64, ladder);
        // Multiples of the step, and not sums of it: sums drift.
        let (first, last) = (libm::ceil(low / step) as i64, libm::floor(high / step) as i64);
        // Digits after the point that tell them apart; `None` where powers of ten are shorter.
        let digits = (-libm::floor(libm::log10(step) + 1e-9)).max(0.0) as usize;
        let digits = (step < 1e6).then_some(digits);
        let value = |k: i64| k as f64 * step;
        Self((first..=last).map(|k| (value(k), Some(decimal(value(k), digits)))).collect())
    }

    /// Powers of ten in a range of logarithms, or, where that would be less than two numbers, 1, 2 and 5 times them; at
    /// most about `most` of them labelled.
    pub fn of_decades((low, high): (f64, f64), most: usize) -> Self {
        let most = most.max(1);
        let at = |digit: u32, power: i32| f64::from(power) + libm::log10(f64::from(digit));
        let fine = (libm::floor(low) as i32..=libm::floor(high) as i32)
            .flat_map(|power| [1, 2, 5].map(|digit| (digit, power)))
            .filter(|&(digit, power)| (low..=high).contains(&at(digit, power)));
        let fine: Vec<(u32, i32)> = fine.collect();
        let whole = fine.iter().filter(|(digit, _)| *digit == 1).count();
        let every = whole.div_ceil(most).max(1) as i32;
        let labelled = |digit: u32, power: i32| whole < 2 || (digit == 1 && power.rem_euclid(every) == 0);
        let few = fine.len() <= 3 * most;
        let marks = fine.into_iter().filter(|&(digit, power)| few || labelled(digit, power));
        Self(
            marks
                .map(|(digit, power)| {
                    (at(digit, power), labelled(digit, power).then(|| times_ten_to_the(digit, power)))
                })
                .collect(),
        )
    }

    /// Where lines are.
    pub fn lines(&self) -> impl Iterator<Item = f64> {
        self.0.iter().map(|mark| mark.0)
    }

    /// Where labels are, and what they say.
    pub fn labels(&self) -> impl Iterator<Item = (f64, String)> {
        self.0.iter().filter_map(|(at, label)| Some((*at, label.clone()?)))
    }
}

fn decimal(value: f64, digits: Option<usize>) -> String {
    let shown = match digits {
        Some(digits) => format!("{value:.digits$}"),
        None => format!("{value:.0e}"),
    };
    match shown.strip_prefix('-') {
        Some(digits) => format!("\u{2212}{digits}"),
        None => shown,
    }
}

/// 0.01, 5, 100; further out 2·10⁻⁵.
fn times_ten_to_the(digit: u32, power: i32) -> String {
    let value = f64::from(digit) * libm::pow(10.0, f64::from(power));
    match power {
        0..=3 => format!("{value}"),
        -3..=-1 => format!("{value:.*}", power.unsigned_abs() as usize),
        _ => {
            let power: String = power.to_string().chars().map(superscript).collect();
            if digit == 1 { format!("10{power}") } else { format!("{digit}·10{power}") }
        }
    }
}

fn superscript(c: char) -> char {
    match c {
        '-' => '⁻',
        '1' => '¹',
        '2' => '²',
        '3' => '³',
        '0' => '⁰',
        c => char::from_u32(0x2070 + c.to_digit(10).unwrap_or(0)).unwrap_or(c),
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
        Ticks::between(range, most, ladder).labels().map(|(_, label)| label).collect()
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
                    assert!(ticks.lines().count() <= most + 1, "{span} {most} {ticks:?}");
                }
            }
        }
    }

    #[test]
    fn decades_are_round_and_few() {
        let labels = |low, high, most| -> Vec<String> {
            Ticks::of_decades((low, high), most).labels().map(|(_, label)| label).collect()
        };
        assert_eq!(labels(-2.2, 3.3, 9), ["0.01", "0.1", "1", "10", "100", "1000"]);
        assert_eq!(labels(-6.1, -3.9, 9), ["10⁻⁶", "10⁻⁵", "10⁻⁴"]);
        assert_eq!(labels(-0.4, 0.9, 9), ["0.5", "1", "2", "5"]);
        assert_eq!(labels(-12.0, 12.0, 5).len(), 5);
    }
}
