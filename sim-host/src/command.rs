//! Shared by the command-line programs: results as text and as JSON, exit codes, progress bars.

use std::process::ExitCode;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use input::InputError;
use serde_json::Value;

use crate::output_file;

/// Exit code of a failed flight or check.
pub const FAILED: u8 = 1;
/// Exit code of bad input or usage: the code that clap uses for usage errors.
pub const BAD_INPUT: u8 = 2;

/// Result of a command, as text and as JSON.
pub struct Answer {
    /// The result for programs: one object.
    pub json: Value,
    /// The result for people.
    pub text: String,
    /// Whether the flight or the check failed.
    pub failed: bool,
}

/// Prints an answer on standard output, or an error on standard error, and returns the exit code.
pub fn conclude(answer: Result<Answer, InputError>, json: bool) -> ExitCode {
    let printed = answer.and_then(|answer| {
        // Names and descriptions come from files: replaces control characters, which could change the terminal.
        let shown = |text: String| text.replace(|c: char| c.is_control() && c != '\n', "\u{FFFD}");
        let line = if json { answer.json.to_string() } else { shown(answer.text) };
        output_file::print(line.trim_end())?;
        Ok(answer.failed)
    });
    match printed {
        Ok(true) => ExitCode::from(FAILED),
        Ok(false) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::from(BAD_INPUT)
        }
    }
}

/// Returns a progress bar of `length` units with the label `what`, on standard error and only on a terminal.
pub fn progress_bar(length: u64, what: &str) -> ProgressBar {
    let bar = ProgressBar::with_draw_target(Some(length), ProgressDrawTarget::stderr());
    let style = ProgressStyle::with_template("{msg} {wide_bar} {percent:>3} %  {eta} left");
    bar.with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar())).with_message(what.to_owned())
}
