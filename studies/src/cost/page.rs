//! The studies as one self-contained HTML page, and each plot by itself.

use maud::{Markup, html};

use super::table::{columns, number, shown};
use super::{Axis, Setting, Study};
use sim_host::chart::{Chart, Label, Line, Panel, Stroke, colour};
use sim_host::report::document;

/// Width of a plot, px; it fits a README and the page.
const WIDTH: f64 = 900.0;
const COLOURS: [&str; 6] =
    [colour::BLUE, colour::VERMILLION, colour::GREEN, colour::ORANGE, colour::PURPLE, colour::SKY];

/// Plots error against cost for the problems that `wanted` selects, with both axes logarithmic.
pub fn plot(study: &Study, (axis, axis_title): (Axis, &'static str), wanted: impl Fn(&str) -> bool) -> Chart {
    let problems: Vec<&str> = study.problems().into_iter().filter(|problem| wanted(problem)).collect();
    let panels: Vec<Panel> =
        problems.iter().map(|problem| panel(study, problem, axis, problems.len() == 1)).collect();
    let description = format!("{}: error against cost, {axis_title}", study.title);
    let columns = if panels.len() == 1 { 1 } else { 2 };
    Chart { columns, ..Chart::logarithmic(WIDTH, description, axis_title, panels) }
}

fn panel(study: &Study, problem: &str, axis: Axis, legend: bool) -> Panel {
    let settings: Vec<&Setting> = study.of(problem).collect();
    let place = |s: &Setting| s.cost(axis).zip(s.error).filter(|(x, y)| *x > 0.0 && *y > 0.0);
    let mut front: Vec<(f64, f64)> = settings
        .iter()
        .filter(|s| super::on_front(s, &study.settings, |s| s.cost(axis)))
        .filter_map(|s| place(s))
        .collect();
    front.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut lines = vec![Line { sets_axes: false, ..Line::new("", Stroke::solid("#ddd", 7.0), front) }];
    let mut labels = Vec::new();
    for (series, stroke) in series(study) {
        let of: Vec<&Setting> = settings.iter().filter(|s| s.series == series).copied().collect();
        let mut points: Vec<(f64, f64)> = of.iter().filter_map(|s| place(s)).collect();
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        let single_points = !has_lines(study);
        for s in &of {
            if let Some(at) = place(s)
                && (s.default || (single_points && (s.pareto || settings.len() <= 9)))
            {
                let text = match (single_points, s.default) {
                    (true, true) => format!("{} (default)", s.setting),
                    (true, false) => s.setting.clone(),
                    (false, _) => "default".into(),
                };
                labels.push(Label {
                    at,
                    text,
                    colour: if s.default { colour::BLACK } else { stroke.colour },
                });
            }
        }
        let label = if legend && !single_points { series } else { "" };
        let stroke = if single_points { Stroke { width: 0.0, ..stroke } } else { stroke };
        lines.push(Line { dots: true, ..Line::new(label, stroke, points) });
    }
    let unit = settings.first().map_or("", |s| s.error_unit);
    Panel { labels, ..Panel::new(problem, unit, 250.0, lines) }
}

/// Returns whether a series is a line, and not a single point.
fn has_lines(study: &Study) -> bool {
    let first = study.settings.first();
    first.is_some_and(|first| {
        study.settings.iter().any(|s| {
            s.problem == first.problem
                && study.of(s.problem).filter(|other| other.series == s.series).count() > 1
        })
    })
}

/// Returns the series in order, each with its stroke. Strokes are dashed once the colours repeat.
fn series(study: &Study) -> Vec<(&str, Stroke)> {
    let mut list: Vec<(&str, Stroke)> = Vec::new();
    for s in &study.settings {
        if !list.iter().any(|(name, _)| *name == s.series) {
            let colour = COLOURS[list.len() % COLOURS.len()];
            let dashed = list.len() >= COLOURS.len();
            list.push((&s.series, Stroke { colour, width: 1.5, dashed }));
        }
    }
    list
}

/// Returns the page.
pub fn page(studies: &[Study]) -> String {
    let content = html! {
        header {
            p.kind { "Kestrel · error against cost" }
            h1 { "What accuracy costs" }
            p.about {
                "Parts of the flight code and of the simulator. Each is swept over its settings and judged against an independent \
                 reference."
                }
                p.facts {
                    "Grey band and bold: the Pareto front, settings that no other setting of the problem beats in both error and cost. \
                  Black dot and “default”: Kestrel's default. Errors and instructions are the same in every run; times are those of \
                  this machine."
            }
        }
        @for study in studies { (section(study)) }
        footer {
            "Instructions are counted on the Cortex-M4F of QEMU. A processor at 168 MHz is assumed to need two cycles for each. \
             Times are the shortest of several runs on the machine that made this page."
        }
    };
    document("What accuracy costs", include_str!("page.css"), &content)
}

/// Renders text, with parts in backticks as code.
fn prose(text: &str) -> Markup {
    html! {
        @for (k, part) in text.split('`').enumerate() {
            @if k % 2 == 1 { code { (part) } } @else { (part) }
        }
    }
}

fn section(study: &Study) -> Markup {
    let chart = plot(study, (study.axis, study.axis_title), |_| true);
    html! {
        section id=(study.name) {
            figure {
                h2 { (study.title) }
                figcaption { (prose(&study.about)) " " b { "Reference:" } " " (prose(&study.reference)) }
                @if has_lines(study) && study.problems().len() > 1 { (legend(study)) }
                div.scroll { (chart) }
            }
            @for remark in &study.remarks { p.remark { (prose(remark)) } }
            @for problem in study.problems() { (table(study, problem)) }
        }
    }
}

fn legend(study: &Study) -> Markup {
    let border = |Stroke { colour, dashed, .. }| {
        format!("border-top:3px {} {colour}", if dashed { "dashed" } else { "solid" })
    };
    html! {
        p.legend {
            @for (name, stroke) in series(study) { span { i style=(border(stroke)) {} (name) } " " }
        }
    }
}

fn table(study: &Study, problem: &str) -> Markup {
    let columns = columns(study);
    let (rows, count) = shown(study, problem);
    let unit = rows.first().map_or("", |s| s.error_unit);
    html! {
        table.data {
            caption {
                (problem) " "
                small {
                    "error: " (unit) "; costs for " (study.per)
                    @if rows.len() < count { "; " (rows.len()) " of " (count) " settings" }
                }
            }
            tr {
                th { "setting" }
                @for (name, _) in &columns { th.n { (name) } }
            }
            @for s in rows {
                tr class=[s.pareto.then_some("front")] {
                    td { (s.setting) @if s.default { " " small { "default" } } }
                    @for (_, value) in &columns { td.n { (number(value(s))) } }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn study() -> Study {
        let setting = |series: &str, host_ns, error, default| Setting {
            problem: "a < b",
            series: series.into(),
            setting: format!("{series} {host_ns}"),
            error,
            error_unit: "rad",
            host_ns: Some(host_ns),
            default,
            ..Setting::default()
        };
        let mut study = Study {
            name: "s",
            title: "A & B",
            about: "about".into(),
            reference: "reference".into(),
            per: "a step",
            axis: Axis::Host,
            axis_title: "ns",
            settings: vec![
                setting("x", 1.0, Some(1.0), false),
                setting("x", 2.0, Some(0.1), true),
                setting("y", 3.0, Some(0.0), false),
                setting("y", 4.0, None, false),
            ],
            remarks: vec!["1 < `2`".into()],
        };
        study.mark_front();
        study
    }

    #[test]
    fn page_escapes_text_and_lists_every_setting() {
        let html = page(&[study()]);
        assert!(
            html.contains("A &amp; B") && html.contains("1 &lt; <code>2</code>") && html.contains("a &lt; b")
        );
        for row in ["x 1", "x 2", "y 3", "y 4"] {
            assert!(html.contains(&format!("<td>{row}")), "{row}");
        }
        assert_eq!(html.matches("<tr class=\"front\">").count(), 3);
        // The default is labelled. An error of zero has no place on a logarithmic axis.
        assert!(html.contains(">default</text>"));
        assert!(!html.contains("NaN") && !html.contains("inf"));
    }
}
