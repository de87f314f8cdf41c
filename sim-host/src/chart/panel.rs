//! One plot of a chart: lines and axes.

use std::fmt::Write as _;

use super::path::Projection;
use super::ticks::{StepLadder, Ticks};
use super::{Band, Label, Line, MAX_PLOTTED, Mark, Panel, Scale, Stroke, TICK_DISTANCE_Y};
use super::{escaped, px, text, text_width};

/// Vertical distance between labels, px.
const LABEL_ROW: f64 = 13.0;
/// Margin beyond the values on a logarithmic axis: a share of their span, and a minimum in decades.
const LOG_MARGIN: (f64, f64) = (0.05, 0.15);

/// The rectangle of a plot, px.
pub(super) struct PlotArea {
    pub left: f64,
    pub top: f64,
    pub width: f64,
    pub height: f64,
}

/// Returns the smallest and the largest value; `None` without values.
fn span(values: impl Iterator<Item = f64>) -> Option<(f64, f64)> {
    let outside = (f64::INFINITY, f64::NEG_INFINITY);
    let (low, high) = values.fold(outside, |(low, high), value| (low.min(value), high.max(value)));
    (low <= high).then_some((low, high))
}

/// Returns the range of the finite logarithms, with a margin.
fn decades_around(logarithms: impl Iterator<Item = f64>) -> (f64, f64) {
    let Some((low, high)) = span(logarithms.filter(|log| log.is_finite())) else { return (-1.0, 1.0) };
    let margin = (LOG_MARGIN.0 * (high - low)).max(LOG_MARGIN.1);
    (low - margin, high + margin)
}

impl Panel {
    fn axis_points(&self) -> impl Iterator<Item = &(f64, f64)> {
        self.lines.iter().filter(|line| line.sets_axes).flat_map(|line| &line.points)
    }

    /// Returns the range of the panel's own x axis, in coordinates of the scale.
    pub(super) fn x_range(&self, scale: Scale) -> (f64, f64) {
        let x_range = self.axis_points().map(|&(x, _)| scale.coordinate(x));
        match scale {
            Scale::Logarithmic => decades_around(x_range),
            Scale::Linear => span(x_range.filter(|x| x.is_finite())).unwrap_or((0.0, 1.0)),
        }
    }

    /// Returns the range of the y axis, in coordinates of the scale, for the points inside the range of the x axis.
    pub(super) fn range(&self, scale: Scale, (first, last): (f64, f64)) -> (f64, f64) {
        let ends = self.bands.iter().flat_map(|band| &band.points);
        let ends = ends.flat_map(|&(x, low, high)| [(x, low), (x, high)]);
        let shown = self.axis_points().copied().chain(ends);
        let shown = shown.filter(|&(x, _)| (first..=last).contains(&scale.coordinate(x))).map(|(_, y)| y);
        let all = shown.chain(self.includes.iter().copied());
        if scale == Scale::Logarithmic {
            return decades_around(all.map(|value| scale.coordinate(value)));
        }
        let (low, high) = span(all.filter(|value| value.abs() < MAX_PLOTTED)).unwrap_or((0.0, 0.0));
        let margin =
            (0.06 * (high - low)).max(0.5 * (self.min_span - (high - low))).max(1e-9 * high.abs()).max(1e-9);
        (low - margin, high + margin)
    }

    fn max_ticks(&self) -> usize {
        (self.height / TICK_DISTANCE_Y).max(2.0) as usize
    }

    fn ticks(&self, scale: Scale, range: (f64, f64)) -> Ticks {
        let ladder = if self.unit.starts_with('°') { StepLadder::Degrees } else { StepLadder::Decimal };
        Ticks::on(scale, range, self.max_ticks(), ladder)
    }

    pub(super) fn draw(
        &self,
        svg: &mut String,
        area: &PlotArea,
        scale: Scale,
        x_range: (f64, f64),
        x_ticks: &Ticks,
        marks: &[Mark],
    ) {
        let PlotArea { left, top, width, height } = *area;
        let (low, high) = self.range(scale, x_range);
        let projection = Projection { x_range, values: (low, high), width, height };
        let (x_px, y_px) = (|x| projection.x(x), |y| projection.y(y));
        let at_px = |(x, y): (f64, f64)| (x_px(scale.coordinate(x)), y_px(scale.coordinate(y)));

        // A nested <svg> clips everything outside the plot.
        let (w, h) = (px(width), px(height));
        let _ = write!(svg, "<svg x=\"{}\" y=\"{}\" width=\"{w}\" height=\"{h}\">", px(left), px(top));
        let ticks = self.ticks(scale, (low, high));
        for x in x_ticks.lines() {
            let _ = write!(svg, "<path class=\"g\" d=\"M{} 0V{h}\"/>", px(x_px(x)));
        }
        for y in ticks.lines() {
            let class = if y == 0.0 && scale == Scale::Linear { "z" } else { "g" };
            let _ = write!(svg, "<path class=\"{class}\" d=\"M0 {}H{w}\"/>", px(y_px(y)));
        }
        for mark in marks {
            let x = px(x_px(scale.coordinate(mark.time_s)));
            let _ = write!(svg, "<path class=\"m\" stroke=\"{}\" d=\"M{x} 0V{h}\"/>", mark.colour);
        }
        for band in &self.bands {
            draw_band(svg, band, at_px);
        }
        for line in &self.lines {
            draw_line(svg, line, scale, &projection, at_px);
        }
        for label in &self.labels {
            dot(svg, at_px(label.at), 4.0, label.colour);
        }
        svg.push_str("</svg>");

        self.draw_labels(svg, area, at_px);
        for (y, label) in ticks.labels() {
            let attributes =
                format!("class=\"k e\" x=\"{}\" y=\"{}\"", px(left - 7.0), px(top + y_px(y) + 4.0));
            text(svg, &attributes, &label);
        }
        if let Some(right) = self.right {
            let to_right = |left: f64| right.zero + right.per_unit * left;
            let ticks =
                Ticks::between((to_right(low), to_right(high)), self.max_ticks(), StepLadder::Decimal);
            for (value, label) in ticks.labels() {
                let y = px(top + y_px((value - right.zero) / right.per_unit) + 4.0);
                text(svg, &format!("class=\"k\" x=\"{}\" y=\"{y}\"", px(left + width + 7.0)), &label);
            }
        }
    }

    /// Draws the labels to the upper right of their dots, because a falling curve leaves that place free. At the right
    /// edge a label is on the left. A label moves up or down by rows if it would overlap another.
    fn draw_labels(&self, svg: &mut String, area: &PlotArea, at_px: impl Fn((f64, f64)) -> (f64, f64)) {
        let mut occupied: Vec<(f64, f64, f64)> = Vec::new();
        for Label { at, text: content, colour } in &self.labels {
            let (x, y) = at_px(*at);
            let (x, y) = (area.left + x, area.top + y);
            let length = text_width(content);
            let leftwards = x + 8.0 + length > area.left + area.width;
            let (class, x) = if leftwards { ("q e", x - 8.0) } else { ("q", x + 8.0) };
            let from = if leftwards { x - length } else { x };
            let shifted = |shift: f64| (y + shift).clamp(area.top + 12.0, area.top + area.height - 6.0);
            let free = |y: f64| {
                occupied
                    .iter()
                    .all(|&(f, t, other)| t < from || from + length < f || (y - other).abs() >= LABEL_ROW)
            };
            let rows = [0.0, 1.0, 2.0].map(|row| row * LABEL_ROW);
            let shifts = rows.into_iter().flat_map(|row| [-7.0 - row, 11.0 + row]);
            let y = shifts.map(shifted).find(|y| free(*y)).unwrap_or(shifted(-7.0));
            occupied.push((from, from + length, y));
            let attributes =
                format!("class=\"{class}\" style=\"fill:{colour}\" x=\"{}\" y=\"{}\"", px(x), px(y));
            text(svg, &attributes, content);
        }
    }

    /// Draws title, units and legend in one line at `y`. The panel ends at `edge`.
    pub(super) fn draw_titles(&self, svg: &mut String, area: &PlotArea, y: f64, edge: f64) {
        let _ = write!(
            svg,
            "<text class=\"t\" x=\"{}\" y=\"{}\">{} <tspan class=\"u\">({})</tspan></text>",
            px(area.left),
            px(y),
            escaped(&self.title),
            escaped(&self.unit)
        );
        if let Some(right) = self.right {
            let attributes = format!("class=\"u e\" x=\"{}\" y=\"{}\"", px(edge - 4.0), px(y));
            text(svg, &attributes, &format!("({})", right.unit));
        }
        self.draw_legend(svg, area.left + area.width, y);
    }

    /// Draws the legend above the plot, at its right end.
    fn draw_legend(&self, svg: &mut String, right: f64, y: f64) {
        const SWATCH: f64 = 22.0;
        let mut x = right;
        if self.right.is_some() {
            x -= 18.0;
        }
        for line in self.lines.iter().rev().filter(|line| !line.label.is_empty()) {
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
}

fn draw_band(svg: &mut String, band: &Band, at_px: impl Fn((f64, f64)) -> (f64, f64)) {
    let forth = band.points.iter().map(|&(x, low, _)| (x, low));
    let back = band.points.iter().rev().map(|&(x, _, high)| (x, high));
    let corners: Vec<String> = forth
        .chain(back)
        .map(at_px)
        .filter(|(x, y)| x.is_finite() && y.is_finite())
        .map(|(x, y)| {
            let tenths = |v: f64| libm::rint(v.clamp(-1e5, 1e5) * 10.0) as i32;
            format!("{} {}", tenths(x), tenths(y))
        })
        .collect();
    if !corners.is_empty() {
        let d = corners.join("L");
        let _ = write!(svg, "<path class=\"f\" style=\"fill:{}\" d=\"M{d}Z\"/>", band.colour);
    }
}

fn draw_line(
    svg: &mut String,
    line: &Line,
    scale: Scale,
    projection: &Projection,
    at_px: impl Fn((f64, f64)) -> (f64, f64),
) {
    let Stroke { colour, width, dashed } = line.stroke;
    let dash = if dashed { " stroke-dasharray=\"60 40\"" } else { "" };
    let path = match scale {
        Scale::Linear => projection.path(&line.points),
        Scale::Logarithmic => {
            let points: Vec<_> =
                line.points.iter().map(|&(x, y)| (scale.coordinate(x), scale.coordinate(y))).collect();
            projection.path(&points)
        }
    };
    // The path is in tenths of a pixel.
    let _ = write!(
        svg,
        "<path class=\"l\" stroke=\"{colour}\" stroke-width=\"{}\"{dash} d=\"{path}\"/>",
        px(width * 10.0)
    );
    if line.dots {
        line.points.iter().for_each(|&point| dot(svg, at_px(point), 2.4, colour));
    }
}

fn dot(svg: &mut String, (x, y): (f64, f64), radius: f64, colour: &str) {
    if x.is_nan() || y.is_nan() {
        return;
    }
    let (x, y) = (px(x.clamp(-1e5, 1e5)), px(y.clamp(-1e5, 1e5)));
    let _ = write!(svg, "<circle cx=\"{x}\" cy=\"{y}\" r=\"{radius}\" fill=\"{colour}\"/>");
}
