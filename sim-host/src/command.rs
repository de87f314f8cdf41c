//! Shared by the command-line programs: arguments, results as text and as JSON, exit codes, progress bars.

use std::error::Error as _;
use std::process::ExitCode;

use clap::Parser;
use clap::error::{ContextKind, ContextValue, ErrorKind};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use input::{InputError, check, is_control};
use serde_json::Value;

use crate::{interrupt, output_file};

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

/// Parses the arguments of the program. If they are wrong, prints one line with the option, the value and what is
/// permitted, and ends the program. Without any argument it prints the help.
pub fn parse<T: Parser>() -> T {
    T::try_parse().unwrap_or_else(|error| match error.kind() {
        ErrorKind::DisplayHelp
        | ErrorKind::DisplayVersion
        | ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand => error.exit(),
        _ => {
            output_file::print_note(&format!("error: {}", usage_error(&error)));
            std::process::exit(BAD_INPUT.into())
        }
    })
}

/// Returns an error of the arguments in the form of all errors.
fn usage_error(error: &clap::Error) -> InputError {
    in_words(error).unwrap_or_else(|| {
        // The message, without the usage and the hint at the help that follow it.
        let message = error.to_string();
        let message = message.split("\n\nUsage:").next().unwrap_or(&message);
        let message = message.split("\n\nFor more").next().unwrap_or(message);
        let one_line = message.split_whitespace().collect::<Vec<_>>().join(" ");
        InputError::new(one_line.trim_start_matches("error: "))
    })
}

/// Returns the error for an argument whose error has parts, or nothing for any other error.
fn in_words(error: &clap::Error) -> Option<InputError> {
    // The name of an option is followed by that of its value: `--seed <N>`.
    let text = |kind| match error.get(kind)? {
        ContextValue::String(text) => Some(text.clone()),
        ContextValue::Strings(texts) => Some(texts.join(", ")),
        _ => None,
    };
    let option = |kind| {
        let text = text(kind)?;
        Some(text.split(' ').next().filter(|name| name.starts_with('-')).map_or(text.clone(), String::from))
    };
    let near = |name: Option<String>| name.map_or(String::new(), |name| format!(" (did you mean `{name}`?)"));
    let name = option(ContextKind::InvalidArg);
    let value = text(ContextKind::InvalidValue).filter(|value| !value.is_empty());
    match (error.kind(), error.get(ContextKind::ValidValue)) {
        (ErrorKind::ValueValidation, _) => {
            Some(InputError::new(error.source()?.to_string()).field(name?).value(value?))
        }
        (ErrorKind::InvalidValue, Some(ContextValue::Strings(valid))) if value.is_some() => {
            Some(check::unknown(&name?, &value?, valid.iter().map(String::as_str)))
        }
        (ErrorKind::InvalidValue, _) => Some(InputError::new("must have a value").field(name?)),
        (ErrorKind::UnknownArgument, _) => {
            let near = near(text(ContextKind::SuggestedArg));
            Some(InputError::new(format!("unknown argument{near}")).field(name?))
        }
        (ErrorKind::InvalidSubcommand, _) => {
            let near = near(text(ContextKind::SuggestedSubcommand));
            let allowed = format!("unknown command{near}; --help lists the commands");
            Some(InputError::new(allowed).field("COMMAND").value(text(ContextKind::InvalidSubcommand)?))
        }
        (ErrorKind::MissingRequiredArgument, _) => {
            Some(InputError::missing().field(text(ContextKind::InvalidArg)?))
        }
        (ErrorKind::ArgumentConflict, _) => {
            let other = option(ContextKind::PriorArg)?;
            let allowed = if Some(&other) == name.as_ref() {
                "must be given only once".into()
            } else {
                format!("cannot be used with {other}")
            };
            Some(InputError::new(allowed).field(name?))
        }
        _ => None,
    }
}

/// Returns a parser of arguments that accepts the whole numbers in a range.
pub fn whole_number<T: TryFrom<u64>>(
    minimum: u64,
    maximum: u64,
) -> impl Fn(&str) -> Result<T, String> + Clone + Send + Sync + 'static {
    move |text| {
        let number = text.parse().ok().filter(|number| (minimum..=maximum).contains(number));
        number
            .and_then(|number| T::try_from(number).ok())
            .ok_or_else(|| format!("must be a whole number from {minimum} to {maximum}"))
    }
}

/// Parses an argument that is a number; its range is checked later.
///
/// # Errors
/// The text is not a number.
pub fn number(text: &str) -> Result<f64, String> {
    text.parse().map_err(|_| "must be a number".into())
}

/// Returns a name, and its description if there is one.
pub fn heading(name: &str, description: &str) -> String {
    if description.is_empty() { name.into() } else { format!("{name}: {description}") }
}

/// Prints an answer on standard output, or an error on standard error, and returns the exit code.
pub fn conclude(answer: Result<Answer, InputError>, json: bool) -> ExitCode {
    let printed = answer.and_then(|answer| {
        // Names and descriptions come from files. Replace their control characters, which could change the terminal.
        let shown = |text: String| text.replace(|c: char| is_control(c) && c != '\n', "\u{FFFD}");
        let line = if json { answer.json.to_string() } else { shown(answer.text) };
        output_file::print(line.trim_end())?;
        Ok(answer.failed)
    });
    match printed {
        // The command failed because it was interrupted.
        Ok(true) if interrupt::requested() => ExitCode::from(interrupt::code()),
        Ok(true) => ExitCode::from(FAILED),
        Ok(false) => ExitCode::SUCCESS,
        Err(error) => {
            output_file::print_note(&format!("error: {error}"));
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
