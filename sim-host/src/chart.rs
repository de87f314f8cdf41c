//! Line charts, as SVG.
//!
//! A chart consists of panels in rows. In a chart over time the panels are below each other, and share one time axis
//! and the marked events:
//!
//! ```text
//!  heading, note                     (in a separate picture)
//!  Roll (°)       ─ truth ─ estimate    title, unit, legend: above the data, never over it
//!        ┆ armed      disarmed ┆        marks, through all panels
//!  30 ┤  ┆    ╭╮               ┆
//!   0 ┤──┆────╯╰──────╮╭───────┆─────
//!     └───────┬────────┬────────┬────
//!             5       10       15  time, s
//! ```
//!
//! With [`Scale::Logarithmic`], for Allan deviations, spectra, and errors against costs, each panel has its own axes:
//!
//! ```text
//!  gyro_x (°/s)               ─ overlapping  ░ 68 %
//!  10⁻¹ ┤╲
//!       │ ╲╲       N = 0.0323 °/s/√Hz                   a label at the point that it describes
//!  10⁻² ┤   ╲●
//!       └──┬────┬────┬── τ, s
//! ```
//!
//! This module replaces a plotting crate, because a page must be small, identical to the byte for identical flights,
//! and use the reader's own fonts. Lines are reduced to the points that a screen can show; a peak of a single sample
//! stays visible.

mod panel;
mod path;
mod ticks;

use std::fmt::Write as _;

use maud::Render;
use panel::PlotArea;
use path::along_px;
use ticks::{StepLadder, Ticks};

/// The Okabe-Ito colours, which are distinguishable in every common kind of colour blindness.
pub mod colour {
    /// Black.
    pub const BLACK: &str = "#000";
    /// Grey, for reference lines.
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

/// The CSS of charts, for the `<style>` of a page that contains them.
pub const STYLE: &str = include_str!("chart/style.css");

/// Colour, width and dashing of a line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stroke {
    /// One of [`colour`].
    pub colour: &'static str,
    /// Width, px.
    pub width: f64,
    /// True if the line is dashed.
    pub dashed: bool,
}

impl Stroke {
    /// Creates a solid stroke of this width, px.
    pub const fn solid(colour: &'static str, width: f64) -> Self {
        Self { colour, width, dashed: false }
    }

    /// Creates a dashed stroke of this width, px.
    pub const fn dashed(colour: &'static str, width: f64) -> Self {
        Self { colour, width, dashed: true }
    }
}

/// The scale of an axis.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Scale {
    /// Equal differences have equal distances.
    #[default]
    Linear,
    /// Equal ratios have equal distances. Only positive values can be shown.
    Logarithmic,
}

impl Scale {
    /// Returns the coordinate of a value: the value itself, or its decimal logarithm; NaN if it cannot be shown.
    fn coordinate(self, value: f64) -> f64 {
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
    /// Name in the legend; empty for a line without a legend entry.
    pub label: String,
    /// Appearance of the line.
    pub stroke: Stroke,
    /// x and y of each point. A value that cannot be shown breaks the line.
    pub points: Vec<(f64, f64)>,
    /// True if each point has a dot.
    pub dots: bool,
    /// True if the axes must cover the whole line; otherwise it is clipped at them.
    pub sets_axes: bool,
}

impl Line {
    /// Creates a line without dots, which the axes cover.
    pub fn new(label: impl Into<String>, stroke: Stroke, points: Vec<(f64, f64)>) -> Self {
        Self { label: label.into(), stroke, points, dots: false, sets_axes: true }
    }
}

/// The area between two curves.
#[derive(Clone, Debug)]
pub struct Band {
    /// One of [`colour`].
    pub colour: &'static str,
    /// x, lower y, upper y.
    pub points: Vec<(f64, f64, f64)>,
}

/// A dot with a text.
#[derive(Clone, Debug)]
pub struct Label {
    /// x and y of the dot.
    pub at: (f64, f64),
    /// The text.
    pub text: String,
    /// One of [`colour`].
    pub colour: &'static str,
}

/// A second scale on the right for the same lines: `value = zero + per_unit · left`.
#[derive(Clone, Copy, Debug)]
pub struct RightAxis {
    /// Unit of the right axis.
    pub unit: &'static str,
    /// Value of the right axis where the left axis is 0.
    pub zero: f64,
    /// Change of the right axis per unit of the left axis.
    pub per_unit: f64,
}

/// A plot in a chart.
#[derive(Clone, Debug)]
pub struct Panel {
    /// Title: the quantity that is plotted.
    pub title: String,
    /// Unit of the values.
    pub unit: String,
    /// Height of the plot, px.
    pub height: f64,
    /// Values that the axis always includes.
    pub includes: Vec<f64>,
    /// Minimum span of the axis, so that rounding errors do not fill a plot.
    pub min_span: f64,
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
    /// Creates a panel with lines only.
    pub fn new(title: impl Into<String>, unit: impl Into<String>, height: f64, lines: Vec<Line>) -> Self {
        Self {
            title: title.into(),
            unit: unit.into(),
            height,
            includes: Vec::new(),
            min_span: 0.0,
            right: None,
            bands: Vec::new(),
            lines,
            labels: Vec::new(),
        }
    }
}

/// An event, drawn as a vertical line through all panels.
#[derive(Clone, Debug)]
pub struct Mark {
    /// Time, s.
    pub time_s: f64,
    /// Text at the line.
    pub label: String,
    /// One of [`colour`].
    pub colour: &'static str,
}

/// A chart: panels in rows.
#[derive(Clone, Debug)]
pub struct Chart {
    /// Width, px.
    pub width: f64,
    /// Scale of both axes.
    pub scale: Scale,
    /// Panels in a row.
    pub columns: usize,
    /// Title and note of a separate picture.
    pub heading: Option<(String, String)>,
    /// Description of the content, for screen readers.
    pub description: String,
    /// Range of the common x axis below the last panel; `None` if each panel has its own x axis.
    pub x_range: Option<(f64, f64)>,
    /// Name and unit of the x axis.
    pub x_title: &'static str,
    /// The panels, from left to right, then from top to bottom.
    pub panels: Vec<Panel>,
    /// Events.
    pub marks: Vec<Mark>,
}

impl Chart {
    /// Creates a chart of panels below each other, with a common time axis, s.
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
            x_range: Some(time_s),
            x_title: "time, s",
            panels,
            marks: Vec::new(),
        }
    }

    /// Creates a chart of panels with two logarithmic axes each.
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
            x_range: None,
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
/// Minimum distance between the labels of a y axis, px.
const TICK_DISTANCE_Y: f64 = 19.0;
/// Minimum distance between the labels of an x axis, px.
const TICK_DISTANCE_X: f64 = 56.0;
/// Values beyond this do not set the range of an axis. They occur before a crash by numbers that are not finite.
const MAX_PLOTTED: f64 = 1e12;
/// Size of labels, px.
const FONT_SIZE: f64 = 12.0;

impl Chart {
    /// Returns the `<svg>` element for a page that contains [`STYLE`].
    pub fn to_svg(&self) -> String {
        self.draw("", "")
    }

    /// Returns a complete SVG file.
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

    /// Returns the distance between the left edges of neighbouring panels, px.
    fn across(&self) -> f64 {
        self.width / self.columns.max(1) as f64
    }

    fn plot_width(&self) -> f64 {
        self.across() - LEFT - self.right()
    }

    /// Returns the height of the marks' label rows, between the first panel's title and its plot, px.
    fn marks_height(&self) -> f64 {
        let rows = self.mark_labels().iter().map(|label| label.row + 1).max().unwrap_or(0);
        rows as f64 * MARK_ROW
    }

    /// Returns the top of the first panel's title, px.
    fn first_top(&self) -> f64 {
        if self.heading.is_some() { HEADING_HEIGHT } else { 0.0 }
    }

    /// Returns the space below a row of panels, px: room for the x axis, if each panel has its own.
    fn below(&self) -> f64 {
        if self.x_range.is_some() { BELOW_PANEL } else { X_AXIS }
    }

    fn rows(&self) -> std::slice::Chunks<'_, Panel> {
        self.panels.chunks(self.columns.max(1))
    }

    /// Returns the height of the whole chart, px.
    pub fn height(&self) -> f64 {
        let rows = self.rows().map(|row| TITLE_ROW + tallest(row) + self.below());
        let last = if self.x_range.is_some() { X_AXIS } else { 0.0 };
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
                let area = PlotArea {
                    left: column as f64 * self.across() + LEFT,
                    top: top + TITLE_ROW + marks,
                    width: self.plot_width(),
                    height: panel.height,
                };
                let titles = top + TITLE_ROW - 9.0;
                panel.draw_titles(&mut svg, &area, titles, column as f64 * self.across() + self.across());
                if n == 0 && column == 0 {
                    self.draw_mark_labels(&mut svg, area.top);
                }
                let x_range = self.range(panel);
                let ticks = self.x_ticks(x_range);
                panel.draw(&mut svg, &area, self.scale, x_range, &ticks, &self.marks);
                bottom = area.top + panel.height;
                if self.x_range.is_none() {
                    self.draw_x_axis(&mut svg, (area.left, bottom), x_range, &ticks);
                }
            }
            top += TITLE_ROW + marks + tallest(row) + self.below();
        }
        if let Some(x_range) = self.x_range {
            self.draw_x_axis(&mut svg, (LEFT, bottom), x_range, &self.x_ticks(x_range));
        }
        svg.push_str("</svg>");
        svg
    }

    /// Returns the range of a panel's x axis, in coordinates of the scale.
    fn range(&self, panel: &Panel) -> (f64, f64) {
        let coordinates = |(low, high)| (self.scale.coordinate(low), self.scale.coordinate(high));
        self.x_range.map_or_else(|| panel.x_range(self.scale), coordinates)
    }

    fn x_ticks(&self, range: (f64, f64)) -> Ticks {
        let max_ticks = (self.plot_width() / TICK_DISTANCE_X) as usize;
        Ticks::on(self.scale, range, max_ticks, StepLadder::Decimal)
    }

    fn draw_x_axis(&self, svg: &mut String, (left, y): (f64, f64), range: (f64, f64), ticks: &Ticks) {
        let _ = write!(svg, "<path class=\"a\" d=\"M{} {}h{}\"/>", px(left), px(y), px(self.plot_width()));
        for (at, label) in ticks.labels() {
            let x = px(left + along_px(range, self.plot_width(), at));
            let _ = write!(svg, "<path class=\"a\" d=\"M{x} {}v4\"/>", px(y));
            text(svg, &format!("class=\"k c\" x=\"{x}\" y=\"{}\"", px(y + 17.0)), &label);
        }
        let attributes =
            format!("class=\"u e\" x=\"{}\" y=\"{}\"", px(left + self.plot_width()), px(y + 33.0));
        text(svg, &attributes, self.x_title);
    }

    /// Returns the position of a mark, px from the left edge of the plot.
    fn mark_px(&self, mark: &Mark) -> f64 {
        let (first, last) = self.x_range.unwrap_or_default();
        along_px(
            (self.scale.coordinate(first), self.scale.coordinate(last)),
            self.plot_width(),
            self.scale.coordinate(mark.time_s),
        )
    }

    /// Draws the marks' labels above the first plot, whose top is at `bottom`.
    fn draw_mark_labels(&self, svg: &mut String, bottom: f64) {
        for (mark, label) in self.marks.iter().zip(self.mark_labels()) {
            let y = bottom - label.row as f64 * MARK_ROW;
            let x = LEFT + self.mark_px(mark);
            // The line from the label down to the first plot. Each plot draws the part of the line inside it.
            let _ = write!(
                svg,
                "<path class=\"m\" stroke=\"{}\" d=\"M{} {}V{}\"/>",
                mark.colour,
                px(x),
                px(y - 11.0),
                px(bottom)
            );
            let (class, x) = if label.leftwards { ("n e", x - 5.0) } else { ("n", x + 5.0) };
            let attributes =
                format!("class=\"{class}\" fill=\"{}\" x=\"{}\" y=\"{}\"", mark.colour, px(x), px(y - 2.0));
            text(svg, &attributes, &mark.label);
        }
    }

    /// Lays out the marks' labels so that they do not overlap.
    fn mark_labels(&self) -> Vec<MarkLabel> {
        let mut placed: Vec<(usize, f64, f64)> = Vec::new();
        let layout = |mark: &Mark| {
            let x = self.mark_px(mark);
            let length = text_width(&mark.label) + 10.0;
            let leftwards = x + length > self.plot_width();
            let (from, to) = if leftwards { (x - length, x) } else { (x, x + length) };
            let free = |row: usize| placed.iter().all(|&(r, f, t)| r != row || to < f || t < from);
            let row = (0..).find(|&row| free(row)).unwrap_or(0);
            placed.push((row, from, to));
            MarkLabel { row, leftwards }
        };
        self.marks.iter().map(layout).collect()
    }
}

/// Renders the chart into a page.
impl Render for Chart {
    fn render_to(&self, page: &mut String) {
        page.push_str(&self.to_svg());
    }
}

/// Position of the label of a mark.
struct MarkLabel {
    /// Number of rows above the lowest row.
    row: usize,
    /// True if the label is to the left of its line.
    leftwards: bool,
}

/// Returns the height of the tallest plot in a row, px.
fn tallest(row: &[Panel]) -> f64 {
    row.iter().map(|panel| panel.height).fold(0.0, f64::max)
}

/// Formats a length in px, rounded to a tenth.
fn px(value: f64) -> String {
    let rounded = libm::round(value * 10.0) / 10.0;
    // Adding 0.0 turns "-0" into "0".
    format!("{}", rounded + 0.0)
}

/// Returns the estimated width of a label, px, for a wide font, because the reader's font is unknown.
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

/// Escapes text for XML and HTML, in an element or in a quoted attribute. Control characters, which are invalid there,
/// become the replacement character.
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
