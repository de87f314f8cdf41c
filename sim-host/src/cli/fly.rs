//! The command `fly`.

use std::fmt::Write as _;
use std::time::Instant;

use input::InputError;
use sim_host::flight::summary::{describe, to_json, verdict};
use sim_host::flight::{Flight, FlightLog};
use sim_host::output_file::check_outputs;
use sim_host::report::{self, Recorder};
use sim_host::scene::Scene;

use super::progress::FlightProgress;
use super::{Answer, FlyArguments, campaign, load};

pub fn run(arguments: &FlyArguments) -> Result<Answer, InputError> {
    let scene = load(&arguments.scene, arguments.vehicle.as_deref(), arguments.seed, arguments.duration)?;
    // With --out even a single run is a campaign: the file of results has its columns.
    if arguments.runs > 1 || arguments.out.is_some() {
        campaign::fly(&scene, arguments)
    } else {
        fly_once(&scene, arguments)
    }
}

/// Flies one flight and writes the log and the report that were asked for.
fn fly_once(scene: &Scene, arguments: &FlyArguments) -> Result<Answer, InputError> {
    let (log, report) = (arguments.log.as_deref(), arguments.report.as_deref());
    check_outputs(&scene.inputs(), &[("--log", log), ("--report", report)])?;
    let log = log.map(|path| FlightLog::create(path, scene)).transpose()?;
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
    for (name, value) in scene.for_run(scene.seed).1 {
        write!(text, "\n  drawn: {name:<33} {value:.6e}").expect("writing to a String does not fail");
    }
    Ok(Answer {
        json: to_json(scene, scene.seed, &outcome, wall_s),
        text,
        failed: u64::from(outcome.crash.is_some()) > arguments.max_failures,
    })
}
