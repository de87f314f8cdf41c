//! What the command-line programs have in common: answers in two forms, exit codes, progress bars.

use std::process::ExitCode;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use input::InputError;
use serde_json::Value;

use crate::output_file;

/// Exit code of a flight or a check that failed.
pub const FAILED: u8 = 1;
/// Exit code of bad input or usage; clap's own for usage.
pub const BAD_INPUT: u8 = 2;

/// What a command found, in both forms.
pub struct Answer {
    /// For programs: one object.
    pub json: Value,
    /// For people.
    pub text: String,
    /// The flight or the check failed.
    pub failed: bool,
}

/// Prints an answer, or why there is none, and ends with the exit code for it.
pub fn conclude(answer: Result<Answer, InputError>, json: bool) -> ExitCode {
    let printed = answer.and_then(|answer| {
        // Names and descriptions come from files: their control characters must not reach the terminal.
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

/// A progress bar for this many of something, on standard error and only on a terminal.
pub fn progress_bar(length: u64, what: &str) -> ProgressBar {
    let bar = ProgressBar::with_draw_target(Some(length), ProgressDrawTarget::stderr());
    let style = ProgressStyle::with_template("{msg} {wide_bar} {percent:>3} %  {eta} left");
    bar.with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar())).with_message(what.to_owned())
}
