//! Line charts over time, as SVG.
//!
//! A chart is a column of panels that share one time axis:
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
//! Written by hand and not by a plotting crate, because the page is to be small, equal to the byte for equal
//! flights, and set in the reader's own fonts. Lines are thinned to what a screen can show; a peak of a
//! single sample stays.

pub mod log_log;
mod path;
mod ticks;

use std::fmt::Write as _;

use path::Projection;
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

/// A line of a panel.
#[derive(Clone, Debug)]
pub struct Line {
    /// Its name in the legend; empty leaves it out there.
    pub label: String,
    /// How it is drawn.
    pub stroke: Stroke,
    /// Time, s, and value. A value that is not finite breaks the line.
    pub points: Vec<(f64, f64)>,
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
    pub unit: &'static str,
    /// Height of the plot, px.
    pub height: f64,
    /// Values that the axis covers in any case.
    pub covers: Vec<f64>,
    /// The axis covers at least this much, so that rounding errors do not fill a plot.
    pub least_span: f64,
    /// A second scale.
    pub right: Option<RightAxis>,
    /// The lines, the first at the bottom.
    pub lines: Vec<Line>,
}

/// A moment, drawn through all panels.
#[derive(Clone, Debug)]
pub struct Mark {
    /// Time, s.
    pub time_s: f64,
    /// What happened.
    pub label: String,
    /// One of [`colour`].
    pub colour: &'static str,
}

/// Panels over one time axis.
#[derive(Clone, Debug)]
pub struct Chart {
    /// Width, px.
    pub width: f64,
    /// Title and note of a picture that stands alone.
    pub heading: Option<(String, String)>,
    /// What is to be seen, for those who do not see it.
    pub description: String,
    /// First and last time, s, or whatever `x_title` says.
    pub time_s: (f64, f64),
    /// Name and unit of the axis along the bottom.
    pub x_title: &'static str,
    /// From top to bottom.
    pub panels: Vec<Panel>,
    /// Moments.
    pub marks: Vec<Mark>,
}

/// What the axis along the bottom is, as a rule.
pub const TIME: &str = "time, s";

const LEFT: f64 = 52.0;
const RIGHT: f64 = 14.0;
const RIGHT_WITH_AXIS: f64 = 46.0;
const HEADING_HEIGHT: f64 = 50.0;
const MARK_ROW: f64 = 16.0;
const TITLE_ROW: f64 = 26.0;
const BELOW_PANEL: f64 = 4.0;
const TIME_AXIS: f64 = 38.0;
/// Smallest distance between the labels of an axis, px: up and down, and along the time axis.
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

    fn plot_width(&self) -> f64 {
        self.width - LEFT - self.right()
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

    /// Height of the whole chart, px.
    pub fn height(&self) -> f64 {
        let panels = self.panels.iter().map(|panel| TITLE_ROW + panel.height + BELOW_PANEL);
        self.first_top() + self.marks_height() + panels.sum::<f64>() + TIME_AXIS
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
        let time_ticks = self.time_ticks();
        let mut top = self.first_top();
        let mut bottom = top;
        for (n, panel) in self.panels.iter().enumerate() {
            self.draw_titles(&mut svg, panel, top + TITLE_ROW - 9.0);
            top += TITLE_ROW;
            if n == 0 {
                top += self.marks_height();
                self.draw_mark_labels(&mut svg, top);
            }
            self.draw_panel(&mut svg, panel, top, &time_ticks);
            bottom = top + panel.height;
            top = bottom + BELOW_PANEL;
        }
        self.draw_time_axis(&mut svg, bottom, &time_ticks);
        svg.push_str("</svg>");
        svg
    }

    fn time_ticks(&self) -> Ticks {
        let most = (self.plot_width() / TICK_DISTANCE_X) as usize;
        Ticks::between(self.time_s, most, Ladder::Decimal)
    }

    /// Place of a time in the plot, px from its left edge.
    fn time_px(&self, time_s: f64) -> f64 {
        let (first, last) = self.time_s;
        (time_s - first) / (last - first).max(1e-9) * self.plot_width()
    }

    fn draw_panel(&self, svg: &mut String, panel: &Panel, top: f64, time_ticks: &Ticks) {
        let (width, height) = (self.plot_width(), panel.height);
        let (low, high) = panel.range(self.time_s);
        let value_px = |value: f64| (high - value) / (high - low) * height;

        // A drawing of its own clips what lies outside.
        let (w, h) = (px(width), px(height));
        let _ = write!(svg, "<svg x=\"{}\" y=\"{}\" width=\"{w}\" height=\"{h}\">", px(LEFT), px(top));
        let ticks = panel.ticks((low, high));
        for &time_s in &time_ticks.values {
            let x = px(self.time_px(time_s));
            let _ = write!(svg, "<path class=\"g\" d=\"M{x} 0V{h}\"/>");
        }
        for &value in &ticks.values {
            let class = if value == 0.0 { "z" } else { "g" };
            let _ = write!(svg, "<path class=\"{class}\" d=\"M0 {}H{w}\"/>", px(value_px(value)));
        }
        for mark in &self.marks {
            let x = px(self.time_px(mark.time_s));
            let _ = write!(svg, "<path class=\"m\" stroke=\"{}\" d=\"M{x} 0V{h}\"/>", mark.colour);
        }
        let projection = Projection { time_s: self.time_s, values: (low, high), width, height };
        for line in &panel.lines {
            let Stroke { colour, width, dashed } = line.stroke;
            let dash = if dashed { " stroke-dasharray=\"60 40\"" } else { "" };
            // The path is in tenths of a pixel.
            let _ = write!(
                svg,
                "<path class=\"l\" stroke=\"{colour}\" stroke-width=\"{}\"{dash} d=\"{}\"/>",
                px(width * 10.0),
                projection.path(&line.points)
            );
        }
        svg.push_str("</svg>");

        for &value in &ticks.values {
            let y = px(top + value_px(value) + 4.0);
            let place = format!("class=\"k e\" x=\"{}\" y=\"{y}\"", px(LEFT - 7.0));
            text(svg, &place, &ticks.label(value));
        }
        if let Some(right) = panel.right {
            let to_right = |left: f64| right.zero + right.per_unit * left;
            let ticks = Ticks::between((to_right(low), to_right(high)), panel.most_ticks(), Ladder::Decimal);
            for &value in &ticks.values {
                let y = px(top + value_px((value - right.zero) / right.per_unit) + 4.0);
                let place = format!("class=\"k\" x=\"{}\" y=\"{y}\"", px(LEFT + width + 7.0));
                text(svg, &place, &ticks.label(value));
            }
        }
    }

    /// Title, units and legend of a panel, on one line at `y`.
    fn draw_titles(&self, svg: &mut String, panel: &Panel, y: f64) {
        let _ = write!(
            svg,
            "<text class=\"t\" x=\"{}\" y=\"{}\">{} <tspan class=\"u\">({})</tspan></text>",
            px(LEFT),
            px(y),
            escaped(&panel.title),
            escaped(panel.unit)
        );
        if let Some(right) = panel.right {
            let place = format!("class=\"u e\" x=\"{}\" y=\"{}\"", px(self.width - 4.0), px(y));
            text(svg, &place, &format!("({})", right.unit));
        }
        self.draw_legend(svg, panel, y);
    }

    /// The legend stands above the plot, at its right end.
    fn draw_legend(&self, svg: &mut String, panel: &Panel, y: f64) {
        const SWATCH: f64 = 22.0;
        let mut x = LEFT + self.plot_width();
        if panel.right.is_some() {
            x -= 18.0;
        }
        for line in panel.lines.iter().rev().filter(|line| !line.label.is_empty()) {
            x -= text_width(&line.label);
            text(svg, &format!("class=\"n\" x=\"{}\" y=\"{}\"", px(x), px(y)), &line.label);
            let Stroke { colour, width, dashed } = line.stroke;
            let dash = if dashed { " stroke-dasharray=\"6 4\"" } else { "" };
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

    fn draw_time_axis(&self, svg: &mut String, y: f64, ticks: &Ticks) {
        let _ = write!(svg, "<path class=\"a\" d=\"M{} {}h{}\"/>", px(LEFT), px(y), px(self.plot_width()));
        for &time_s in &ticks.values {
            let x = px(LEFT + self.time_px(time_s));
            let _ = write!(svg, "<path class=\"a\" d=\"M{x} {}v4\"/>", px(y));
            text(svg, &format!("class=\"k c\" x=\"{x}\" y=\"{}\"", px(y + 17.0)), &ticks.label(time_s));
        }
        let place = format!("class=\"u e\" x=\"{}\" y=\"{}\"", px(LEFT + self.plot_width()), px(y + 33.0));
        text(svg, &place, self.x_title);
    }

    /// The marks' labels, above the first plot, whose top is at `bottom`.
    fn draw_mark_labels(&self, svg: &mut String, bottom: f64) {
        for (mark, label) in self.marks.iter().zip(self.mark_labels()) {
            let y = bottom - label.row as f64 * MARK_ROW;
            let x = LEFT + self.time_px(mark.time_s);
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
            let x = self.time_px(mark.time_s);
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

/// Where the label of a mark stands.
struct MarkLabel {
    /// Rows above the lowest.
    row: usize,
    /// Whether it stands to the left of its line.
    leftwards: bool,
}

impl Panel {
    /// The values that the axis covers.
    fn range(&self, (first, last): (f64, f64)) -> (f64, f64) {
        let shown = self.lines.iter().flat_map(|line| &line.points);
        let shown = shown.filter(|(t, _)| (first..=last).contains(t)).map(|&(_, value)| value);
        let all = shown.chain(self.covers.iter().copied()).filter(|value| value.abs() < BEYOND_PLOTTING);
        let (low, high) = all
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)));
        let (low, high) = if low > high { (0.0, 0.0) } else { (low, high) };
        let margin = (0.06 * (high - low))
            .max(0.5 * (self.least_span - (high - low)))
            .max(1e-9 * high.abs())
            .max(1e-9);
        (low - margin, high + margin)
    }

    fn most_ticks(&self) -> usize {
        (self.height / TICK_DISTANCE_Y).max(2.0) as usize
    }

    fn ticks(&self, range: (f64, f64)) -> Ticks {
        let ladder = if self.unit.starts_with('°') { Ladder::Degrees } else { Ladder::Decimal };
        Ticks::between(range, self.most_ticks(), ladder)
    }
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
