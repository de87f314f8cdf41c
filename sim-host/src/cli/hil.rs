//! The command `hil`.

use std::fmt::Write as _;
use std::num::NonZeroU32;
use std::path::{Path, PathBuf};
use std::time::Instant;

use input::InputError;
use serde_json::{Value, json};
use sim_host::flight::{FlightLog, summary};
use sim_host::hil::{self, Faults, Flown, LinkError, QemuExit, Received, Report, Serial, Wire};
use sim_host::image::image_sha256;
use sim_host::input_file::read_image;
use sim_host::interrupt;
use sim_host::output_file::{OutputFile, check_outputs};
use sim_host::report::{self, Recorder};
use sim_host::scene::Scene;

use super::fly::write_flight;
use super::progress::FlightProgress;
use super::{Answer, HilArguments, load};

pub fn run(arguments: &HilArguments) -> Result<Answer, InputError> {
    let scene = load(&arguments.scene, arguments.vehicle.as_deref(), arguments.seed, arguments.duration)?;
    match &arguments.board.serial {
        Some(port) => {
            let mut serial = Serial::open(port)?;
            let (flown, wall_s) = fly_once(&mut serial, &scene, arguments)?;
            Ok(answer(&scene, port, &flown, wall_s, None))
        }
        None => on_qemu(&scene, arguments),
    }
}

#[cfg(unix)]
fn on_qemu(scene: &Scene, arguments: &HilArguments) -> Result<Answer, InputError> {
    if arguments.firmware_log {
        return with_log(scene, arguments);
    }
    let image = image(arguments)?;
    let mut qemu = hil::Qemu::start(&image)?;
    let (flown, wall_s) = fly_once(&mut qemu, scene, arguments)?;
    Ok(answer(scene, &image, &flown, wall_s, Some(&qemu.end())))
}

/// Returns the image of `--image`, or builds one.
#[cfg(unix)]
fn image(arguments: &HilArguments) -> Result<PathBuf, InputError> {
    arguments.image.as_deref().map_or_else(|| hil::build(hil::PIPES), hil::check)
}

#[cfg(all(target_os = "linux", feature = "firmware-log"))]
fn with_log(scene: &Scene, arguments: &HilArguments) -> Result<Answer, InputError> {
    let image = image(arguments)?;
    let mut qemu = hil::WithLog::start(&image, |line| sim_host::output_file::print_note(&line.to_string()))?;
    let (flown, wall_s) = fly_once(&mut qemu, scene, arguments)?;
    Ok(answer(scene, &image, &flown, wall_s, Some(&qemu.end())))
}

#[cfg(all(unix, not(all(target_os = "linux", feature = "firmware-log"))))]
fn with_log(_: &Scene, _: &HilArguments) -> Result<Answer, InputError> {
    let needed = if cfg!(target_os = "linux") {
        "needs a build with the decoder: cargo run --release -p sim-host --features firmware-log -- hil ..."
    } else {
        "needs Linux, to read QEMU's memory"
    };
    Err(InputError::new(needed).field("--firmware-log"))
}

#[cfg(not(unix))]
fn on_qemu(_: &Scene, _: &HilArguments) -> Result<Answer, InputError> {
    Err(InputError::new("needs named pipes, which this system does not have").field("--qemu"))
}

/// Flies one flight and writes the log and the report that were asked for.
fn fly_once(
    wire: &mut impl Wire,
    scene: &Scene,
    arguments: &HilArguments,
) -> Result<(Flown, f64), InputError> {
    let mut inputs = scene.inputs();
    inputs.extend(arguments.image.as_deref());
    check_outputs(
        &inputs,
        &[("--log", arguments.log.as_deref()), ("--report", arguments.report.as_deref())],
    )?;
    let log = arguments.log.as_ref().map(|path| FlightLog::create(path, scene)).transpose()?;
    let report = arguments.report.as_ref().map(OutputFile::create).transpose()?;
    let recorder = report.as_ref().map(|_| Recorder::new());
    let progress = FlightProgress::new(scene.duration_s, &scene.name);

    let mut observer = ((log, recorder), progress);
    let stop = interrupt::stop_flag();
    let start = Instant::now();
    let flown = hil::fly(wire, scene, scene.seed, faults(arguments), stop, &mut observer);
    let wall_s = start.elapsed().as_secs_f64();
    let ((log, recorder), progress) = observer;
    progress.finish();

    // An interrupted flight writes no files: they would look like those of a short flight.
    if flown.ended.is_ok() {
        let page = |recorder: Recorder| report::page(scene, scene.seed, &flown.outcome, &recorder);
        write_flight(log, report.zip(recorder.map(page)))?;
    }
    Ok((flown, wall_s))
}

fn faults(arguments: &HilArguments) -> Faults {
    let from_us = (arguments.drop_at_s.unwrap_or(0.0) * 1e6) as u64;
    let for_us = u64::from(arguments.drop_for_ms.unwrap_or(0)) * 1_000;
    let flip_bit_every = arguments.flip_bit_every.and_then(NonZeroU32::new);
    Faults { flip_bit_every, dropped_us: from_us..from_us + for_us }
}

/// Returns what went wrong besides a crash of the vehicle, if anything.
fn violation(flown: &Flown, exit: Option<&QemuExit>) -> Option<String> {
    match (&flown.ended, exit) {
        (Err(LinkError::Closed), Some(exit)) => Some(exit.description()),
        (Err(error), _) => Some(error.to_string()),
        (Ok(()), Some(exit)) if !exit.is_success() => Some(exit.description()),
        (Ok(()), _) if !flown.report.is_clean() => Some("the link lost or damaged frames".into()),
        (Ok(()), _) => None,
    }
}

fn answer(scene: &Scene, firmware: &Path, flown: &Flown, wall_s: f64, exit: Option<&QemuExit>) -> Answer {
    let Flown { outcome, ended, report } = flown;
    let violation = violation(flown, exit);
    let verdict = match (ended, &violation) {
        (Err(_), Some(why)) => format!("ABORTED at {:.3} s: {why}", outcome.flown_s()),
        (Ok(()), Some(why)) => format!("{}, BUT {why}", summary::verdict(outcome)),
        _ => summary::verdict(outcome),
    };
    let unmodelled = exit.map(|exit| &exit.unmodelled[..]);
    // Only for QEMU: the image of a board at a serial port is unknown.
    let sha256 = exit.and_then(|_| image_sha256(&read_image(firmware).ok()?).ok());
    let output_tail = exit.filter(|_| violation.is_some()).map_or(&[][..], |exit| &exit.output_tail);

    let mut text = summary::describe(scene, outcome, &verdict, wall_s);
    write!(
        text,
        "\n\n  \
         firmware                 {}{}\n  \
         frames                   {}, {} of them without an answer\n  \
         link                     to the firmware {}; from it {}\n  \
         resets                   {}\n  \
         missed deadlines         {}\n  \
         instructions             {}",
        firmware.display(),
        sha256.as_ref().map_or(String::new(), |sha256| format!(", sha256 {sha256}")),
        report.frames,
        report.unanswered,
        in_words(report.to_board),
        in_words(report.to_host),
        resets(report),
        report.missed_deadlines,
        report.mean_instructions().map_or("not counted".into(), |mean| {
            format!("mean {mean:.0}, maximum {} from sample to motors", report.max_instructions)
        }),
    )
    .expect(NEVER_FAILS);
    if let Some(unmodelled) = unmodelled {
        write!(text, "\n  unmodelled accesses      {}", unmodelled.len()).expect(NEVER_FAILS);
        for line in unmodelled.iter().take(MAX_LINES) {
            write!(text, "\n    {line}").expect(NEVER_FAILS);
        }
    }
    if !output_tail.is_empty() {
        write!(text, "\n  last output of QEMU and firmware").expect(NEVER_FAILS);
        output_tail.iter().for_each(|line| write!(text, "\n    {line}").expect(NEVER_FAILS));
    }

    let mut json = summary::to_json(scene, scene.seed, outcome, wall_s);
    let further = json!({
        "firmware": firmware.display().to_string(),
        "image_sha256": sha256,
        "ended_by": violation,
        "frames": report.frames,
        "unanswered": report.unanswered,
        "to_board": to_json(report.to_board),
        "to_host": to_json(report.to_host),
        "resets": report.resets.iter().map(|reset| json!({
            "at_s": reset.time_us as f64 * 1e-6,
            "by_watchdog": reset.by_watchdog,
        })).collect::<Vec<_>>(),
        "missed_deadlines": report.missed_deadlines,
        "instructions_mean": report.mean_instructions(),
        "instructions_max": report.mean_instructions().map(|_| report.max_instructions),
        "unmodelled_accesses": unmodelled.map(<[String]>::len),
        "output_tail": output_tail,
    });
    if let (Value::Object(json), Value::Object(further)) = (&mut json, further) {
        json.extend(further);
    }
    Answer { json, text, failed: violation.is_some() || outcome.crash.is_some() }
}

/// Why the result of writing to a `String` is not handled.
const NEVER_FAILS: &str = "writing to a String does not fail";
/// Unmodelled accesses that are printed; further ones are only counted.
const MAX_LINES: usize = 10;

fn in_words(received: Received) -> String {
    let Received { corrupt, lost, repeated } = received;
    format!("{corrupt} damaged, {lost} lost, {repeated} repeated or late")
}

fn to_json(received: Received) -> Value {
    let Received { corrupt, lost, repeated } = received;
    json!({ "corrupt": corrupt, "lost": lost, "repeated": repeated })
}

fn resets(report: &Report) -> String {
    let one = |reset: &hil::Reset| {
        let by = if reset.by_watchdog { " by the watchdog" } else { "" };
        format!("at {:.3} s{by}", reset.time_us as f64 * 1e-6)
    };
    if report.resets.is_empty() {
        "none".into()
    } else {
        report.resets.iter().map(one).collect::<Vec<_>>().join(", ")
    }
}
