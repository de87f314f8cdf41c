//! The command `fly`.

use std::fmt::Write as _;
use std::time::Instant;

use input::InputError;
use sim_host::flight::summary::{describe, to_json, verdict};
use sim_host::flight::{Flight, FlightLog};
use sim_host::output_file::{OutputFile, check_outputs, finish_all};
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
    // Both are created before the flight: a file that cannot be written is an error now.
    let log = log.map(|path| FlightLog::create(path, scene)).transpose()?;
    let report = report.map(OutputFile::create).transpose()?;
    let recorder = report.as_ref().map(|_| Recorder::new());
    let progress = FlightProgress::new(scene.duration_s, &scene.name);

    let mut observer = ((log, recorder), progress);
    let start = Instant::now();
    let outcome = Flight::new(scene, scene.seed).run(&mut observer);
    let wall_s = start.elapsed().as_secs_f64();
    let ((log, recorder), progress) = observer;
    progress.finish();

    let page = |recorder: Recorder| report::page(scene, scene.seed, &outcome, &recorder);
    write_flight(log, report.zip(recorder.map(page)))?;
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

/// Completes the log and the report of a flight: both, or neither.
pub fn write_flight(log: Option<FlightLog>, report: Option<(OutputFile, String)>) -> Result<(), InputError> {
    let mut files: Vec<OutputFile> = log.map(FlightLog::into_file).transpose()?.into_iter().collect();
    if let Some((mut file, page)) = report {
        file.write_text(&page)?;
        files.push(file);
    }
    finish_all(files)
}
