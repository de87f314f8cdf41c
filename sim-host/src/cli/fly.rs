//! The command `fly`.

use std::fmt::Write as _;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use serde_json::{Value, json};
use sim_host::flight::{Flight, FlightLog, Outcome};
use sim_host::input_error::InputError;
use sim_host::report::{self, Recorder};
use sim_host::scene::Scene;

use super::progress::{self, FlightProgress};
use super::{Answer, FlyArguments, load};

pub fn run(arguments: &FlyArguments) -> Result<Answer, InputError> {
    let scene = load(&arguments.scene, arguments.seed, arguments.duration)?;
    if arguments.runs > 1 { Ok(many(&scene, arguments.runs)) } else { one(&scene, arguments) }
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
    Ok(Answer {
        json: to_json(scene, scene.seed, &outcome, wall_s),
        text: describe(scene, &outcome, &verdict(&outcome), wall_s),
        failed: outcome.crash.is_some(),
    })
}

/// Flights with seeds counting up from the scene's, on all cores; the answer does not depend on how many.
fn many(scene: &Scene, runs: u64) -> Answer {
    let bar = progress::bar(runs, &scene.name);
    let next = AtomicU64::new(0);
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let start = Instant::now();
    let mut flown: Vec<(u64, Outcome, f64)> = std::thread::scope(|scope| {
        let worker = || {
            let mut mine = Vec::new();
            loop {
                let run = next.fetch_add(1, Ordering::Relaxed);
                if run >= runs {
                    return mine;
                }
                let seed = scene.seed.wrapping_add(run);
                let start = Instant::now();
                let outcome = Flight::new(scene, seed).run(&mut ());
                mine.push((seed, outcome, start.elapsed().as_secs_f64()));
                bar.inc(1);
            }
        };
        let workers: Vec<_> = (0..threads).map(|_| scope.spawn(worker)).collect();
        workers.into_iter().flat_map(|w| w.join().expect("a flight does not panic")).collect()
    });
    let wall_s = start.elapsed().as_secs_f64();
    bar.finish_and_clear();
    flown.sort_by_key(|(seed, ..)| seed.wrapping_sub(scene.seed));
    summarise(scene, &flown, wall_s)
}

fn summarise(scene: &Scene, flown: &[(u64, Outcome, f64)], wall_s: f64) -> Answer {
    let crashes = flown.iter().filter(|(_, outcome, _)| outcome.crash.is_some()).count();
    let steps: u64 = flown.iter().map(|(_, outcome, _)| outcome.control_steps).sum();
    let worst = |what: fn(&Outcome) -> f64| flown.iter().map(|(_, o, _)| what(o)).fold(0.0, f64::max);
    let squares: f64 = flown.iter().map(|(_, o, _)| o.attitude_rmse_deg * o.attitude_rmse_deg).sum();
    let rmse_deg = libm::sqrt(squares / flown.len() as f64);
    let mut text = format!(
        "{}: {} flights, {crashes} crashed\n  attitude error  {rmse_deg:.3}° RMSE, worst flight {:.3}°\n  \
         worst tilt {:.1}°, worst distance from the target {:.2} m\n  {:.2} million steps a second",
        scene.name,
        flown.len(),
        worst(|o| o.attitude_rmse_deg),
        worst(|o| o.tilt_max_deg),
        worst(|o| o.position_error_max_m),
        steps as f64 / wall_s * 1e-6,
    );
    for (seed, outcome, _) in flown {
        if let Some((crash, at_s)) = outcome.crash {
            write!(text, "\n  seed {seed} crashed at {at_s:.3} s: {}", crash.text())
                .expect("a String takes everything");
        }
    }
    let runs: Vec<Value> = flown.iter().map(|(seed, o, wall_s)| to_json(scene, *seed, o, *wall_s)).collect();
    let json = json!({
        "scene": scene.name,
        "seed": scene.seed,
        "duration_s": scene.duration_s,
        "control_steps": steps,
        "wall_s": wall_s,
        "steps_per_s": steps as f64 / wall_s,
        "attitude_rmse_deg": rmse_deg,
        "tilt_max_deg": worst(|o| o.tilt_max_deg),
        "crashed": crashes > 0,
        "crashes": crashes,
        "runs": runs,
    });
    Answer { json, text, failed: crashes > 0 }
}

/// An outcome for programs.
pub fn to_json(scene: &Scene, seed: u64, outcome: &Outcome, wall_s: f64) -> Value {
    let flown_s = outcome.flown_s();
    json!({
        "scene": scene.name,
        "seed": seed,
        "duration_s": scene.duration_s,
        "control_steps": outcome.control_steps,
        "wall_s": wall_s,
        "steps_per_s": outcome.control_steps as f64 / wall_s,
        "real_time_factor": flown_s / wall_s,
        "attitude_rmse_deg": outcome.attitude_rmse_deg,
        "heading_rmse_deg": outcome.heading_rmse_deg,
        "inclination_rmse_deg": outcome.inclination_rmse_deg,
        "tilt_error_max_deg": outcome.tilt_error_max_deg,
        "tilt_max_deg": outcome.tilt_max_deg,
        "position_error_max_m": outcome.position_error_max_m,
        "crashed": outcome.crash.is_some(),
        "crash": outcome.crash.map(|(crash, at_s)| json!({ "cause": crash.text(), "at_s": at_s })),
        "final_state": format!("{:?}", outcome.final_state),
        "digest": format!("{:016x}", outcome.digest),
    })
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
