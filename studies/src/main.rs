//! `studies`: the program that `sim-host` runs for its commands `cost` and `paper`.

mod cost_command;
mod paper_command;

use std::process::ExitCode;

use clap::{Parser, Subcommand};
use sim_host::command::{conclude, parse};
use sim_host::interrupt;

/// The environment variable that names the directory of recordings, the same as for the tests.
const RECORDINGS: &str = "KESTREL_DATA";

/// Examples at the end of the program's help.
const EXAMPLES: &str = "\
Example:
  sim-host cost estimator --quick
  sim-host paper --out paper";

#[derive(Parser)]
#[command(
    name = "studies",
    bin_name = "sim-host",
    version,
    about = "The commands cost and paper of sim-host"
)]
#[command(arg_required_else_help = true, after_help = EXAMPLES)]
struct Arguments {
    /// Print the result as one JSON object; standard output then has nothing else
    #[arg(long, global = true)]
    json: bool,
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Compare the error and the computing time of the settings of each part
    #[command(after_help = "\
Example:
  sim-host cost estimator --quick
  sim-host cost integrator prefilter --quick --report cost.html")]
    Cost(cost_command::CostArguments),
    /// Reproduce the tables and figures of the paper, on one page with CSV files beside it
    #[command(after_help = "\
Example:
  sim-host paper --out paper")]
    Paper(paper_command::PaperArguments),
}

fn main() -> ExitCode {
    let arguments: Arguments = parse();
    interrupt::install_handler();
    let answer = match &arguments.command {
        Command::Cost(a) => cost_command::run(a),
        Command::Paper(a) => paper_command::run(a),
    };
    conclude(answer, arguments.json)
}
