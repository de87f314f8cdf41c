//! `sim-host`: simulates the vehicle, sensors and pilot that Kestrel's flight code flies with.
//!
//! Results go to standard output (with `--json` as one JSON object and nothing else), progress bars and notes to
//! standard error. Exit codes: 0 done, 1 the flight or check failed, 2 bad input or usage, 128 and its number after a
//! signal (130 after Ctrl-C).

#![deny(clippy::print_stdout, clippy::print_stderr)]

mod cli;

use std::process::ExitCode;

fn main() -> ExitCode {
    cli::run()
}
