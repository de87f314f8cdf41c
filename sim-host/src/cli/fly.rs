//! The command `fly`.

use std::fmt::Write as _;
use std::time::Instant;

use serde_json::{Value, json};
use sim_host::campaign::{drawn_json, outcome_json};
use sim_host::flight::{Flight, FlightLog, Outcome};
use sim_host::input_error::InputError;
use sim_host::report::{self, Recorder};
use sim_host::scene::Scene;

use super::progress::FlightProgress;
use super::{Answer, FlyArguments, campaign, load};

pub fn run(arguments: &FlyArguments) -> Result<Answer, InputError> {
    let scene = load(&arguments.scene, arguments.seed, arguments.duration)?;
    // A file of results is one of a campaign, even if that is a single run.
    if arguments.runs > 1 || arguments.out.is_some() {
        campaign::fly(&scene, arguments)
    } else {
        one(&scene, arguments)
    }
}

/// One flight, with whatever is to be written about it.
fn one(scene: &Scene, arguments: &FlyArguments) -> Result<Answer, InputError> {
    let log = arguments.log.as_ref().map(|path| FlightLog::create(path, scene)).transpose()?;
    let recorder = arguments.report.as_ref().map(|_| Recorder::new());
    let progress = FlightProgress::new(scene.duration_s, &scene.name);

    let mut observer = ((log, recorder), progress);
    let start = Instant::now();
    let outcome = Flight::new(scene, scene.seed).run(&mut observer);
    let wall_s = start.elapsed().as_secs_f64();
    let ((log, recorder), progress) = observer;
    progress.finish();

    if let Some(log) = log {
        log.finish()?;
    }
    if let (Some(path), Some(recorder)) = (&arguments.report, &recorder) {
        report::write(path, scene, scene.seed, &outcome, recorder)?;
    }
    let mut text = describe(scene, &outcome, &verdict(&outcome), wall_s);
    for (name, value) in scene.of_run(scene.seed).1 {
        write!(text, "\n  drawn: {name:<33} {value:.6e}").expect("a String takes everything");
    }
    Ok(Answer {
        json: to_json(scene, scene.seed, &outcome, wall_s),
        text,
        failed: u64::from(outcome.crash.is_some()) > arguments.max_failures,
    })
}

/// An outcome for programs.
pub fn to_json(scene: &Scene, seed: u64, outcome: &Outcome, wall_s: f64) -> Value {
    let mut json = outcome_json(outcome);
    let drawn = scene.of_run(seed).1;
    let further = json!({
        "scene": scene.name,
        "seed": seed,
        "duration_s": scene.duration_s,
        "wall_s": wall_s,
        "steps_per_s": outcome.control_steps as f64 / wall_s,
        "real_time_factor": outcome.flown_s() / wall_s,
    });
    if let (Value::Object(json), Value::Object(further)) = (&mut json, further) {
        json.extend(further);
        if !drawn.is_empty() {
            json.insert("drawn".into(), drawn_json(&drawn));
        }
    }
    json
}

/// How a flight ended.
pub fn verdict(outcome: &Outcome) -> String {
    match outcome.crash {
        None => "flown to the end".into(),
        Some((crash, at_s)) => format!("CRASHED at {at_s:.3} s: {}", crash.text()),
    }
}

/// An outcome for people.
pub fn describe(scene: &Scene, outcome: &Outcome, verdict: &str, wall_s: f64) -> String {
    format!(
        "{name} (seed {seed}): {verdict}, {state:?}\n\
         {description}\n\n  \
         estimate against truth   {rmse:.3}° RMSE (heading {heading:.3}°, inclination {inclination:.3}°)\n  \
         worst tilt error         {tilt_error:.3}°\n  \
         worst tilt               {tilt:.2}°\n  \
         worst distance           {distance:.3} m from the pilot's target\n  \
         speed                    {flown:.1} s in {wall_s:.3} s: {factor:.0} × real time, {rate:.2} million steps a second\n  \
         digest                   {digest:016x}",
        name = scene.name,
        seed = scene.seed,
        state = outcome.final_state,
        description = scene.description,
        rmse = outcome.attitude_rmse_deg,
        heading = outcome.heading_rmse_deg,
        inclination = outcome.inclination_rmse_deg,
        tilt_error = outcome.tilt_error_max_deg,
        tilt = outcome.tilt_max_deg,
        distance = outcome.position_error_max_m,
        flown = outcome.flown_s(),
        factor = outcome.flown_s() / wall_s,
        rate = outcome.control_steps as f64 / wall_s * 1e-6,
        digest = outcome.digest,
    )
}
