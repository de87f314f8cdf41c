//! The outcome of a flight, as text and as JSON.

use serde_json::{Value, json};

use super::{Outcome, step_count};
use crate::scene::Scene;

/// Returns the outcome of a flight of `scene` as JSON.
pub fn to_json(scene: &Scene, seed: u64, outcome: &Outcome, wall_s: f64) -> Value {
    let mut json = outcome_json(outcome);
    let drawn = scene.for_run(seed).1;
    let further = json!({
        "scene": scene.name,
        "seed": seed,
        "duration_s": scene.duration_s,
        "wall_s": wall_s,
        "steps_per_s": outcome.control_steps as f64 / wall_s,
        "real_time_factor": outcome.flown_s() / wall_s,
        "warnings": warnings(scene, outcome),
    });
    if let (Value::Object(json), Value::Object(further)) = (&mut json, further) {
        json.extend(further);
        if !drawn.is_empty() {
            json.insert("drawn".into(), drawn_json(&drawn));
        }
    }
    json
}

/// Returns what a user may not have intended, although the flight did not fail.
pub fn warnings(scene: &Scene, outcome: &Outcome) -> Vec<String> {
    let lands = scene.pilot.as_ref().is_some_and(|pilot| pilot.plan.land_before_end_s.is_some());
    let to_the_end = outcome.crash.is_none() && outcome.control_steps == step_count(scene.duration_s);
    let mut warnings = scene.warnings();
    if lands && to_the_end && outcome.final_state.flies() {
        warnings.push(format!(
            "the scene ended during the landing, in the state {}: pilot.land_before_end_s is too short",
            outcome.final_state.name()
        ));
    }
    warnings
}

/// Returns the verdict on a flight: how it ended.
pub fn verdict(outcome: &Outcome) -> String {
    match outcome.crash {
        None => "flown to the end".into(),
        Some((crash, at_s)) => format!("CRASHED at {at_s:.3} s: {}", crash.text()),
    }
}

/// Formats a rate: `3.21 million`, or `2650` (typical of a flight on QEMU or on the emulator).
fn rate(per_s: f64) -> String {
    if per_s >= 1.0e5 { format!("{:.2} million", per_s * 1e-6) } else { format!("{per_s:.0}") }
}

/// Returns the outcome as text.
pub fn describe(scene: &Scene, outcome: &Outcome, verdict: &str, wall_s: f64) -> String {
    let mut text = format!(
        "{name} (seed {seed}): {verdict}, {state:?}\n\
         {description}\n  \
         estimate against truth   {rmse:.3}° RMSE (heading {heading:.3}°, inclination {inclination:.3}°)\n  \
         worst tilt error         {tilt_error:.3}°\n  \
         worst tilt               {tilt:.2}°\n  \
         worst distance           {distance:.3} m from the pilot's target\n  \
         speed                    {flown:.1} s in {wall_s:.3} s: {factor:.0} × real time, {rate} steps/s\n  \
         digest                   {digest:016x}",
        name = scene.name,
        seed = scene.seed,
        state = outcome.final_state,
        description =
            if scene.description.is_empty() { String::new() } else { format!("{}\n", scene.description) },
        rmse = outcome.attitude_rmse_deg,
        heading = outcome.heading_rmse_deg,
        inclination = outcome.inclination_rmse_deg,
        tilt_error = outcome.tilt_error_max_deg,
        tilt = outcome.tilt_max_deg,
        distance = outcome.position_error_max_m,
        flown = outcome.flown_s(),
        factor = outcome.flown_s() / wall_s,
        rate = rate(outcome.control_steps as f64 / wall_s),
        digest = outcome.digest,
    );
    for warning in warnings(scene, outcome) {
        text.push_str("\n  warning: ");
        text.push_str(&warning);
    }
    text
}

/// Returns an outcome as JSON.
pub fn outcome_json(outcome: &Outcome) -> Value {
    json!({
        "control_steps": outcome.control_steps,
        "attitude_rmse_deg": outcome.attitude_rmse_deg,
        "heading_rmse_deg": outcome.heading_rmse_deg,
        "inclination_rmse_deg": outcome.inclination_rmse_deg,
        "tilt_error_max_deg": outcome.tilt_error_max_deg,
        "tilt_max_deg": outcome.tilt_max_deg,
        "position_error_max_m": outcome.position_error_max_m,
        "crashed": outcome.crash.is_some(),
        "crash": outcome.crash.map(|(crash, at_s)| json!({ "cause": crash.text(), "at_s": at_s })),
        "final_state": outcome.final_state.name(),
        "digest": format!("{:016x}", outcome.digest),
    })
}

/// Returns the values drawn for a run as JSON.
pub fn drawn_json(drawn: &[(String, f64)]) -> Value {
    drawn.iter().map(|(name, value)| (name.clone(), json!(value))).collect()
}
