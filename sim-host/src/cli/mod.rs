//! The command line: parses the arguments, runs the command, and prints its result as text or as JSON.

mod allan;
mod campaign;
mod config;
mod fly;
mod hil;
mod listing;
mod progress;
mod recordings;
mod studies;
mod vehicle;

use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Parser, Subcommand, ValueEnum};
use input::InputError;
use sim_host::campaign::{MAX_RUNS, Shard};
use sim_host::command::{Answer, conclude, heading, number, parse, whole_number};
use sim_host::{interrupt, log};

#[derive(Parser)]
#[command(name = "sim-host", version, about = "Simulator for the Kestrel flight controller", long_about = None)]
#[command(arg_required_else_help = true, after_help = EXAMPLES)]
struct Arguments {
    /// Print the result as one JSON object; standard output then has nothing else
    #[arg(long, global = true)]
    json: bool,
    #[command(subcommand)]
    command: Command,
}

/// Examples at the end of the program's help.
const EXAMPLES: &str = "\
Example:
  sim-host fly hover
  sim-host scenes

`sim-host COMMAND --help` shows the options and an example of a command.
From the sources, `cargo run --release -- COMMAND` is `sim-host COMMAND`.";

#[derive(Subcommand)]
enum Command {
    /// Fly a scene in closed loop, once or many times, and check each flight against the truth
    #[command(after_help = "\
Example:
  sim-host fly hover --log hover.csv --report hover.html
  sim-host fly windy-landing --runs 20 --out runs.csv")]
    Fly(FlyArguments),
    /// Merge the shards of a campaign that `fly --runs N --shard I/M` has flown
    #[command(after_help = "\
Example:
  sim-host fly hover --runs 4 --shard 1/2 --out part-1.csv
  sim-host fly hover --runs 4 --shard 2/2 --out part-2.csv
  sim-host merge part-1.csv part-2.csv --out runs.csv")]
    Merge(MergeArguments),
    /// Fly a scene with the firmware, on QEMU or on a board (hardware in the loop)
    #[command(after_help = "\
Example:
  sim-host hil hover --qemu
  sim-host hil hover --serial /dev/ttyUSB0 --log hover.csv")]
    Hil(HilArguments),
    /// Simulate the sensors of a scene and write their samples and the truth
    #[command(after_help = "\
Example:
  sim-host sense static --duration 60 --rate-hz 200 --out static.csv")]
    Sense(SenseArguments),
    /// Run the estimators of the flight code over a log
    #[command(after_help = "\
Example:
  sim-host sense stand-steps --out log.csv
  sim-host estimate log.csv --estimator paper flight

`estimate` corrects neither hard iron nor declination, and a simulated log contains both. The heading error is then large:
compare the inclination.")]
    Estimate(EstimateArguments),
    /// Identify the errors of a sensor from a recording at rest, by its Allan deviation
    #[command(after_help = "\
Example:
  sim-host sense static --duration 600 --rate-hz 200 --out still.csv
  sim-host allan still.csv --plot allan.svg --imu imu.toml")]
    Allan(allan::AllanArguments),
    /// List the effects of a scene in order, the computing time of each, and the effects that the scene does not name
    #[command(after_help = "\
Example:
  sim-host plan windy-landing")]
    Plan(PlanArguments),
    /// Compare the error and the computing time of the settings of each part
    #[command(after_help = "\
Example:
  sim-host cost estimator --quick

`sim-host cost --help` builds the program `studies` and shows the options.")]
    Cost(studies::ForwardedArguments),
    /// Reproduce the tables and figures of the paper, on one page with CSV files beside it
    #[command(after_help = "\
Example:
  sim-host paper --out paper

`sim-host paper --help` builds the program `studies` and shows the options.")]
    Paper(studies::ForwardedArguments),
    /// Write the flight controller's configuration of a scene as the stored configuration of a board
    #[command(after_help = "\
Example:
  sim-host config hover --out config.bin")]
    Config(ConfigArguments),
    /// Show the values derived from a vehicle file, the margins of the control loops, and warnings; propose gains
    #[command(after_help = "\
Example:
  sim-host vehicle five-inch
  sim-host vehicle five-inch --tune --report step.html")]
    Vehicle(vehicle::VehicleArguments),
    /// List the built-in scenes and their effects
    #[command(after_help = "\
Example:
  sim-host scenes")]
    Scenes,
}

#[derive(clap::Args)]
struct FlyArguments {
    /// Built-in scene (`sim-host scenes` lists them) or scene file
    #[arg(default_value = "hover")]
    scene: String,
    /// Built-in vehicle or vehicle file [default: the scene's]
    #[arg(long, value_name = "NAME|F.toml")]
    vehicle: Option<String>,
    /// Seed of all random streams, from 0 to 18446744073709551615 [default: the scene's]
    #[arg(long, value_name = "SEED", allow_negative_numbers = true, value_parser = whole_number::<u64>(0, u64::MAX))]
    seed: Option<u64>,
    /// Length of the flight in seconds [default: the scene's]
    #[arg(long, value_name = "S", allow_negative_numbers = true, value_parser = number)]
    duration: Option<f64>,
    /// Number of flights, at most 1000000; the seed goes up by one with each
    #[arg(
        long, value_name = "N", default_value_t = 1,
        allow_negative_numbers = true, value_parser = whole_number::<u64>(1, MAX_RUNS)
    )]
    runs: u64,
    /// Number of flights in parallel, without effect on the results [default: one for each core]
    #[arg(
        long, value_name = "J", requires = "runs",
        allow_negative_numbers = true, value_parser = whole_number::<u16>(1, u16::MAX.into())
    )]
    jobs: Option<u16>,
    /// Fly shard I of N of the runs; `merge` merges the files of all shards
    #[arg(long, value_name = "I/N", requires_all = ["runs", "out"])]
    shard: Option<Shard>,
    /// Write the results, one row for each run
    #[arg(long, value_name = "F.csv", requires = "runs")]
    out: Option<PathBuf>,
    /// Crashes tolerated before exit code 1
    #[arg(
        long, value_name = "K", requires = "runs", default_value_t = 0,
        allow_negative_numbers = true, value_parser = whole_number::<u64>(0, u64::MAX)
    )]
    max_failures: u64,
    /// Write a log of the flight: sensor samples, truth and motor pulses
    #[arg(long, value_name = "F.csv", conflicts_with_all = ["runs", "out"])]
    log: Option<PathBuf>,
    /// Write a report with plots: one HTML file that needs no network
    #[arg(long, value_name = "F.html", conflicts_with_all = ["runs", "out"])]
    report: Option<PathBuf>,
}

#[derive(clap::Args)]
struct MergeArguments {
    /// Files from `fly --shard`: one for each shard, in any order
    #[arg(required = true, value_name = "PART.csv")]
    parts: Vec<PathBuf>,
    /// Write the results of all runs, byte for byte as `fly --out` without `--shard` writes them
    #[arg(long, value_name = "F.csv")]
    out: Option<PathBuf>,
    /// Crashes tolerated before exit code 1
    #[arg(
        long, value_name = "K", default_value_t = 0,
        allow_negative_numbers = true, value_parser = whole_number::<u64>(0, u64::MAX)
    )]
    max_failures: u64,
}

#[derive(clap::Args)]
struct HilArguments {
    /// Built-in scene (`sim-host scenes` lists them) or scene file
    scene: String,
    /// Built-in vehicle or vehicle file [default: the scene's]
    #[arg(long, value_name = "NAME|F.toml")]
    vehicle: Option<String>,
    #[command(flatten)]
    board: BoardArguments,
    /// Image for QEMU (ELF) [default: built from the sources]
    #[arg(long, value_name = "FILE", conflicts_with = "serial")]
    image: Option<PathBuf>,
    /// Seed of all random streams, from 0 to 18446744073709551615 [default: the scene's]
    #[arg(long, value_name = "SEED", allow_negative_numbers = true, value_parser = whole_number::<u64>(0, u64::MAX))]
    seed: Option<u64>,
    /// Length of the flight in seconds [default: the scene's]
    #[arg(long, value_name = "S", allow_negative_numbers = true, value_parser = number)]
    duration: Option<f64>,
    /// Write a log of the flight: sensor samples, truth and motor pulses
    #[arg(long, value_name = "F.csv")]
    log: Option<PathBuf>,
    /// Write a report with plots: one HTML file that needs no network
    #[arg(long, value_name = "F.html")]
    report: Option<PathBuf>,
    /// Print the firmware's log on standard error; needs --qemu, Linux and the cargo feature firmware-log
    #[arg(long, conflicts_with = "serial")]
    firmware_log: bool,
    /// Test of the link: flip one bit in every K-th frame to the firmware
    #[arg(
        long, value_name = "K",
        allow_negative_numbers = true, value_parser = whole_number::<u32>(1, u32::MAX.into())
    )]
    flip_bit_every: Option<u32>,
    /// Test of the link: drop all frames to the firmware from T seconds after the start of the scene, for the time of
    /// --drop-for-ms
    #[arg(
        long, value_name = "T", requires = "drop_for_ms",
        allow_negative_numbers = true, value_parser = seconds_from_zero
    )]
    drop_at_s: Option<f64>,
    /// Test of the link: drop all frames to the firmware for D milliseconds of the scene, from the time of --drop-at-s
    #[arg(
        long, value_name = "D", requires = "drop_at_s",
        allow_negative_numbers = true, value_parser = whole_number::<u32>(0, u32::MAX.into())
    )]
    drop_for_ms: Option<u32>,
}

#[derive(clap::Args)]
#[group(required = true, multiple = false)]
struct BoardArguments {
    /// Run the firmware on QEMU's machine netduinoplus2
    #[arg(long)]
    qemu: bool,
    /// Fly the board at this serial port
    #[arg(long, value_name = "PORT")]
    serial: Option<PathBuf>,
}

fn seconds_from_zero(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(number) if (0.0..=1.0e6).contains(&number) => Ok(number),
        _ => Err("must be a number from 0 to 1000000 s".into()),
    }
}

#[derive(clap::Args)]
struct SenseArguments {
    /// Built-in scene (`sim-host scenes` lists them) or scene file
    scene: String,
    /// Built-in vehicle or vehicle file [default: the scene's]
    #[arg(long, value_name = "NAME|F.toml")]
    vehicle: Option<String>,
    /// Write the samples to a log; without this option the command only measures the speed of the simulation
    #[arg(long, value_name = "F.csv")]
    out: Option<PathBuf>,
    /// Seed of all random streams, from 0 to 18446744073709551615 [default: the scene's]
    #[arg(long, value_name = "SEED", allow_negative_numbers = true, value_parser = whole_number::<u64>(0, u64::MAX))]
    seed: Option<u64>,
    /// Length in seconds [default: the scene's]
    #[arg(long, value_name = "S", allow_negative_numbers = true, value_parser = number)]
    duration: Option<f64>,
    /// Samples per second; for a scene that flies: 1000 divided by a whole number. A log of an hour has 0.5 GB at 1000 Hz,
    /// and 0.1 GB at 200 Hz, which is enough for an Allan analysis
    #[arg(
        long, value_name = "R", default_value_t = sim_host::scene::DEFAULT_RATE_HZ,
        allow_negative_numbers = true, value_parser = whole_number::<u32>(1, 32_000)
    )]
    rate_hz: u32,
}

#[derive(clap::Args)]
struct PlanArguments {
    /// Built-in scene (`sim-host scenes` lists them) or scene file
    scene: String,
    /// Built-in vehicle or vehicle file [default: the scene's]
    #[arg(long, value_name = "NAME|F.toml")]
    vehicle: Option<String>,
}

#[derive(clap::Args)]
struct ConfigArguments {
    /// Built-in scene (`sim-host scenes` lists them) or scene file
    scene: String,
    /// Built-in vehicle or vehicle file [default: the scene's]
    #[arg(long, value_name = "NAME|F.toml")]
    vehicle: Option<String>,
    /// File for the stored configuration; it is written to the board's flash
    #[arg(long, value_name = "F.bin")]
    out: PathBuf,
}

#[derive(clap::Args)]
struct EstimateArguments {
    /// Log with time_s, gyro_{x,y,z}_rad_s and accel_{x,y,z}_m_s2, and optionally mag_{x,y,z}_ut and ref_q{w,x,y,z}
    log: PathBuf,
    /// Estimators to run: paper, paper-literal, flight, robust [default: all]
    #[arg(long, value_name = "NAME", num_args = 1..)]
    estimator: Vec<String>,
    /// Axes of the log. ned: north-east-down, body forward-right-down; enu: east-north-up, body z up
    #[arg(long, value_enum, default_value_t = FrameName::Ned)]
    frame: FrameName,
    /// Sign of the accelerometer. reaction: specific force a − g, +9.81 on an upward axis at rest; inverted: its negative
    #[arg(long, value_enum, default_value_t = SignName::Reaction)]
    accel_sign: SignName,
    /// Cutoff of a Butterworth prefilter on all axes, Hz [default: no prefilter]
    #[arg(long, value_name = "F", allow_negative_numbers = true, value_parser = number)]
    prefilter_hz: Option<f64>,
    /// Write the estimated attitude and its error for each row of the log
    #[arg(long, value_name = "F.csv")]
    out: Option<PathBuf>,
}

#[derive(Clone, Copy, ValueEnum)]
enum FrameName {
    Ned,
    Enu,
}

#[derive(Clone, Copy, ValueEnum)]
enum SignName {
    Reaction,
    Inverted,
}

impl From<FrameName> for log::Frame {
    fn from(name: FrameName) -> Self {
        match name {
            FrameName::Ned => Self::Ned,
            FrameName::Enu => Self::Enu,
        }
    }
}

impl From<SignName> for log::AccelSign {
    fn from(name: SignName) -> Self {
        match name {
            SignName::Reaction => Self::Reaction,
            SignName::Inverted => Self::Inverted,
        }
    }
}

/// Parses the arguments, runs the command and returns its exit code.
pub fn run() -> ExitCode {
    let arguments: Arguments = parse();
    interrupt::install_handler();
    let answer = match &arguments.command {
        Command::Fly(a) => fly::run(a),
        Command::Merge(a) => campaign::merge(a),
        Command::Hil(a) => hil::run(a),
        Command::Sense(a) => recordings::sense(a),
        Command::Estimate(a) => recordings::estimate(a),
        Command::Allan(a) => allan::run(a),
        Command::Plan(a) => listing::plan(a),
        Command::Cost(a) => return studies::run("cost", a, arguments.json),
        Command::Paper(a) => return studies::run("paper", a, arguments.json),
        Command::Config(a) => config::run(a),
        Command::Vehicle(a) => vehicle::run(a),
        Command::Scenes => listing::scenes(),
    };
    conclude(answer, arguments.json)
}

/// Loads the scene that an argument names, with the overrides of the options.
fn load(
    name: &str,
    vehicle: Option<&str>,
    seed: Option<u64>,
    duration_s: Option<f64>,
) -> Result<sim_host::scene::Scene, InputError> {
    let mut scene = sim_host::scene::Scene::load_with_vehicle(name, vehicle)?;
    if let Some(seed) = seed {
        scene.seed = seed;
    }
    if let Some(duration_s) = duration_s {
        scene.set_duration(duration_s).map_err(|error| error.field("--duration"))?;
    }
    Ok(scene)
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory as _;

    use super::*;

    /// `tests/help_examples.rs` runs the examples; this test also covers those that cannot run in a test.
    #[test]
    fn every_help_ends_with_examples_that_parse() {
        let program = Arguments::command();
        for command in std::iter::once(&program).chain(program.get_subcommands()) {
            let name = command.get_name();
            let help = command.get_after_help().map(ToString::to_string).unwrap_or_default();
            assert!(help.starts_with("Example:\n"), "{name} has no example");
            let examples: Vec<&str> = help.lines().filter_map(|line| line.strip_prefix("  ")).collect();
            assert!(examples.iter().any(|line| line.split(' ').any(|word| word == name)), "{name}: {help}");
            for example in examples {
                let parsed = Arguments::try_parse_from(example.split(' '));
                assert!(parsed.is_ok(), "{example}: {}", parsed.err().unwrap());
            }
        }
    }
}
