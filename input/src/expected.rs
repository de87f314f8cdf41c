//! The errors of the TOML parser in words: which key is wrong, which value it has, and what is allowed.
//!
//! The parser says "invalid type: string \"x\", expected f64" and does not name the key. The error here is
//! `scene.duration_s = "x": must be a number`.

use toml::de::DeValue;

use crate::InputError;
use crate::check::{nearest, unknown};

/// A value of the wrong type, and how it is written.
pub(crate) struct Found<'v> {
    pub value: &'v DeValue<'v>,
    pub text: &'v str,
}

/// Returns the error for a message of the parser. `path` is the key that the message is about, or the table if a key is
/// missing; `found` is its value.
pub(crate) fn in_words(message: &str, path: &str, found: Option<Found>) -> InputError {
    let message = message.split_whitespace().collect::<Vec<_>>().join(" ");
    let names: Vec<&str> = message.split('`').skip(1).step_by(2).collect();
    let of_table = |key: &str| format!("{path}.{key}").trim_start_matches('.').to_owned();
    match &names[..] {
        [key] if message.starts_with("missing field") => InputError::missing().field(of_table(key)),
        [_] if message.starts_with("unknown field") => {
            InputError::new("unknown key: the table has no keys").field(path)
        }
        [wrong, keys @ ..] if message.starts_with("unknown field") => {
            let near = nearest(wrong, keys.iter().copied());
            InputError::new(format!("unknown key: must be one of {}{near}", keys.join(", "))).field(path)
        }
        [wrong, words @ ..] if message.starts_with("unknown variant") => {
            unknown(path, wrong, words.iter().copied())
        }
        _ => {
            let allowed = match message.split_once(", expected ") {
                Some((_, expected)) => type_in_words(expected, found.as_ref().map(|found| found.value)),
                None => message,
            };
            let error = InputError::new(allowed);
            let error = if path.is_empty() { error } else { error.field(path) };
            match found {
                // A table in more than one line begins with its header.
                Some(Found { value: DeValue::Table(_), text }) if !text.starts_with('{') => error,
                None => error,
                Some(Found { text, .. }) => {
                    error.value(text.split_whitespace().collect::<Vec<_>>().join(" "))
                }
            }
        }
    }
}

/// Returns what is allowed where the parser expected this type and found this value.
fn type_in_words(expected: &str, found: Option<&DeValue>) -> String {
    let whole = |minimum: i64, maximum: i64| format!("a whole number from {minimum} to {maximum}");
    let words = match expected {
        "f64" | "f32" => "a number".into(),
        "u8" => whole(0, u8::MAX.into()),
        "u16" => whole(0, u16::MAX.into()),
        "u32" => whole(0, u32::MAX.into()),
        "u64" => format!("a whole number from 0 to {}", u64::MAX),
        "i16" => whole(i16::MIN.into(), i16::MAX.into()),
        "a boolean" => "true or false".into(),
        "a string" => "text in quotes".into(),
        "a sequence" => "a list".into(),
        // The parser does not say of what. A number in the wrong place stands for numbers.
        "an array of length 3" if found.is_some_and(holds_numbers) => "a list of three numbers".into(),
        "an array of length 3" => "a list of three values".into(),
        _ if expected.starts_with("struct ") || expected == "a map" => "a table".into(),
        other => other.to_owned(),
    };
    format!("must be {words}")
}

fn holds_numbers(value: &DeValue) -> bool {
    let is_number = |value: &DeValue| matches!(value, DeValue::Integer(_) | DeValue::Float(_));
    match value {
        DeValue::Array(entries) => entries.iter().any(|entry| is_number(entry.get_ref())),
        value => is_number(value),
    }
}
