//! `studies`: the commands `cost` and `paper` of `sim-host`, which runs this program for them.

mod cost_command;
mod paper_command;

use std::process::ExitCode;

use clap::{Parser, Subcommand};
use sim_host::command::conclude;
use sim_host::interrupt;

/// Where recordings are looked for: the directory that the tests take theirs from.
const RECORDINGS: &str = "KESTREL_DATA";

#[derive(Parser)]
#[command(name = "studies", version, about = "What accuracy costs in time, and the paper made again")]
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
    /// Show what accuracy costs in time: error against cost, over the settings of each part
    Cost(cost_command::CostArguments),
    /// Make the paper's tables and figures again, on one page with the numbers beside it
    Paper(paper_command::PaperArguments),
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    interrupt::listen();
    let answer = match &arguments.command {
        Command::Cost(a) => cost_command::run(a),
        Command::Paper(a) => paper_command::run(a),
    };
    conclude(answer, arguments.json)
}
