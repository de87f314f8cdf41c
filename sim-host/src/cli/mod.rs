//! The command line: arguments in, a result for people or for programs out.

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

use std::num::{NonZeroU16, NonZeroU32};
use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Parser, Subcommand, ValueEnum};
use input::InputError;
use sim_host::campaign::Shard;
use sim_host::command::{Answer, conclude};
use sim_host::{interrupt, log};

#[derive(Parser)]
#[command(name = "sim-host", version, about = "The world that Kestrel's flight code flies in", long_about = None)]
#[command(arg_required_else_help = true)]
struct Arguments {
    /// Print one JSON object on standard output and nothing else there
    #[arg(long, global = true)]
    json: bool,
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Fly a scene in closed loop, judged on the truth
    Fly(FlyArguments),
    /// Put the parts of a campaign together that `fly --runs --shard` has flown
    Merge(MergeArguments),
    /// Fly a scene by the firmware, on an emulated board or a real one
    Hil(HilArguments),
    /// Sample the sensors of a scene, with truth columns
    Sense(SenseArguments),
    /// Run the flight code's estimators over a recorded log
    Estimate(EstimateArguments),
    /// Read a sensor's errors off a recording of it at rest: Allan deviations and a fit
    Allan(allan::AllanArguments),
    /// Show what a scene simulates, in order, what it leaves out, and what each effect costs
    Plan(PlanArguments),
    /// Show what accuracy costs in time: error against cost, over the settings of each part
    Cost(studies::Passed),
    /// Make the paper's tables and figures again, on one page with the numbers beside it
    Paper(studies::Passed),
    /// Write a scene's configuration of the flight controller as the record that a flight board reads at start
    Config(ConfigArguments),
    /// Show what a vehicle file means: what follows from it, its loops, what to look after; and propose gains
    Vehicle(vehicle::VehicleArguments),
    /// List the built-in scenes and their effects
    Scenes,
}

#[derive(clap::Args)]
struct FlyArguments {
    /// A built-in scene or a scene file
    #[arg(default_value = "hover")]
    scene: String,
    /// The vehicle, built-in or a file, instead of the scene's
    #[arg(long, value_name = "NAME|F.toml")]
    vehicle: Option<String>,
    /// Seed of every random stream, instead of the scene's
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    /// Length of the flight in seconds, instead of the scene's
    #[arg(long, value_name = "S", allow_negative_numbers = true)]
    duration: Option<f64>,
    /// Fly this many times, with seeds counting up
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    runs: u64,
    /// Flights at a time; one for each core without this. The results do not depend on it
    #[arg(long, value_name = "J", requires = "runs")]
    jobs: Option<NonZeroU16>,
    /// Fly part I of N of the runs: `merge` puts the parts together
    #[arg(long, value_name = "I/N", requires_all = ["runs", "out"])]
    shard: Option<Shard>,
    /// Write the results of the runs, a row each
    #[arg(long, value_name = "F.csv", requires = "runs")]
    out: Option<PathBuf>,
    /// Crashes that are let pass; exit code 1 for more of them
    #[arg(long, value_name = "K", requires = "runs", default_value_t = 0)]
    max_failures: u64,
    /// Write the sensor log, truth and pulses of the flight
    #[arg(long, value_name = "F.csv", conflicts_with = "runs")]
    log: Option<PathBuf>,
    /// Write a report with plots, readable in any browser without a network
    #[arg(long, value_name = "F.html", conflicts_with = "runs")]
    report: Option<PathBuf>,
}

#[derive(clap::Args)]
struct MergeArguments {
    /// The files that `fly --shard` has written, all of them, in any order
    #[arg(required = true, value_name = "PART.csv")]
    parts: Vec<PathBuf>,
    /// Write the results of all runs: the bytes that `fly --out` writes without `--shard`
    #[arg(long, value_name = "F.csv")]
    out: Option<PathBuf>,
    /// Crashes that are let pass; exit code 1 for more of them
    #[arg(long, value_name = "K", default_value_t = 0)]
    max_failures: u64,
}

#[derive(clap::Args)]
struct HilArguments {
    /// A built-in scene or a scene file
    scene: String,
    /// The vehicle, built-in or a file, instead of the scene's
    #[arg(long, value_name = "NAME|F.toml")]
    vehicle: Option<String>,
    #[command(flatten)]
    board: BoardArguments,
    /// The image for QEMU; without it, it is built from the sources
    #[arg(long, value_name = "FILE", conflicts_with = "serial")]
    image: Option<PathBuf>,
    /// Seed of every random stream, instead of the scene's
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    /// Length of the flight in seconds, instead of the scene's
    #[arg(long, value_name = "S", allow_negative_numbers = true)]
    duration: Option<f64>,
    /// Write the sensor log, truth and pulses of the flight
    #[arg(long, value_name = "F.csv")]
    log: Option<PathBuf>,
    /// Write a report with plots, readable in any browser without a network
    #[arg(long, value_name = "F.html")]
    report: Option<PathBuf>,
    /// Print the firmware's log on standard error, with the time in the flight. Needs a build with the cargo feature
    /// firmware-log
    #[arg(long, conflicts_with = "serial")]
    firmware_log: bool,
    /// Test the link: flip one bit in every N-th frame to the board
    #[arg(long, value_name = "N")]
    flip_bit_every: Option<NonZeroU32>,
    /// Test the link: from this time on, seconds, frames to the board are held back, and never come
    #[arg(long, value_name = "T", requires = "delay_ms", value_parser = not_negative)]
    delay_at_s: Option<f64>,
    /// For so many milliseconds of the scene
    #[arg(long, value_name = "D", requires = "delay_at_s")]
    delay_ms: Option<u32>,
}

#[derive(clap::Args)]
#[group(required = true, multiple = false)]
struct BoardArguments {
    /// The board is QEMU's netduinoplus2
    #[arg(long)]
    qemu: bool,
    /// The board is at a serial port
    #[arg(long, value_name = "PORT")]
    serial: Option<PathBuf>,
}

fn not_negative(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(number) if (0.0..=1.0e6).contains(&number) => Ok(number),
        _ => Err("must be a number from 0 to 1000000".into()),
    }
}

#[derive(clap::Args)]
struct SenseArguments {
    /// A built-in scene or a scene file
    scene: String,
    /// The vehicle, built-in or a file, instead of the scene's
    #[arg(long, value_name = "NAME|F.toml")]
    vehicle: Option<String>,
    /// Where to write the log; without it the samples are only generated
    #[arg(long, value_name = "F.csv")]
    out: Option<PathBuf>,
    /// Seed of every random stream, instead of the scene's
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    /// Length in seconds, instead of the scene's
    #[arg(long, value_name = "S", allow_negative_numbers = true)]
    duration: Option<f64>,
    /// Samples per second
    #[arg(long, value_name = "R", default_value_t = sim_host::scene::DEFAULT_RATE_HZ)]
    rate_hz: u32,
}

#[derive(clap::Args)]
struct PlanArguments {
    /// A built-in scene or a scene file
    scene: String,
    /// The vehicle, built-in or a file, instead of the scene's
    #[arg(long, value_name = "NAME|F.toml")]
    vehicle: Option<String>,
}

#[derive(clap::Args)]
struct ConfigArguments {
    /// A built-in scene or a scene file
    scene: String,
    /// The vehicle, built-in or a file, instead of the scene's
    #[arg(long, value_name = "NAME|F.toml")]
    vehicle: Option<String>,
    /// The record
    #[arg(long, value_name = "F.bin")]
    out: PathBuf,
}

#[derive(clap::Args)]
struct EstimateArguments {
    /// The log
    log: PathBuf,
    /// Which estimators to run (paper, paper-literal, flight); all without this
    #[arg(long, value_name = "NAME", num_args = 1..)]
    estimator: Vec<String>,
    /// Axes of the log: north-east-down and forward-right-down, or east-north-up with a z-up body
    #[arg(long, value_enum, default_value_t = FrameName::Ned)]
    frame: FrameName,
    /// Sign of the accelerometer: specific force a − g, or its negative
    #[arg(long, value_enum, default_value_t = SignName::Reaction)]
    accel_sign: SignName,
    /// Cutoff of a Butterworth prefilter on all axes; none without this
    #[arg(long, value_name = "F")]
    prefilter_hz: Option<f64>,
    /// Write the estimated attitudes and their errors, row by row
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

/// Runs the program.
pub fn run() -> ExitCode {
    let arguments = Arguments::parse();
    interrupt::listen();
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

/// The scene of an argument, with its overrides.
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
