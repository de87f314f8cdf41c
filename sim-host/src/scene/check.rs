//! Checks that end in one clear line.

use serde::de::DeserializeOwned;

use crate::input_error::InputError;

/// Reads TOML; an error carries the line.
pub(super) fn from_toml<T: DeserializeOwned>(name: &str, text: &str) -> Result<T, InputError> {
    toml::from_str(text).map_err(|error| {
        let message = with_suggestion(&error.message().split_whitespace().collect::<Vec<_>>().join(" "));
        let said = InputError::new(message).file(name);
        match error.span() {
            Some(span) => said.line(1 + text[..span.start.min(text.len())].matches('\n').count() as u64),
            None => said,
        }
    })
}

/// Adds the nearest valid name to "unknown field `x`, expected one of `a`, `b`".
fn with_suggestion(message: &str) -> String {
    let quoted: Vec<&str> = message.split('`').skip(1).step_by(2).collect();
    match quoted.as_slice() {
        [wrong, valid @ ..] if message.starts_with("unknown") => {
            format!("{message}{}", nearest(wrong, valid.iter().copied()))
        }
        _ => message.into(),
    }
}

/// " (did you mean `…`?)" for a name within a few letters of a valid one; else nothing.
pub(super) fn nearest<'a>(wrong: &str, valid: impl Iterator<Item = &'a str>) -> String {
    valid
        .map(|name| (strsim::damerau_levenshtein(wrong, name), name))
        .min()
        .filter(|(distance, name)| *distance <= 1 + name.len() / 3)
        .map_or(String::new(), |(_, name)| format!(" (did you mean `{name}`?)"))
}

/// The error for a name that is none of `valid`.
pub(super) fn unknown<const N: usize>(field: &str, value: &str, valid: [&str; N]) -> InputError {
    let near = nearest(value, valid.into_iter());
    InputError::new(format!("must be one of {}{near}", valid.join(", "))).field(field).value(value)
}

/// Whether `minimum ≤ value ≤ maximum`.
pub(super) fn within(
    field: &str,
    value: f64,
    minimum: f64,
    maximum: f64,
    unit: &str,
) -> Result<(), InputError> {
    if value >= minimum && value <= maximum {
        return Ok(());
    }
    Err(InputError::new(format!("must be from {minimum} to {maximum} {unit}")).field(field).value(value))
}

/// Whether `minimum < value < maximum`.
pub(super) fn between(
    field: &str,
    value: f64,
    minimum: f64,
    maximum: f64,
    unit: &str,
) -> Result<(), InputError> {
    if value > minimum && value < maximum {
        return Ok(());
    }
    Err(InputError::new(format!("must be above {minimum} and below {maximum} {unit}"))
        .field(field)
        .value(value))
}
