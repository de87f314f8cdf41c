//! The command `emulator`: flies a scene with the flash image.
//!
//! Results go to standard output (with `--json` only one JSON object); the firmware's log and notes go to standard error.
//! Exit codes: 0 success, 1 the flight failed, 2 bad input or usage, 130 interrupted.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Instant;

use board::Board;
use clap::Parser;
use emulator::board::Wiring;
use emulator::firmware::Firmware;
use emulator::flight::{self, Flown, Settings};
use emulator::rc_receiver::Protocol;
use emulator::timing::INSTRUCTIONS_PER_SECOND;
use input::InputError;
use serde_json::{Value, json};
use sim_host::command::{Answer, conclude, number, parse, whole_number};
use sim_host::flight::{FlightLog, summary};
use sim_host::interrupt;
use sim_host::output_file::check_outputs;
use sim_host::scene::Scene;

/// Examples at the end of the help.
const EXAMPLES: &str = "\
Example:
  emulator hover --duration 14 --log hover.csv
  emulator hover --vehicle five-inch --receiver sbus --firmware-log

From the sources, `cargo run --release -p emulator -- SCENE` is `emulator SCENE`.";

#[derive(Parser)]
#[command(
    name = "emulator",
    version,
    about = "Fly a scene with the flash image on a register-level model of the board",
    arg_required_else_help = true,
    after_help = EXAMPLES
)]
struct Arguments {
    /// Built-in scene or scene file
    scene: String,
    /// Built-in vehicle or vehicle file instead of the scene's; the board's flash gets its configuration
    #[arg(long, value_name = "NAME|F.toml")]
    vehicle: Option<String>,
    /// Seed of all random streams instead of the scene's, from 0 to 18446744073709551615
    #[arg(long, value_name = "SEED", allow_negative_numbers = true, value_parser = whole_number::<u64>(0, u64::MAX))]
    seed: Option<u64>,
    /// Duration of the flight in seconds instead of the scene's
    #[arg(long, value_name = "S", allow_negative_numbers = true, value_parser = number)]
    duration: Option<f64>,
    /// Image to fly; the default is the one that `cargo flash-fw` programs, built from the sources
    #[arg(long, value_name = "ELF")]
    image: Option<PathBuf>,
    /// Built-in board or board file; the default is the image's board, or speedybee-f405-v4 without --image
    #[arg(long, value_name = "NAME|F.toml")]
    board: Option<String>,
    /// Protocol of the RC receiver
    #[arg(long, value_enum, value_name = "PROTOCOL", default_value_t = Protocol::Crsf)]
    receiver: Protocol,
    /// Print the firmware's log with its times on standard error
    #[arg(long)]
    firmware_log: bool,
    /// Write a log of the flight: sensor samples, truth and pulses
    #[arg(long, value_name = "F.csv")]
    log: Option<PathBuf>,
    /// Print the result as one JSON object; standard output then has nothing else
    #[arg(long)]
    json: bool,
}

fn main() -> ExitCode {
    let arguments: Arguments = parse();
    interrupt::install_handler();
    conclude(run(&arguments), arguments.json)
}

fn run(arguments: &Arguments) -> Result<Answer, InputError> {
    let mut scene = Scene::load_with_vehicle(&arguments.scene, arguments.vehicle.as_deref())?;
    if let Some(seed) = arguments.seed {
        scene.seed = seed;
    }
    if let Some(duration_s) = arguments.duration {
        scene.set_duration(duration_s).map_err(|error| error.field("--duration"))?;
    }
    if scene.pilot.is_none() {
        let allowed = "is missing: the emulator flies only scenes with a pilot; `sim-host scenes` lists them";
        return Err(InputError::new(allowed).file(&scene.name).field("pilot"));
    }
    let mut inputs = scene.inputs();
    inputs.extend(arguments.image.as_deref());
    inputs.extend(arguments.board.as_deref().map(Path::new));
    check_outputs(&inputs, &[("--log", arguments.log.as_deref())])?;
    let named = arguments.board.as_deref();
    let read = arguments.image.as_deref().map(Firmware::read).transpose()?;
    let wiring = Arc::new(Wiring::new(board_of(named, read.as_ref())?, &scene.design));
    wiring.check(&scene)?;
    let firmware = read.map_or_else(|| build(named, &scene.vehicle_place), Ok)?;
    let log = arguments.log.as_ref().map(|path| FlightLog::create(path, &scene)).transpose()?;
    let settings = Settings {
        firmware: &firmware,
        wiring: wiring.clone(),
        receiver: arguments.receiver,
        config: Some(scene.board_config()),
        print_log: arguments.firmware_log,
        after_crash_s: 0.0,
        faults: Vec::new(),
        fail_fast: false,
    };
    let start = Instant::now();
    let (flown, log) = flight::fly(&scene, scene.seed, settings, log)?;
    let wall_s = start.elapsed().as_secs_f64();
    // The log of an aborted flight is dropped, because it would look like the log of a short flight.
    if let Some(log) = log.filter(|_| flown.aborted.is_none()) {
        log.finish()?;
    }
    let violations = violations(&flown);
    Ok(Answer {
        json: to_json(&scene, &firmware, &wiring, &flown, &violations, wall_s),
        text: describe(&scene, &firmware, &wiring, &flown, &violations, wall_s),
        failed: !violations.is_empty(),
    })
}

/// Returns the board to fly: that of `--board`, else that of the image, else the default board.
fn board_of(named: Option<&str>, image: Option<&Firmware>) -> Result<Board, InputError> {
    let load = |name: &str| {
        // An error within the board's file names that file instead of the option.
        Board::load(name).map_err(|error| if error.has_file() { error } else { error.field("--board") })
    };
    let Some(image) = image else { return load(named.unwrap_or(board::DEFAULT)) };
    let of_image = image.board();
    let board = load(named.unwrap_or(&of_image)).map_err(|error| match named {
        Some(_) => error,
        None => InputError::new(format!("is for the board {of_image}: give its file with --board"))
            .file(image.name()),
    })?;
    if board.name != of_image {
        let allowed = format!("is for the board {of_image}, but --board is {}", board.name);
        return Err(InputError::new(allowed).file(image.name()));
    }
    Ok(board)
}

/// Builds the image for a board and a vehicle, as `cargo flash-fw` does with `KESTREL_BOARD` and `KESTREL_VEHICLE`.
fn build(board: Option<&str>, vehicle: &str) -> Result<Firmware, InputError> {
    // A path is relative to the directory in which the command was started, and the build runs in another one.
    let place = |name: &str| match std::path::absolute(name) {
        Ok(path) if name.ends_with(".toml") => path.display().to_string(),
        _ => name.to_owned(),
    };
    let vehicle = (vehicle != vehicle::DEFAULT).then_some(vehicle);
    let named = [("KESTREL_BOARD", board), ("KESTREL_VEHICLE", vehicle)];
    let named: Vec<(&str, String)> =
        named.into_iter().filter_map(|(variable, name)| Some((variable, place(name?)))).collect();
    let variables: Vec<(&str, &str)> =
        named.iter().map(|(variable, value)| (*variable, value.as_str())).collect();
    Firmware::build(&variables)
}

/// Returns the reasons for which the flight failed.
fn violations(flown: &Flown) -> Vec<String> {
    let mut violations = Vec::new();
    violations.extend(flown.aborted.clone());
    if let Some((crash, at_s)) = flown.outcome.crash {
        violations.push(format!("crashed at {at_s:.3} s: {}", crash.text()));
    }
    let refusal = flown.records.iter().rev().filter_map(|record| record.outcome.event);
    match refusal.into_iter().find(|event| event.is_refusal()) {
        _ if flown.armed => {}
        Some(event) => violations.push(format!("did not arm: {}", event.cause.text())),
        None => violations.push("did not arm: the pilot never commanded it".into()),
    }
    if flown.armed && flown.took_off == Some(false) {
        violations.push("did not take off".into());
    }
    for (count, noun) in [
        (flown.resets.len(), "reset"),
        (flown.missed_deadlines as usize, "missed deadline"),
        (flown.gaps.len(), "gap"),
    ] {
        match count {
            0 => {}
            1 => violations.push(format!("1 {noun}")),
            _ => violations.push(format!("{count} {noun}s")),
        }
    }
    violations.extend(flown.unserved.iter().cloned());
    violations
}

fn verdict(flown: &Flown, violations: &[String]) -> String {
    if let Some(reason) = &flown.aborted {
        return format!("ABORTED at {:.3} s: {reason}", flown.outcome.flown_s());
    }
    let verdict = summary::verdict(&flown.outcome);
    // The verdict already names a crash.
    let others: Vec<&str> = violations
        .iter()
        .map(String::as_str)
        .filter(|violation| !violation.starts_with("crashed at"))
        .collect();
    if others.is_empty() { verdict } else { format!("{verdict}, BUT {}", others.join("; ")) }
}

/// Message of the `expect` on writes to a `String`.
const NEVER_FAILS: &str = "writing to a String does not fail";

fn describe(
    scene: &Scene,
    firmware: &Firmware,
    wiring: &Wiring,
    flown: &Flown,
    violations: &[String],
    wall_s: f64,
) -> String {
    let mut text = summary::describe(scene, &flown.outcome, &verdict(flown, violations), wall_s);
    let protocol = flown.escs.iter().find_map(|esc| esc.last()).map_or("none", |last| last.protocol.name());
    let timing = &flown.timing;
    write!(
        text,
        "\n\n  \
         board                    {}\n  \
         image                    {}\n  \
         image's SHA-256          {}\n  \
         motor pads               {protocol}, {} commands, {} invalid pulses or frames\n  \
         resets                   {}\n  \
         missed deadlines         {}\n  \
         instructions             {}, {:.1} % of the time\n  \
         data ready to handler    {:.2} to {:.2} us; jitter of the time stamp {:.1} us\n  \
         data ready to motors     mean {:.1} us, maximum {:.1} us; instructions mean {:.0}, maximum {}\n  \
         gaps                     {}",
        wiring.board.title,
        firmware.name(),
        firmware.sha256(),
        flown.escs.iter().map(|esc| esc.commands.len()).sum::<usize>(),
        flown.escs.iter().map(|esc| esc.invalid).sum::<u64>(),
        flown.resets.len(),
        flown.missed_deadlines,
        flown.instructions,
        flown.instructions as f64 / (flown.outcome.flown_s() * INSTRUCTIONS_PER_SECOND as f64) * 100.0,
        timing.entry_ns.min as f64 * 1e-3,
        timing.entry_ns.max as f64 * 1e-3,
        timing.stamp_jitter_ns() as f64 * 1e-3,
        timing.latency_ns.mean() * 1e-3,
        timing.latency_ns.max as f64 * 1e-3,
        timing.latency_instructions.mean(),
        timing.latency_instructions.max,
        flown.gaps.len(),
    )
    .expect(NEVER_FAILS);
    for gap in &flown.gaps {
        write!(text, "\n    {gap}").expect(NEVER_FAILS);
    }
    for (handler, runs) in wiring.handlers.iter().zip(&timing.runs) {
        let name = format!("{}: {}", handler.vector, handler.task);
        write!(
            text,
            "\n  priority {} {name:<28} {} runs, instructions mean {:.0}, maximum {}, {:.2} % of the time",
            handler.priority,
            runs.count(),
            runs.mean(),
            runs.max,
            runs.share_of_time(flown.outcome.flown_s()) * 100.0
        )
        .expect(NEVER_FAILS);
    }
    for (at_s, state) in &flown.states {
        write!(text, "\n  {at_s:7.3} s  {}", state.name()).expect(NEVER_FAILS);
    }
    for (at_s, cause) in &flown.resets {
        write!(text, "\n  {at_s:7.3} s  reset: {cause}").expect(NEVER_FAILS);
    }
    text
}

fn to_json(
    scene: &Scene,
    firmware: &Firmware,
    wiring: &Wiring,
    flown: &Flown,
    violations: &[String],
    wall_s: f64,
) -> Value {
    let mut json = summary::to_json(scene, scene.seed, &flown.outcome, wall_s);
    let timing = &flown.timing;
    let further = json!({
        "board": wiring.board.name,
        "firmware": firmware.name(),
        "image_sha256": firmware.sha256(),
        "armed": flown.armed,
        "took_off": flown.took_off,
        "violations": violations,
        "resets": flown.resets.len(),
        "missed_deadlines": flown.missed_deadlines,
        "instructions": flown.instructions,
        "gaps": flown.gaps.len(),
        "gap_list": flown.gaps,
        "unserved_vectors": flown.unserved,
        "states": flown.states.iter().map(|(at_s, state)| json!({ "at_s": (at_s * 1e3).round() / 1e3, "state": state.name() })).collect::<Vec<_>>(),
        "pads_digest": format!("{:016x}", flown.pads_digest),
        "latency_instructions_mean": timing.latency_instructions.mean(),
        "latency_instructions_max": timing.latency_instructions.max,
        "latency_us_max": timing.latency_ns.max as f64 * 1e-3,
        "handlers": wiring.handlers.iter().zip(&timing.runs).map(|(handler, runs)| json!({
            "vector": handler.vector, "task": handler.task, "priority": handler.priority, "runs": runs.count(),
            "instructions_mean": runs.mean(), "instructions_max": runs.max, "share": runs.share_of_time(flown.outcome.flown_s()),
        })).collect::<Vec<_>>(),
        "stamp_jitter_us": timing.stamp_jitter_ns() as f64 * 1e-3,
        "entry_us_min": timing.entry_ns.min as f64 * 1e-3,
        "entry_us_max": timing.entry_ns.max as f64 * 1e-3,
    });
    if let (Value::Object(json), Value::Object(further)) = (&mut json, further) {
        json.extend(further);
    }
    json
}
