//! Plots of Allan deviations on logarithmic axes, with bounds, slopes and coefficients.

use crate::chart::{Band, Chart, Label, Line, Panel, Stroke, colour};
use allan::{Coefficient, Fit, Found, Point};

/// Returns the colour of a coefficient's slope.
fn colour_of(coefficient: Coefficient) -> &'static str {
    match coefficient {
        Coefficient::Quantization => colour::PURPLE,
        Coefficient::WhiteNoise => colour::VERMILLION,
        Coefficient::BiasInstability => colour::GREEN,
        Coefficient::RateRandomWalk => colour::ORANGE,
        Coefficient::RateRamp => colour::GREY,
    }
}

/// Returns the panel of a column: its points with their bounds, and the slopes if there is a fit for this statistic.
pub fn panel(title: &str, unit: &str, points: &[Point], fit: Option<&Fit>) -> Panel {
    let mut lines = Vec::new();
    let mut labels = Vec::new();
    let ends = points.first().zip(points.last()).map(|(first, last)| (first.tau_s, last.tau_s));
    if let (Some(fit), Some((first, last))) = (fit, ends) {
        let values: Vec<(Coefficient, f64)> = Coefficient::ALL
            .into_iter()
            .zip(&fit.found)
            .filter_map(|(coefficient, found)| found.value().map(|value| (coefficient, value)))
            .collect();
        let variance = |(c, value): (Coefficient, f64), tau_s: f64| value * value * c.variance(tau_s);
        for &(coefficient, value) in &values {
            let at = |tau_s: f64| (tau_s, libm::sqrt(variance((coefficient, value), tau_s)));
            let colour = colour_of(coefficient);
            let slope = Line::new("", Stroke::dashed(colour, 1.2), vec![at(first), at(last)]);
            lines.push(Line { sets_axes: false, ..slope });
            // The label is at the usual averaging time for reading the coefficient. If that is outside the plot, it is
            // where the term has the largest share of the variance.
            let part = |tau_s: f64| {
                let all: f64 = values.iter().map(|&term| variance(term, tau_s)).sum();
                variance((coefficient, value), tau_s) / all
            };
            let dominant = points.iter().map(|p| p.tau_s).max_by(|a, b| part(*a).total_cmp(&part(*b)));
            let read_at =
                coefficient.read_at_s().filter(|tau_s| (first..=last).contains(tau_s) && part(*tau_s) > 0.02);
            let text = format!("{} {} {}", coefficient.letter(), short(value), coefficient.unit(unit));
            labels.push(Label { at: at(read_at.or(dominant).unwrap_or(first)), text, colour });
        }
        if let Some((from, to)) = fit.range_s {
            let model = |tau_s: f64| libm::sqrt(values.iter().map(|&term| variance(term, tau_s)).sum());
            let steps = 60;
            let curve = (0..=steps).map(|k| from * libm::pow(to / from, f64::from(k) / f64::from(steps)));
            let curve = curve.map(|tau_s| (tau_s, model(tau_s))).collect();
            lines.push(Line::new("fit", Stroke::solid(colour::BLACK, 1.2), curve));
        }
    }
    let measured = points.iter().map(|p| (p.tau_s, p.deviation)).collect();
    // Dots for octaves; thousands of dots would look like a line.
    let deviation = Line::new("deviation, 68 %", Stroke::solid(colour::BLUE, 1.4), measured);
    lines.push(Line { dots: points.len() < 80, ..deviation });
    let bounds = points.iter().map(|p| (p.tau_s, p.lower, p.upper)).collect();
    let bands = vec![Band { colour: colour::BLUE, points: bounds }];
    Panel { bands, labels, ..Panel::new(title, unit, 420.0, lines) }
}

/// Formats a number with three digits.
pub fn short(value: f64) -> String {
    if (1e-3..1e4).contains(&value) {
        let digits = (2.0 - libm::floor(libm::log10(value))).max(0.0) as usize;
        format!("{value:.digits$}")
    } else {
        format!("{value:.2e}")
    }
}

/// Returns a chart of such panels.
pub fn chart(heading: (String, String), mut panels: Vec<Panel>) -> Chart {
    let many = panels.len() > 1;
    if many {
        panels.iter_mut().for_each(|panel| panel.height = 280.0);
    }
    let description = format!("Allan deviation over averaging time: {}", heading.0);
    let width = if many { 1100.0 } else { 860.0 };
    Chart {
        columns: if many { 2 } else { 1 },
        heading: Some(heading),
        ..Chart::logarithmic(width, description, "averaging time τ, s", panels)
    }
}

/// Describes a value with its uncertainty, or the reason why there is no value.
pub fn describe(coefficient: Coefficient, found: &Found, unit: &str) -> String {
    let unit = coefficient.unit(unit);
    match found {
        Found::Value { value, uncertainty } => {
            format!("{} ± {:.1} % {unit}", short(*value), 100.0 * uncertainty / value)
        }
        Found::Hidden { reason, at_most } => {
            let bound = at_most.map_or(String::new(), |most| format!("; at most {} {unit}", short(most)));
            format!("– ({reason}{bound})")
        }
    }
}
