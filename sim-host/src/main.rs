//! `sim-host`: the world that Kestrel's flight code flies in.
//!
//! Results go to standard output (with `--json` as one object, and nothing else), progress and notes to
//! standard error. Exit codes: 0 done, 1 the flight or check failed, 2 bad input or usage.

mod cli;

use std::process::ExitCode;

fn main() -> ExitCode {
    cli::run()
}
