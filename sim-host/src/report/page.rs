//! The HTML of the page around the figures.

use flight_core::ArmState;
use flight_core::estimator::EstimatorParams;
use maud::{DOCTYPE, Markup, PreEscaped, html};

use super::figures;
use super::recorder::Recorder;
use crate::chart::{self, Chart};
use crate::dynamics::GRAVITY;
use crate::flight::Outcome;
use crate::pilot::{Base, FRAME_RATE_HZ, PilotScript, Plan};
use crate::scene::{DEFAULT_RATE_HZ, MAG_RATE_HZ, Scene};

/// Returns a complete page, which loads nothing and runs no scripts. `style` is additional CSS of this page.
pub fn document(title: &str, style: &str, content: &Markup) -> String {
    html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta http-equiv="Content-Security-Policy" content="default-src 'none'; style-src 'unsafe-inline'";
                meta name="viewport" content="width=device-width, initial-scale=1";
                title { (title) " · Kestrel" }
                style { (PreEscaped(include_str!("style.css"))) (PreEscaped(chart::STYLE)) (PreEscaped(style)) }
            }
            body {
                main { (content) }
            }
        }
    }
    .into_string()
}

/// Returns a figure: title, caption and chart.
pub fn figure(title: &str, caption: &Markup, chart: &Chart) -> Markup {
    html! {
        figure {
            h2 { (title) }
            figcaption { (caption) }
            div.scroll { (chart) }
        }
    }
}

/// Returns the page of a flight of `scene` with `seed`.
pub fn page(scene: &Scene, seed: u64, outcome: &Outcome, recorder: &Recorder) -> String {
    let name = printable(&scene.name);
    let content = html! {
        (header(scene, seed, outcome))
        (cards(scene, outcome))
        (simulated(scene, seed))
        @for part in figures::all(scene, outcome, recorder) {
            (figure(part.title, &html! { (part.caption) }, &part.chart))
        }
        (footer(scene, recorder))
    };
    document(&format!("{name} · seed {seed}"), "", &content)
}

/// Replaces control characters in text from a file, because they are invalid in HTML.
pub fn printable(text: &str) -> String {
    text.replace(['\n', '\t'], " ").replace(char::is_control, "\u{FFFD}")
}

fn header(scene: &Scene, seed: u64, outcome: &Outcome) -> Markup {
    let (class, verdict) = match outcome.crash {
        None => ("flown", "flown to the end".to_owned()),
        Some((why, at_s)) => ("crashed", format!("crashed at {at_s:.3} s: {}", why.text())),
    };
    html! {
        header {
            p.kind { "Kestrel · simulated flight" }
            h1 { (printable(&scene.name)) }
            span.verdict.(class) { (verdict) }
            p.about { (printable(&scene.description)) }
            p.facts {
                "seed " (seed) " · " (seconds(outcome.flown_s())) " of " (seconds(scene.duration_s)) " · "
                (grouped(outcome.control_steps)) " control steps at " (DEFAULT_RATE_HZ) " Hz · digest "
                code { (format!("{:016x}", outcome.digest)) }
            }
        }
    }
}

fn cards(scene: &Scene, outcome: &Outcome) -> Markup {
    let degrees = |value: f64| number(value, 3, "°");
    let state = match outcome.final_state {
        ArmState::Armed | ArmState::Descent => "motors permitted",
        ArmState::Terminated => "motors stopped by a fault",
        _ => "motors stopped",
    };
    let card = |name: &str, value: &str, note: &Markup| {
        html! {
            div {
                dt { (name) }
                dd { (value) small { (note) } }
            }
        }
    };
    let parts = html! {
        "heading " (degrees(outcome.heading_rmse_deg)) br;
        "inclination " (degrees(outcome.inclination_rmse_deg))
    };
    let note = |text: &str| html! { (text) };
    html! {
        dl.cards {
            (card("Attitude error, RMS", &degrees(outcome.attitude_rmse_deg), &parts))
            (card("Worst tilt error", &degrees(outcome.tilt_error_max_deg), &note("of the estimate")))
            (card("Worst tilt", &number(outcome.tilt_max_deg, 1, "°"), &note("true tilt of the vehicle")))
            @if scene.pilot.is_some() && !scene.ball_joint {
                (card(
                    "Largest distance from the target",
                    &number(outcome.position_error_max_m, 2, " m"),
                    &note("true distance while airborne"),
                ))
            }
            (card("State at the end", outcome.final_state.name(), &note(state)))
        }
    }
}

fn simulated(scene: &Scene, seed: u64) -> Markup {
    let row = |name: &str, value: &Markup| {
        html! {
            tr {
                th scope="row" { (name) }
                td { (value) }
            }
        }
    };
    let v = &scene.vehicle;
    let vehicle = html! {
        (v.mass_kg) " kg, " (v.arm_m()) " m from centre to rotor, thrust to weight "
        (format!("{:.2}", v.max_thrust_n() / (v.mass_kg * GRAVITY))) "; "
        @if scene.ball_joint { "on a ball joint" } @else { "free, above level ground" }
    };
    let pilot = scene.pilot.as_ref().map_or("none".into(), |p| pilot_text(p, scene.duration_s));
    let rates = html! {
        "gyroscope and accelerometer " (DEFAULT_RATE_HZ) " Hz, magnetometer " (MAG_RATE_HZ) " Hz"
        @if scene.pilot.is_some() { ", receiver " (FRAME_RATE_HZ) " Hz" }
    };
    let effects = html! {
        @if scene.effects().is_empty() { "none" }
        @for name in scene.effects() { code { (name) } " " }
    };
    let (_, drawn) = scene.for_run(seed);
    let drawn_list = html! {
        @for (name, value) in &drawn { code { (name) } " " (format!("{value:.4e}")) br; }
    };
    html! {
        h2 { "Simulation" }
        table {
            (row("Vehicle", &vehicle))
            (row("Pilot", &html! { (pilot) }))
            (row("Estimator", &estimator_text(scene)))
            (row("Rates", &rates))
            (row("Effects, in order", &effects))
            @if !drawn.is_empty() { (row("Drawn for this run", &drawn_list)) }
        }
    }
}

fn pilot_text(pilot: &PilotScript, duration_s: f64) -> String {
    let Plan { arm_at_s, take_off_at_s, height_m, land_before_end_s } = pilot.plan;
    let (start, end) = match pilot.base {
        Base::Hold => (format!("takes off at {take_off_at_s} s, holds {height_m} m"), "lands"),
        Base::Centred { throttle } => (
            format!("throttle to {} % at {take_off_at_s} s", number(throttle * 100.0, 0, "")),
            "throttle down",
        ),
    };
    let moves = match pilot.script.len() {
        0 => String::new(),
        1 => ", makes 1 scripted move".into(),
        n => format!(", makes {n} scripted moves"),
    };
    let end = land_before_end_s
        .map_or(String::new(), |before_end_s| format!(", {end} at {}", seconds(duration_s - before_end_s)));
    format!("arms at {arm_at_s} s, {start}{moves}{end}")
}

fn estimator_text(scene: &Scene) -> Markup {
    let params = scene.config.params;
    let same = |(_, preset): &(&str, EstimatorParams)| {
        EstimatorParams { declination_rad: params.estimator.declination_rad, ..*preset } == params.estimator
    };
    let name =
        EstimatorParams::PRESETS.iter().find(|preset| same(preset)).map_or("custom", |(name, _)| *name);
    let settings: Vec<String> = { params.estimator }
        .settings()
        .filter(|setting| setting.name != "estimator.declination_rad")
        .map(|setting| setting_text(setting.name.trim_start_matches("estimator."), *setting.value))
        .collect();
    let settings = settings.join(", ");
    let prefilter =
        params.prefilter_cutoff_hz.map_or("no prefilter".into(), |hz| format!("prefilter {hz} Hz"));
    let declination = f64::from(params.estimator.declination_rad).to_degrees();
    html! {
        code { (name) } " " (settings) "; " (prefilter) "; declination " (number(declination, 3, "°"))
    }
}

/// Formats a setting: `tau_s` as "τ = 10 s", `speed_m_s` as "speed = 0.3 m/s", `alpha` as "α = 0.97".
fn setting_text(name: &str, value: f32) -> String {
    let units = [("_m_s", " m/s"), ("_s", " s"), ("_rad", " rad/√Hz")];
    let with_unit = units.iter().find_map(|(suffix, unit)| Some((name.strip_suffix(suffix)?, *unit)));
    let (name, unit) = with_unit.unwrap_or((name, ""));
    let symbols = name.replace("tau", "τ").replace("alpha", "α").replace('_', " ");
    format!("{symbols} = {}", number(f64::from(value), 4, unit))
}

fn footer(scene: &Scene, recorder: &Recorder) -> Markup {
    html! {
        footer {
            @if recorder.further_events() > 0 { (recorder.further_events()) " more events are not marked. " }
            @if scene.pilot.is_none() {
                "The scene has no pilot, so motors and position do not change and are not shown. "
            } @else if scene.ball_joint {
                "The test stand holds the centre of gravity, so the position is not shown. "
            }
            "The plots show the lowest and the highest value of each interval of 0.01 s, or of each pixel if it is \
             longer, so no peak is lost. The same scene and seed give the same page, byte for byte."
        }
    }
}

/// Formats a number with at most `digits` digits after the point, without trailing zeros. A number that is not finite
/// becomes the words "not finite".
fn number(value: f64, digits: usize, unit: &str) -> String {
    if !value.is_finite() {
        return "not finite".into();
    }
    let shown = format!("{value:.digits$}");
    let shown = if shown.contains('.') { shown.trim_end_matches('0').trim_end_matches('.') } else { &shown };
    format!("{}{unit}", shown.replace('-', "\u{2212}"))
}

/// Formats a number with a comma before every three digits.
fn grouped(count: u64) -> String {
    let digits = count.to_string();
    let mut out = String::new();
    for (k, digit) in digits.chars().enumerate() {
        if k > 0 && (digits.len() - k).is_multiple_of(3) {
            out.push(',');
        }
        out.push(digit);
    }
    out
}

fn seconds(value: f64) -> String {
    number(value, 3, " s")
}
