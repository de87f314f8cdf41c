//! The ticks of an axis, at round numbers.

use super::Scale;

/// The step sizes that count as round.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum StepLadder {
    /// 1, 2 and 5 times a power of ten.
    Decimal,
    /// The same up to 10, then fractions of a turn: 15, 30, 45, 90, and multiples of 180.
    Degrees,
}

/// The ticks of an axis, in coordinates of its scale. Each tick has a grid line; a tick with a text has a label.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Ticks(Vec<(f64, Option<String>)>);

impl Ticks {
    /// Returns the ticks of an axis of this scale. `ladder` applies to linear axes only.
    pub fn on(scale: Scale, range: (f64, f64), max_ticks: usize, ladder: StepLadder) -> Self {
        match scale {
            Scale::Linear => Self::between(range, max_ticks, ladder),
            Scale::Logarithmic => Self::of_decades(range, max_ticks),
        }
    }

    /// Returns at most about `max_ticks` ticks in a linear range.
    pub fn between((low, high): (f64, f64), max_ticks: usize, ladder: StepLadder) -> Self {
        let step = step((high - low) / max_ticks.max(1) as f64, ladder);
        // Multiples of the step instead of sums, whose rounding errors would grow.
        let (first, last) = (libm::ceil(low / step) as i64, libm::floor(high / step) as i64);
        // Digits after the point that distinguish the ticks; `None` if the exponential form is shorter.
        let digits = (-libm::floor(libm::log10(step) + 1e-9)).max(0.0) as usize;
        let digits = (step < 1e6).then_some(digits);
        let value = |k: i64| k as f64 * step;
        Self((first..=last).map(|k| (value(k), Some(decimal(value(k), digits)))).collect())
    }

    /// Returns ticks in a range of logarithms, with at most about `max_ticks` labels: powers of ten, or 1, 2 and 5 times
    /// powers of ten if the range has fewer than two of those.
    pub fn of_decades((low, high): (f64, f64), max_ticks: usize) -> Self {
        let max_ticks = max_ticks.max(1);
        let at = |digit: u32, power: i32| f64::from(power) + libm::log10(f64::from(digit));
        let fine = (libm::floor(low) as i32..=libm::floor(high) as i32)
            .flat_map(|power| [1, 2, 5].map(|digit| (digit, power)))
            .filter(|&(digit, power)| (low..=high).contains(&at(digit, power)));
        let fine: Vec<(u32, i32)> = fine.collect();
        let whole = fine.iter().filter(|(digit, _)| *digit == 1).count();
        let every = whole.div_ceil(max_ticks).max(1) as i32;
        let labelled = |digit: u32, power: i32| whole < 2 || (digit == 1 && power.rem_euclid(every) == 0);
        let few = fine.len() <= 3 * max_ticks;
        let marks = fine.into_iter().filter(|&(digit, power)| few || labelled(digit, power));
        Self(
            marks
                .map(|(digit, power)| {
                    (at(digit, power), labelled(digit, power).then(|| times_ten_to_the(digit, power)))
                })
                .collect(),
        )
    }

    /// Returns the coordinates of the grid lines.
    pub fn lines(&self) -> impl Iterator<Item = f64> {
        self.0.iter().map(|mark| mark.0)
    }

    /// Returns the coordinates and texts of the labels.
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

/// Formats a power of ten times a digit: 0.01, 5, 100; with an exponent beyond ±3, such as 2·10⁻⁵.
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

/// Returns the smallest round step that is not below `minimum`.
fn step(minimum: f64, ladder: StepLadder) -> f64 {
    let minimum = minimum.clamp(1e-12, 1e300);
    if ladder == StepLadder::Degrees && minimum > 10.0 {
        let part = [15.0, 30.0, 45.0, 90.0, 180.0].into_iter().find(|&part| part >= minimum);
        return part.unwrap_or_else(|| 180.0 * step(minimum / 180.0, StepLadder::Decimal));
    }
    let power = libm::pow(10.0, libm::floor(libm::log10(minimum)));
    // A step that is smaller only by rounding is large enough.
    let enough = minimum * (1.0 - 1e-9);
    [1.0, 2.0, 5.0].into_iter().map(|k| k * power).find(|&s| s >= enough).unwrap_or(10.0 * power)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(range: (f64, f64), max_ticks: usize, ladder: StepLadder) -> Vec<String> {
        Ticks::between(range, max_ticks, ladder).labels().map(|(_, label)| label).collect()
    }

    #[test]
    fn linear_ticks_are_round() {
        assert_eq!(labels((0.0, 30.0), 6, StepLadder::Decimal), ["0", "5", "10", "15", "20", "25", "30"]);
        assert_eq!(labels((-0.13, 0.27), 4, StepLadder::Decimal), ["\u{2212}0.1", "0.0", "0.1", "0.2"]);
        assert_eq!(labels((0.0, 0.003), 3, StepLadder::Decimal), ["0.000", "0.001", "0.002", "0.003"]);
        assert_eq!(labels((-1e300, 1e300), 2, StepLadder::Decimal), ["\u{2212}1e300", "0e0", "1e300"]);
        assert_eq!(labels((980.0, 2040.0), 3, StepLadder::Decimal), ["1000", "1500", "2000"]);
    }

    #[test]
    fn degree_ticks_are_fractions_of_a_turn() {
        assert_eq!(
            labels((-37.0, 37.0), 5, StepLadder::Degrees),
            ["\u{2212}30", "\u{2212}15", "0", "15", "30"]
        );
        assert_eq!(labels((-1.0, 1.0), 4, StepLadder::Degrees).len(), 5);
        assert_eq!(labels((0.0, 1500.0), 4, StepLadder::Degrees), ["0", "900"]);
    }

    #[test]
    fn number_of_ticks_is_bounded_for_any_range() {
        for span in [1e-15, 1e-9, 1e-3, 0.7, 9.99, 360.0, 1e7, 1e12, 1e299] {
            for max_ticks in [1, 2, 5, 17] {
                for ladder in [StepLadder::Decimal, StepLadder::Degrees] {
                    let ticks = Ticks::between((-0.3 * span, 0.7 * span), max_ticks, ladder);
                    assert!(ticks.lines().count() <= max_ticks + 1, "{span} {max_ticks} {ticks:?}");
                }
            }
        }
    }

    #[test]
    fn logarithmic_ticks_are_round_and_few() {
        let labels = |low, high, max_ticks| -> Vec<String> {
            Ticks::of_decades((low, high), max_ticks).labels().map(|(_, label)| label).collect()
        };
        assert_eq!(labels(-2.2, 3.3, 9), ["0.01", "0.1", "1", "10", "100", "1000"]);
        assert_eq!(labels(-6.1, -3.9, 9), ["10⁻⁶", "10⁻⁵", "10⁻⁴"]);
        assert_eq!(labels(-0.4, 0.9, 9), ["0.5", "1", "2", "5"]);
        assert_eq!(labels(-12.0, 12.0, 5).len(), 5);
    }
}
