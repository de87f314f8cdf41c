//! Line charts, as SVG.
//!
//! A chart is panels in rows. Over time they stand below each other and share one axis, and the moments that are marked:
//!
//! ```text
//!  heading, note                     (a picture that stands alone)
//!  Roll (°)       ─ truth ─ estimate    title, unit, legend: above the data, never over it
//!        ┆ armed      disarmed ┆        marks, through all panels
//!  30 ┤  ┆    ╭╮               ┆
//!   0 ┤──┆────╯╰──────╮╭───────┆─────
//!     └───────┬────────┬────────┬────
//!             5       10       15  time, s
//! ```
//!
//! With a [`Scale::Logarithmic`], as for Allan deviations, spectra, and errors against costs, each has its own:
//!
//! ```text
//!  gyro_x (°/s)               ─ overlapping  ░ 68 %
//!  10⁻¹ ┤╲
//!       │ ╲╲       N = 0.0323 °/s/√Hz                   a label at the place that it speaks of
//!  10⁻² ┤   ╲●
//!       └──┬────┬────┬── τ, s
//! ```
//!
//! Written by hand and not by a plotting crate, because the page is to be small, equal to the byte for equal
//! flights, and set in the reader's own fonts. Lines are thinned to what a screen can show; a peak of a
//! single sample stays.

mod panel;
mod path;
mod ticks;

use std::fmt::Write as _;

use maud::Render;
use panel::Place;
use path::along_px;
use ticks::{Ladder, Ticks};

/// The Okabe-Ito colours, which stay apart in every common kind of colour blindness.
pub mod colour {
    /// Black.
    pub const BLACK: &str = "#000";
    /// Grey, for what is only a frame of reference.
    pub const GREY: &str = "#777";
    /// Orange.
    pub const ORANGE: &str = "#e69f00";
    /// Sky blue.
    pub const SKY: &str = "#56b4e9";
    /// Bluish green.
    pub const GREEN: &str = "#009e73";
    /// Blue.
    pub const BLUE: &str = "#0072b2";
    /// Vermillion.
    pub const VERMILLION: &str = "#d55e00";
    /// Reddish purple.
    pub const PURPLE: &str = "#cc79a7";
}

/// The styles of a chart's parts: for the `<style>` of a page that charts stand in.
pub const STYLE: &str = include_str!("chart/style.css");

/// How a line is drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stroke {
    /// One of [`colour`].
    pub colour: &'static str,
    /// Width, px.
    pub width: f64,
    /// Whether it is dashed.
    pub dashed: bool,
}

impl Stroke {
    /// A line of this width, px.
    pub const fn solid(colour: &'static str, width: f64) -> Self {
        Self { colour, width, dashed: false }
    }

    /// A dashed line of this width, px.
    pub const fn dashed(colour: &'static str, width: f64) -> Self {
        Self { colour, width, dashed: true }
    }
}

/// How values become places along an axis.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Scale {
    /// Equal differences are equally far apart.
    #[default]
    Linear,
    /// Equal ratios are. A value that is not positive has no place.
    Logarithmic,
}

impl Scale {
    /// Where a value is along the axis: itself, or its decimal logarithm; NaN without a place.
    fn of(self, value: f64) -> f64 {
        match self {
            Self::Linear => value,
            Self::Logarithmic if value > 0.0 => libm::log10(value),
            Self::Logarithmic => f64::NAN,
        }
    }
}

/// A line of a panel.
#[derive(Clone, Debug)]
pub struct Line {
    /// Its name in the legend; empty leaves it out there.
    pub label: String,
    /// How it is drawn.
    pub stroke: Stroke,
    /// Along and up. A value without a place breaks the line.
    pub points: Vec<(f64, f64)>,
    /// Whether each point has a dot.
    pub dots: bool,
    /// Whether the axes are to show all of it; else it is cut off at them.
    pub sets_axes: bool,
}

impl Line {
    /// A line without dots that the axes show all of.
    pub fn new(label: impl Into<String>, stroke: Stroke, points: Vec<(f64, f64)>) -> Self {
        Self { label: label.into(), stroke, points, dots: false, sets_axes: true }
    }
}

/// What lies between two curves, in the colour of a line.
#[derive(Clone, Debug)]
pub struct Band {
    /// One of [`colour`].
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
    /// One of [`colour`].
    pub colour: &'static str,
}

/// A second scale on the right for the same lines: `value = zero + per_unit · left`.
#[derive(Clone, Copy, Debug)]
pub struct RightAxis {
    /// Its unit.
    pub unit: &'static str,
    /// Its value where the left axis is 0.
    pub zero: f64,
    /// Its change per unit of the left axis.
    pub per_unit: f64,
}

/// A plot in a chart.
#[derive(Clone, Debug)]
pub struct Panel {
    /// What is plotted.
    pub title: String,
    /// Unit of the values.
    pub unit: String,
    /// Height of the plot, px.
    pub height: f64,
    /// Values that the axis covers in any case.
    pub covers: Vec<f64>,
    /// The axis covers at least this much, so that rounding errors do not fill a plot.
    pub least_span: f64,
    /// A second scale.
    pub right: Option<RightAxis>,
    /// Bands, under everything.
    pub bands: Vec<Band>,
    /// The lines, the first at the bottom.
    pub lines: Vec<Line>,
    /// Dots with text, over everything.
    pub labels: Vec<Label>,
}

impl Panel {
    /// Lines, and nothing else.
    pub fn new(title: impl Into<String>, unit: impl Into<String>, height: f64, lines: Vec<Line>) -> Self {
        Self {
            title: title.into(),
            unit: unit.into(),
            height,
            covers: Vec::new(),
            least_span: 0.0,
            right: None,
            bands: Vec::new(),
            lines,
            labels: Vec::new(),
        }
    }
}

/// A moment, drawn through all panels.
#[derive(Clone, Debug)]
pub struct Mark {
    /// Where on the axis of all panels: time, s.
    pub time_s: f64,
    /// What happened.
    pub label: String,
    /// One of [`colour`].
    pub colour: &'static str,
}

/// Panels in rows.
#[derive(Clone, Debug)]
pub struct Chart {
    /// Width, px.
    pub width: f64,
    /// Of both axes.
    pub scale: Scale,
    /// Panels in a row.
    pub columns: usize,
    /// Title and note of a picture that stands alone.
    pub heading: Option<(String, String)>,
    /// What is to be seen, for those who do not see it.
    pub description: String,
    /// First and last value of the one axis of all panels, below the last; without it each has its own.
    pub along: Option<(f64, f64)>,
    /// Name and unit of the axis along the bottom.
    pub x_title: &'static str,
    /// From left to right, then down.
    pub panels: Vec<Panel>,
    /// Moments.
    pub marks: Vec<Mark>,
}

impl Chart {
    /// Panels below each other over one time, s.
    pub fn over_time(
        width: f64,
        description: impl Into<String>,
        time_s: (f64, f64),
        panels: Vec<Panel>,
    ) -> Self {
        Self {
            width,
            scale: Scale::Linear,
            columns: 1,
            heading: None,
            description: description.into(),
            along: Some(time_s),
            x_title: "time, s",
            panels,
            marks: Vec::new(),
        }
    }

    /// Panels with two logarithmic axes each.
    pub fn logarithmic(
        width: f64,
        description: impl Into<String>,
        x_title: &'static str,
        panels: Vec<Panel>,
    ) -> Self {
        Self {
            width,
            scale: Scale::Logarithmic,
            columns: 1,
            heading: None,
            description: description.into(),
            along: None,
            x_title,
            panels,
            marks: Vec::new(),
        }
    }
}

const LEFT: f64 = 52.0;
const RIGHT: f64 = 14.0;
const RIGHT_WITH_AXIS: f64 = 46.0;
const HEADING_HEIGHT: f64 = 50.0;
const MARK_ROW: f64 = 16.0;
const TITLE_ROW: f64 = 26.0;
const BELOW_PANEL: f64 = 4.0;
const X_AXIS: f64 = 38.0;
/// Smallest distance between the labels of an axis, px: up and down, and along.
const TICK_DISTANCE_Y: f64 = 19.0;
const TICK_DISTANCE_X: f64 = 56.0;
/// What has gone as far as this, as before a crash for numbers that are not finite, does not set the axis.
const BEYOND_PLOTTING: f64 = 1e12;
/// Size of labels, px.
const FONT_SIZE: f64 = 12.0;

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

    fn right(&self) -> f64 {
        if self.panels.iter().any(|panel| panel.right.is_some()) { RIGHT_WITH_AXIS } else { RIGHT }
    }

    /// From the left edge of a panel to that of the next, px.
    fn across(&self) -> f64 {
        self.width / self.columns.max(1) as f64
    }

    fn plot_width(&self) -> f64 {
        self.across() - LEFT - self.right()
    }

    /// Height of the rows of the marks' labels, between the first panel's title and its plot.
    fn marks_height(&self) -> f64 {
        let rows = self.mark_labels().iter().map(|label| label.row + 1).max().unwrap_or(0);
        rows as f64 * MARK_ROW
    }

    /// Top of the first panel's title.
    fn first_top(&self) -> f64 {
        if self.heading.is_some() { HEADING_HEIGHT } else { 0.0 }
    }

    /// Below a row of panels: the axis, if each has its own.
    fn below(&self) -> f64 {
        if self.along.is_some() { BELOW_PANEL } else { X_AXIS }
    }

    fn rows(&self) -> std::slice::Chunks<'_, Panel> {
        self.panels.chunks(self.columns.max(1))
    }

    /// Height of the whole chart, px.
    pub fn height(&self) -> f64 {
        let rows = self.rows().map(|row| TITLE_ROW + tallest(row) + self.below());
        let last = if self.along.is_some() { X_AXIS } else { 0.0 };
        self.first_top() + self.marks_height() + rows.sum::<f64>() + last
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
        let mut top = self.first_top();
        let mut bottom = top;
        for (n, row) in self.rows().enumerate() {
            let marks = if n == 0 { self.marks_height() } else { 0.0 };
            for (column, panel) in row.iter().enumerate() {
                let place = Place {
                    left: column as f64 * self.across() + LEFT,
                    top: top + TITLE_ROW + marks,
                    width: self.plot_width(),
                    height: panel.height,
                };
                let titles = top + TITLE_ROW - 9.0;
                panel.draw_titles(&mut svg, &place, titles, column as f64 * self.across() + self.across());
                if n == 0 && column == 0 {
                    self.draw_mark_labels(&mut svg, place.top);
                }
                let along = self.range(panel);
                let ticks = self.x_ticks(along);
                panel.draw(&mut svg, &place, self.scale, along, &ticks, &self.marks);
                bottom = place.top + panel.height;
                if self.along.is_none() {
                    self.draw_x_axis(&mut svg, (place.left, bottom), along, &ticks);
                }
            }
            top += TITLE_ROW + marks + tallest(row) + self.below();
        }
        if let Some(along) = self.along {
            self.draw_x_axis(&mut svg, (LEFT, bottom), along, &self.x_ticks(along));
        }
        svg.push_str("</svg>");
        svg
    }

    /// The range of the axis along the bottom of a panel, in coordinates of the scale.
    fn range(&self, panel: &Panel) -> (f64, f64) {
        let coordinates = |(low, high)| (self.scale.of(low), self.scale.of(high));
        self.along.map_or_else(|| panel.range_along(self.scale), coordinates)
    }

    fn x_ticks(&self, range: (f64, f64)) -> Ticks {
        let most = (self.plot_width() / TICK_DISTANCE_X) as usize;
        Ticks::on(self.scale, range, most, Ladder::Decimal)
    }

    fn draw_x_axis(&self, svg: &mut String, (left, y): (f64, f64), range: (f64, f64), ticks: &Ticks) {
        let _ = write!(svg, "<path class=\"a\" d=\"M{} {}h{}\"/>", px(left), px(y), px(self.plot_width()));
        for (at, label) in ticks.labels() {
            let x = px(left + along_px(range, self.plot_width(), at));
            let _ = write!(svg, "<path class=\"a\" d=\"M{x} {}v4\"/>", px(y));
            text(svg, &format!("class=\"k c\" x=\"{x}\" y=\"{}\"", px(y + 17.0)), &label);
        }
        let place = format!("class=\"u e\" x=\"{}\" y=\"{}\"", px(left + self.plot_width()), px(y + 33.0));
        text(svg, &place, self.x_title);
    }

    /// Place of a mark in the plot, px from its left edge.
    fn mark_px(&self, mark: &Mark) -> f64 {
        let (first, last) = self.along.unwrap_or_default();
        along_px((self.scale.of(first), self.scale.of(last)), self.plot_width(), self.scale.of(mark.time_s))
    }

    /// The marks' labels, above the first plot, whose top is at `bottom`.
    fn draw_mark_labels(&self, svg: &mut String, bottom: f64) {
        for (mark, label) in self.marks.iter().zip(self.mark_labels()) {
            let y = bottom - label.row as f64 * MARK_ROW;
            let x = LEFT + self.mark_px(mark);
            // From the label down to the first plot; the plots draw their own part.
            let _ = write!(
                svg,
                "<path class=\"m\" stroke=\"{}\" d=\"M{} {}V{}\"/>",
                mark.colour,
                px(x),
                px(y - 11.0),
                px(bottom)
            );
            let (class, x) = if label.leftwards { ("n e", x - 5.0) } else { ("n", x + 5.0) };
            let place =
                format!("class=\"{class}\" fill=\"{}\" x=\"{}\" y=\"{}\"", mark.colour, px(x), px(y - 2.0));
            text(svg, &place, &mark.label);
        }
    }

    /// Places the marks' labels so that none covers another.
    fn mark_labels(&self) -> Vec<MarkLabel> {
        let mut placed: Vec<(usize, f64, f64)> = Vec::new();
        let place = |mark: &Mark| {
            let x = self.mark_px(mark);
            let length = text_width(&mark.label) + 10.0;
            let leftwards = x + length > self.plot_width();
            let (from, to) = if leftwards { (x - length, x) } else { (x, x + length) };
            let free = |row: usize| placed.iter().all(|&(r, f, t)| r != row || to < f || t < from);
            let row = (0..).find(|&row| free(row)).unwrap_or(0);
            placed.push((row, from, to));
            MarkLabel { row, leftwards }
        };
        self.marks.iter().map(place).collect()
    }
}

/// In a page.
impl Render for Chart {
    fn render_to(&self, page: &mut String) {
        page.push_str(&self.to_svg());
    }
}

/// Where the label of a mark stands.
struct MarkLabel {
    /// Rows above the lowest.
    row: usize,
    /// Whether it stands to the left of its line.
    leftwards: bool,
}

/// Height of the tallest plot in a row, px.
fn tallest(row: &[Panel]) -> f64 {
    row.iter().map(|panel| panel.height).fold(0.0, f64::max)
}

/// A length in px, with as many digits as it needs.
fn px(value: f64) -> String {
    let rounded = libm::round(value * 10.0) / 10.0;
    // Not "-0".
    format!("{}", rounded + 0.0)
}

/// Width of a label, px: that of a wide font, since the reader's is not known here.
fn text_width(label: &str) -> f64 {
    let em = |c: char| match c {
        ' ' | '\'' | ',' | '.' | ':' | 'f' | 'i' | 'j' | 'l' | 'r' | 't' => 0.38,
        'm' | 'w' | 'M' | 'W' => 0.95,
        _ => 0.63,
    };
    label.chars().map(em).sum::<f64>() * FONT_SIZE
}

fn text(svg: &mut String, attributes: &str, content: &str) {
    let _ = write!(svg, "<text {attributes}>{}</text>", escaped(content));
}

/// Text as XML and HTML take it, in an element or in a quoted attribute. Control characters, which they do
/// not take, become the replacement character.
pub fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            '\n' | '\t' => out.push(' '),
            c if c.is_control() => out.push(char::REPLACEMENT_CHARACTER),
            c => out.push(c),
        }
    }
    out
}

#[cfg(test)]
mod tests;
