//! The HTML around the figures.

use std::fmt::Write as _;

use flight_core::ArmState;
use flight_core::estimator::EstimatorParams;

use super::figures;
use super::recorder::Recorder;
use crate::chart::{self, escaped};
use crate::dynamics::GRAVITY;
use crate::flight::Outcome;
use crate::pilot::{Base, FRAME_RATE_HZ, PilotScript, Plan};
use crate::scene::{DEFAULT_RATE_HZ, MAG_RATE_HZ, Scene};

/// The beginning of every page, up to its first header. It loads and runs nothing. `title` is HTML, `style` is CSS that only
/// this page has.
pub fn begin(title: &str, style: &str) -> String {
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta http-equiv=\"Content-Security-Policy\" \
         content=\"default-src 'none'; style-src 'unsafe-inline'\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <title>{title} · Kestrel</title>\n<style>\n{}{}{style}</style>\n</head>\n<body>\n<main>\n",
        include_str!("style.css"),
        chart::STYLE
    )
}

/// The page of a flight of `scene` with `seed`.
pub fn page(scene: &Scene, seed: u64, outcome: &Outcome, recorder: &Recorder) -> String {
    let title = escaped(&scene.name);
    let mut html = begin(&format!("{title} · seed {seed}"), "");
    header(&mut html, scene, seed, outcome);
    cards(&mut html, scene, outcome);
    simulated(&mut html, scene, seed);
    for figure in figures::all(scene, outcome, recorder) {
        let _ = write!(
            html,
            "<figure>\n<h2>{}</h2>\n<figcaption>{}</figcaption>\n<div class=\"scroll\">{}</div>\n</figure>\n",
            figure.title,
            escaped(&figure.caption),
            figure.chart.to_svg()
        );
    }
    footer(&mut html, scene, recorder);
    html.push_str("</main>\n</body>\n</html>\n");
    html
}

fn header(html: &mut String, scene: &Scene, seed: u64, outcome: &Outcome) {
    let (class, verdict) = match outcome.crash {
        None => ("flown", "flown to the end".to_owned()),
        Some((why, at_s)) => ("crashed", format!("crashed at {at_s:.3} s: {}", why.text())),
    };
    let _ = write!(
        html,
        "<header>\n<p class=\"kind\">Kestrel · simulated flight</p>\n\
         <h1>{}</h1><span class=\"verdict {class}\">{verdict}</span>\n<p class=\"about\">{}</p>\n\
         <p class=\"facts\">seed {seed} · {} of {} · {} control steps at {DEFAULT_RATE_HZ} Hz · \
         digest <code>{:016x}</code></p>\n</header>\n",
        escaped(&scene.name),
        escaped(&scene.description),
        seconds(outcome.flown_s()),
        seconds(scene.duration_s),
        grouped(outcome.control_steps),
        outcome.digest
    );
}

fn cards(html: &mut String, scene: &Scene, outcome: &Outcome) {
    html.push_str("<dl class=\"cards\">\n");
    let mut card = |name: &str, value: String, note: &str| {
        let note = if note.is_empty() { String::new() } else { format!("<small>{note}</small>") };
        let _ = writeln!(html, "<div><dt>{name}</dt><dd>{value}{note}</dd></div>");
    };
    let degrees = |value: f64| number(value, 3, "°");
    card(
        "Attitude error, RMS",
        degrees(outcome.attitude_rmse_deg),
        &format!(
            "heading {}<br>inclination {}",
            degrees(outcome.heading_rmse_deg),
            degrees(outcome.inclination_rmse_deg)
        ),
    );
    card("Worst tilt error", degrees(outcome.tilt_error_max_deg), "of the estimate");
    card("Worst tilt", number(outcome.tilt_max_deg, 1, "°"), "of the vehicle, in truth");
    if scene.pilot.is_some() && !scene.ball_joint {
        card(
            "Furthest from target",
            number(outcome.position_error_max_m, 2, " m"),
            "while airborne, in truth",
        );
    }
    let note = match outcome.final_state {
        ArmState::Armed | ArmState::Descent => "motors permitted",
        ArmState::Terminated => "motors stopped by a fault",
        _ => "motors stopped",
    };
    card("State at the end", outcome.final_state.name().into(), note);
    html.push_str("</dl>\n");
}

fn simulated(html: &mut String, scene: &Scene, seed: u64) {
    html.push_str("<h2>What was simulated</h2>\n<table>\n");
    let mut row = |name: &str, value: &str| {
        let _ = writeln!(html, "<tr><th scope=\"row\">{name}</th><td>{value}</td></tr>");
    };
    let v = &scene.vehicle;
    let mount = if scene.ball_joint { "on a ball joint" } else { "free, above level ground" };
    row(
        "Vehicle",
        &format!(
            "{} kg, {} m from centre to rotor, thrust to weight {:.2}; {mount}",
            v.mass_kg,
            v.arm_m(),
            v.max_thrust_n() / (v.mass_kg * GRAVITY)
        ),
    );
    row("Pilot", &scene.pilot.as_ref().map_or("nobody flies".into(), |p| pilot_text(p, scene.duration_s)));
    row("Estimator", &estimator_text(scene));
    let receiver =
        if scene.pilot.is_some() { format!(", receiver {FRAME_RATE_HZ} Hz") } else { String::new() };
    row(
        "Rates",
        &format!("gyroscope and accelerometer {DEFAULT_RATE_HZ} Hz, magnetometer {MAG_RATE_HZ} Hz{receiver}"),
    );
    let effects = scene.effects();
    let list: String = effects.iter().map(|name| format!("<code>{}</code> ", escaped(name))).collect();
    row("Effects, in order", if effects.is_empty() { "none" } else { list.trim_end() });
    let (_, drawn) = scene.of_run(seed);
    if !drawn.is_empty() {
        let list: String = drawn
            .iter()
            .map(|(name, value)| format!("<code>{}</code> {value:.4e}<br>", escaped(name)))
            .collect();
        row("Drawn for this run", &list);
    }
    html.push_str("</table>\n");
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

fn estimator_text(scene: &Scene) -> String {
    let params = scene.config.params;
    let same = |(_, preset): &(&str, EstimatorParams)| {
        EstimatorParams { declination_rad: params.estimator.declination_rad, ..*preset } == params.estimator
    };
    let name = EstimatorParams::PRESETS.iter().find(|preset| same(preset)).map_or("own", |(name, _)| *name);
    let settings: Vec<String> = { params.estimator }
        .settings()
        .filter(|setting| setting.name != "estimator.declination_rad")
        .map(|setting| setting_text(setting.name.trim_start_matches("estimator."), *setting.value))
        .collect();
    let settings = settings.join(", ");
    let prefilter =
        params.prefilter_cutoff_hz.map_or("no prefilter".into(), |hz| format!("prefilter {hz} Hz"));
    let declination = f64::from(params.estimator.declination_rad).to_degrees();
    format!("<code>{name}</code>{settings}; {prefilter}; declination {}", number(declination, 3, "°"))
}

/// `tilt_tau_s` as "tilt τ = 5 s", `alpha` as "α = 0.97".
fn setting_text(name: &str, value: f32) -> String {
    let (name, unit) = name.strip_suffix("_s").map_or((name, ""), |name| (name, " s"));
    let symbols = name.replace("tau", "τ").replace("alpha", "α").replace('_', " ");
    format!("{symbols} = {}", number(f64::from(value), 4, unit))
}

fn footer(html: &mut String, scene: &Scene, recorder: &Recorder) {
    html.push_str("<footer>");
    if recorder.further_events() > 0 {
        let _ = write!(html, "{} more events are not marked. ", recorder.further_events());
    }
    if scene.pilot.is_none() {
        html.push_str("Nobody flies: motors and place stand still and are not shown. ");
    } else if scene.ball_joint {
        html.push_str("The stand holds the centre of gravity: place is not shown. ");
    }
    html.push_str(
        "Of each hundredth of a second, or each pixel where that is longer, the lowest and the highest value \
         are drawn: no peak is lost. The same scene and seed give the same page, to the byte.</footer>\n",
    );
}

/// At most so many digits after the point, without zeros at the end; what is not a number is said in words.
fn number(value: f64, digits: usize, unit: &str) -> String {
    if !value.is_finite() {
        return "not finite".into();
    }
    let shown = format!("{value:.digits$}");
    let shown = if shown.contains('.') { shown.trim_end_matches('0').trim_end_matches('.') } else { &shown };
    format!("{}{unit}", shown.replace('-', "\u{2212}"))
}

/// With a comma before every three digits.
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
