//! Charts with two logarithmic axes: Allan deviations and spectra.
//!
//! ```text
//!  gyro_x (°/s)               ─ overlapping  ░ 68 %     title, unit, legend above the data
//!  10⁻¹ ┤╲
//!       │ ╲╲       N = 0.0323 °/s/√Hz                   a label at the place that it speaks of
//!  10⁻² ┤   ╲●
//!       └──┬────┬────┬── τ, s
//! ```

use std::fmt::Write as _;

use super::path::Projection;
use super::{STYLE, Stroke, escaped, px, text, text_width};

/// A line of a panel. What is not positive breaks it.
#[derive(Clone, Debug)]
pub struct Line {
    /// Its name in the legend; empty leaves it out there.
    pub label: String,
    /// How it is drawn.
    pub stroke: Stroke,
    /// Along and up.
    pub points: Vec<(f64, f64)>,
    /// Whether each point has a dot.
    pub dots: bool,
    /// Whether the axes are to show all of it; else it is cut off at them.
    pub sets_axes: bool,
}

/// What lies between two curves, in the colour of a line.
#[derive(Clone, Debug)]
pub struct Band {
    /// One of [`super::colour`].
    pub colour: &'static str,
    /// Along, lower, upper.
    pub points: Vec<(f64, f64, f64)>,
}

/// A dot with a text.
#[derive(Clone, Debug)]
pub struct Label {
    /// Along and up.
    pub at: (f64, f64),
    /// What it says.
    pub text: String,
    /// One of [`super::colour`].
    pub colour: &'static str,
}

/// A plot.
#[derive(Clone, Debug)]
pub struct Panel {
    /// What is plotted.
    pub title: String,
    /// Unit of the values.
    pub unit: String,
    /// Bands, under everything.
    pub bands: Vec<Band>,
    /// Lines, the first at the bottom.
    pub lines: Vec<Line>,
    /// Dots with text, over everything.
    pub labels: Vec<Label>,
}

/// Plots of one size in rows.
#[derive(Clone, Debug)]
pub struct Chart {
    /// Width, px.
    pub width: f64,
    /// Plots in a row.
    pub in_a_row: usize,
    /// Height of a plot, px.
    pub plot_height: f64,
    /// Title and note of a picture that stands alone.
    pub heading: Option<(String, String)>,
    /// What is to be seen, for those who do not see it.
    pub description: String,
    /// Name and unit of the axis along the bottom.
    pub x_title: &'static str,
    /// From left to right, then down.
    pub panels: Vec<Panel>,
}

const LEFT: f64 = 56.0;
const RIGHT: f64 = 18.0;
const HEADING_HEIGHT: f64 = 50.0;
const TITLE_ROW: f64 = 26.0;
const AXIS: f64 = 44.0;
/// Distance of two labels, one below the other, px.
const LINE: f64 = 13.0;

/// Decades that an axis shows.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Range {
    low: f64,
    high: f64,
}

impl Range {
    /// Around these values, with a little room.
    fn around(values: impl Iterator<Item = f64>) -> Self {
        let logs = values.filter(|v| *v > 0.0 && v.is_finite()).map(libm::log10);
        let (low, high) =
            logs.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
        if low > high {
            return Self { low: -1.0, high: 1.0 };
        }
        let margin = (0.05 * (high - low)).max(0.15);
        Self { low: low - margin, high: high + margin }
    }

    fn decades(self) -> std::ops::RangeInclusive<i32> {
        libm::ceil(self.low) as i32..=libm::floor(self.high) as i32
    }

    /// Place of a value, 0 to 1.
    fn place(self, value: f64) -> f64 {
        (libm::log10(value) - self.low) / (self.high - self.low)
    }

    /// Values for lines, and those of them that are labelled with their texts.
    fn ticks(self, most: usize) -> (Vec<f64>, Vec<(f64, String)>) {
        let power = |k: i32| libm::pow(10.0, f64::from(k));
        let all = || {
            (libm::floor(self.low) as i32..=libm::floor(self.high) as i32)
                .flat_map(|k| [1.0, 2.0, 5.0].into_iter().map(move |digit| (digit, k)))
        };
        let inside = |&(digit, k): &(f64, i32)| (0.0..=1.0).contains(&self.place(digit * power(k)));
        let fine: Vec<(f64, i32)> = all().filter(inside).collect();
        let whole: Vec<(f64, i32)> = self.decades().map(|k| (1.0, k)).collect();
        let every = whole.len().div_ceil(most.max(1)).max(1);
        // Less than two whole decades would be an axis with one number on it.
        let shown: Vec<(f64, i32)> = if whole.len() < 2 {
            fine.clone()
        } else {
            whole.into_iter().filter(|(_, k)| k.rem_euclid(every as i32) == 0).collect()
        };
        let lines = if fine.len() <= 3 * most { &fine } else { &shown };
        (
            lines.iter().map(|&(digit, k)| digit * power(k)).collect(),
            shown.iter().map(|&(digit, k)| (digit * power(k), label(digit, k))).collect(),
        )
    }
}

/// 0.01, 5, 100; further out 2·10⁻⁵.
fn label(digit: f64, k: i32) -> String {
    match k {
        0..=3 => format!("{}", digit * libm::pow(10.0, f64::from(k))),
        -3..=-1 => format!("{:.*}", k.unsigned_abs() as usize, digit * libm::pow(10.0, f64::from(k))),
        _ => {
            let power: String = k.to_string().chars().map(superscript).collect();
            if digit == 1.0 { format!("10{power}") } else { format!("{digit}·10{power}") }
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

impl Chart {
    /// The `<svg>` for a page that has [`STYLE`].
    pub fn to_svg(&self) -> String {
        self.draw("", "")
    }

    /// A file that stands alone.
    pub fn to_svg_file(&self) -> String {
        let background = format!(
            "<style>{STYLE}</style><rect width=\"{}\" height=\"{}\" rx=\"6\" fill=\"#fff\"/>",
            px(self.width),
            px(self.height()),
        );
        self.draw(" xmlns=\"http://www.w3.org/2000/svg\"", &background) + "\n"
    }

    fn first_top(&self) -> f64 {
        if self.heading.is_some() { HEADING_HEIGHT } else { 0.0 }
    }

    fn row_height(&self) -> f64 {
        TITLE_ROW + self.plot_height + AXIS
    }

    fn height(&self) -> f64 {
        self.first_top() + self.panels.len().div_ceil(self.in_a_row) as f64 * self.row_height()
    }

    fn draw(&self, attributes: &str, first: &str) -> String {
        let (width, height) = (px(self.width), px(self.height()));
        let mut svg = format!(
            "<svg{attributes} class=\"chart\" role=\"img\" aria-label=\"{}\" width=\"{width}\" \
             height=\"{height}\" viewBox=\"0 0 {width} {height}\">{first}",
            escaped(&self.description)
        );
        if let Some((title, note)) = &self.heading {
            let x = px(LEFT);
            text(&mut svg, &format!("class=\"h\" x=\"{x}\" y=\"26\""), title);
            text(&mut svg, &format!("class=\"n\" x=\"{x}\" y=\"44\""), note);
        }
        let across = self.width / self.in_a_row as f64;
        for (n, panel) in self.panels.iter().enumerate() {
            let place = Place {
                left: (n % self.in_a_row) as f64 * across + LEFT,
                top: self.first_top() + (n / self.in_a_row) as f64 * self.row_height() + TITLE_ROW,
                width: across - LEFT - RIGHT,
                height: self.plot_height,
            };
            panel.draw(&mut svg, &place, self.x_title);
        }
        svg.push_str("</svg>");
        svg
    }
}

/// Where a plot stands, px.
struct Place {
    left: f64,
    top: f64,
    width: f64,
    height: f64,
}

impl Panel {
    fn ranges(&self) -> (Range, Range) {
        let lines = self.lines.iter().filter(|line| line.sets_axes).flat_map(|line| &line.points);
        let (along, up): (Vec<f64>, Vec<f64>) = lines.copied().unzip();
        let bands = self.bands.iter().flat_map(|band| &band.points);
        let ends = bands.flat_map(|&(_, low, high)| [low, high]);
        (Range::around(along.into_iter()), Range::around(up.into_iter().chain(ends)))
    }

    fn draw(&self, svg: &mut String, place: &Place, x_title: &str) {
        let (x, y) = self.ranges();
        let Place { left, top, width, height } = *place;
        let along = |value: f64| x.place(value) * width;
        let up = |value: f64| (1.0 - y.place(value)) * height;
        let (x_lines, x_labels) = x.ticks((width / 46.0) as usize);
        let (y_lines, y_labels) = y.ticks((height / 22.0) as usize);

        // A drawing of its own clips what lies outside.
        let (w, h) = (px(width), px(height));
        let _ = write!(svg, "<svg x=\"{}\" y=\"{}\" width=\"{w}\" height=\"{h}\">", px(left), px(top));
        for value in x_lines {
            let _ = write!(svg, "<path class=\"g\" d=\"M{} 0V{h}\"/>", px(along(value)));
        }
        for value in y_lines {
            let _ = write!(svg, "<path class=\"g\" d=\"M0 {}H{w}\"/>", px(up(value)));
        }
        for band in &self.bands {
            let forth = band.points.iter().map(|&(x, low, _)| (x, low));
            let back = band.points.iter().rev().map(|&(x, _, high)| (x, high));
            let corners: Vec<String> = forth
                .chain(back)
                .filter(|&(x, y)| x > 0.0 && y > 0.0)
                .map(|(x, y)| {
                    let tenths = |v: f64| libm::rint(v.clamp(-1e5, 1e5) * 10.0) as i32;
                    format!("{} {}", tenths(along(x)), tenths(up(y)))
                })
                .collect();
            if !corners.is_empty() {
                let d = corners.join("L");
                let _ = write!(svg, "<path class=\"f\" style=\"fill:{}\" d=\"M{d}Z\"/>", band.colour);
            }
        }
        let projection = Projection { time_s: (x.low, x.high), values: (y.low, y.high), width, height };
        for line in &self.lines {
            let log = |v: f64| if v > 0.0 { libm::log10(v) } else { f64::NAN };
            let points: Vec<(f64, f64)> = line.points.iter().map(|&(x, y)| (log(x), log(y))).collect();
            let Stroke { colour, width, dashed } = line.stroke;
            let dash = if dashed { " stroke-dasharray=\"50 40\"" } else { "" };
            let _ = write!(
                svg,
                "<path class=\"l\" stroke=\"{colour}\" stroke-width=\"{}\"{dash} d=\"{}\"/>",
                px(width * 10.0),
                projection.path(&points)
            );
            for &(x, y) in line.points.iter().filter(|(x, y)| line.dots && *x > 0.0 && *y > 0.0) {
                dot(svg, (along(x), up(y)), 2.4, colour);
            }
        }
        for label in &self.labels {
            dot(svg, (along(label.at.0), up(label.at.1)), 4.0, label.colour);
        }
        svg.push_str("</svg>");

        let mut taken: Vec<(f64, f64, f64)> = Vec::new();
        for label in &self.labels {
            // To the upper right, where a falling curve is not; turned round at the right edge.
            let (x, y) = (left + along(label.at.0), top + up(label.at.1));
            let length = text_width(&label.text);
            let leftwards = x + 8.0 + length > left + width;
            let (class, x) = if leftwards { ("q e", x - 8.0) } else { ("q", x + 8.0) };
            let from = if leftwards { x - length } else { x };
            // Lower or higher by lines if another label stands there.
            let place = |shift: f64| (y + shift).clamp(top + 12.0, top + height - 6.0);
            let free = |y: f64| {
                taken.iter().all(|&(f, t, other)| t < from || from + length < f || (y - other).abs() >= LINE)
            };
            let shifts = [-7.0, 11.0, -7.0 - LINE, 11.0 + LINE, -7.0 - 2.0 * LINE, 11.0 + 2.0 * LINE];
            let y = shifts.into_iter().map(place).find(|y| free(*y)).unwrap_or(place(-7.0));
            taken.push((from, from + length, y));
            let attributes =
                format!("class=\"{class}\" style=\"fill:{}\" x=\"{}\" y=\"{}\"", label.colour, px(x), px(y));
            text(svg, &attributes, &label.text);
        }
        let bottom = top + height;
        let _ = write!(svg, "<path class=\"a\" d=\"M{} {}h{w}\"/>", px(left), px(bottom));
        for (value, label) in x_labels {
            let attributes =
                format!("class=\"k c\" x=\"{}\" y=\"{}\"", px(left + along(value)), px(bottom + 16.0));
            text(svg, &attributes, &label);
        }
        for (value, label) in y_labels {
            let attributes =
                format!("class=\"k e\" x=\"{}\" y=\"{}\"", px(left - 7.0), px(top + up(value) + 4.0));
            text(svg, &attributes, &label);
        }
        let attributes = format!("class=\"u e\" x=\"{}\" y=\"{}\"", px(left + width), px(bottom + 31.0));
        text(svg, &attributes, x_title);
        let _ = write!(
            svg,
            "<text class=\"t\" x=\"{}\" y=\"{}\">{} <tspan class=\"u\">({})</tspan></text>",
            px(left),
            px(top - 9.0),
            escaped(&self.title),
            escaped(&self.unit)
        );
        self.draw_legend(svg, left + width, top - 9.0);
    }

    fn draw_legend(&self, svg: &mut String, right: f64, y: f64) {
        const SWATCH: f64 = 22.0;
        let mut x = right;
        for line in self.lines.iter().rev().filter(|line| !line.label.is_empty()) {
            x -= text_width(&line.label);
            text(svg, &format!("class=\"n\" x=\"{}\" y=\"{}\"", px(x), px(y)), &line.label);
            let Stroke { colour, width, dashed } = line.stroke;
            let dash = if dashed { " stroke-dasharray=\"5 4\"" } else { "" };
            let _ = write!(
                svg,
                "<path stroke=\"{colour}\" stroke-width=\"{}\"{dash} d=\"M{} {}h{SWATCH}\"/>",
                px(width.max(1.5)),
                px(x - SWATCH - 6.0),
                px(y - 4.0)
            );
            x -= SWATCH + 6.0 + 14.0;
        }
    }
}

fn dot(svg: &mut String, (x, y): (f64, f64), radius: f64, colour: &str) {
    let (x, y) = (px(x.clamp(-1e5, 1e5)), px(y.clamp(-1e5, 1e5)));
    let _ = write!(svg, "<circle cx=\"{x}\" cy=\"{y}\" r=\"{radius}\" fill=\"{colour}\"/>");
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chart::colour;

    fn chart(points: Vec<(f64, f64)>) -> Chart {
        let band = Band {
            colour: colour::SKY,
            points: points.iter().map(|&(x, y)| (x, y * 0.9, y * 1.1)).collect(),
        };
        let label = Label { at: (1.0, 0.1), text: "N < 1".into(), colour: colour::BLACK };
        let stroke = Stroke::solid(colour::BLUE, 1.5);
        let line = Line { label: "a & b".into(), stroke, points, dots: true, sets_axes: true };
        let panel = Panel {
            title: "x".into(),
            unit: "°/s".into(),
            bands: vec![band],
            lines: vec![line],
            labels: vec![label],
        };
        Chart {
            width: 400.0,
            in_a_row: 2,
            plot_height: 100.0,
            heading: None,
            description: "d".into(),
            x_title: "τ, s",
            panels: vec![panel.clone(), panel],
        }
    }

    #[test]
    fn whatever_is_plotted_every_coordinate_is_a_number() {
        for points in [
            vec![],
            vec![(1.0, 1.0)],
            vec![(0.0, -1.0), (f64::NAN, 1.0), (1.0, f64::INFINITY)],
            vec![(1e-300, 1e-300), (1e300, 1e300)],
            vec![(1.0, 5.0), (2.0, 5.1)],
        ] {
            let svg = chart(points.clone()).to_svg_file();
            assert!(!svg.contains("NaN") && !svg.contains("inf"), "{points:?}: {svg}");
            assert!(svg.contains("a &amp; b") && svg.contains("N &lt; 1"));
        }
    }

    #[test]
    fn numbers_on_an_axis_are_round_and_few() {
        let labels = |low, high, most| {
            Range { low, high }.ticks(most).1.into_iter().map(|(_, label)| label).collect::<Vec<_>>()
        };
        assert_eq!(labels(-2.2, 3.3, 9), ["0.01", "0.1", "1", "10", "100", "1000"]);
        assert_eq!(labels(-6.1, -3.9, 9), ["10⁻⁶", "10⁻⁵", "10⁻⁴"]);
        assert_eq!(labels(-0.4, 0.9, 9), ["0.5", "1", "2", "5"]);
        assert_eq!(labels(-12.0, 12.0, 5).len(), 5);
    }
}
