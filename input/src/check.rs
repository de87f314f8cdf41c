//! Checks of values and names. Each failure is an [`InputError`].

use std::fmt;

use serde::de::{Deserializer, Error, Unexpected, Visitor};

use crate::{InputError, is_control};

/// Returns " (did you mean `…`?)" with the nearest valid name, or nothing if none is near. A name is near if its edit
/// distance is at most 1 plus a third of its length.
pub fn nearest<'a>(wrong: &str, valid: impl Iterator<Item = &'a str>) -> String {
    valid
        .map(|name| (strsim::damerau_levenshtein(wrong, name), name))
        .min()
        .filter(|(distance, name)| *distance <= 1 + name.len() / 3)
        .map_or(String::new(), |(_, name)| format!(" (did you mean `{name}`?)"))
}

/// Returns the error for a name that is not among `valid`.
pub fn unknown<'a>(field: &str, value: &str, valid: impl IntoIterator<Item = &'a str>) -> InputError {
    let valid: Vec<&str> = valid.into_iter().collect();
    let near = nearest(value, valid.iter().copied());
    InputError::new(format!("must be one of {}{near}", valid.join(", "))).field(field).value(value)
}

/// Checks that `minimum ≤ value ≤ maximum`. `unit` is empty for a number without a unit.
pub fn in_range(field: &str, value: f64, minimum: f64, maximum: f64, unit: &str) -> Result<(), InputError> {
    if value >= minimum && value <= maximum {
        return Ok(());
    }
    Err(InputError::new(format!("must be from {minimum} to {maximum} {unit}").trim_end())
        .field(field)
        .value(value))
}

/// Does [`in_range`] for a key of an effect's table.
pub fn key_in_range(
    table: &str,
    key: &str,
    value: f64,
    minimum: f64,
    maximum: f64,
    unit: &str,
) -> Result<(), InputError> {
    in_range(&format!("{table}.{key}"), value, minimum, maximum, unit)
}

/// Does [`key_in_range`] for each entry of an array.
pub fn keys_in_range(
    table: &str,
    key: &str,
    values: impl IntoIterator<Item = f64>,
    minimum: f64,
    maximum: f64,
    unit: &str,
) -> Result<(), InputError> {
    values.into_iter().try_for_each(|value| key_in_range(table, key, value, minimum, maximum, unit))
}

/// Checks that `minimum < value < maximum`.
pub fn in_open_range(
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

/// Checks that a description is one line, without characters that control the terminal or the direction of the text.
pub fn one_line(field: &str, text: &str) -> Result<(), InputError> {
    if !text.contains(is_control) {
        return Ok(());
    }
    Err(InputError::new("must be one line without control characters").field(field).value(text))
}

/// Deserializes a whole number from `MIN` to `MAX`, for `#[serde(deserialize_with = "whole_number::<_, _, 1, 4>")]`. The
/// error states this range, and not that of the integer's type.
///
/// # Errors
/// The value is not a whole number, or not in the range.
pub fn whole_number<'de, T, D, const MIN: i64, const MAX: i64>(deserializer: D) -> Result<T, D::Error>
where
    T: TryFrom<i64>,
    D: Deserializer<'de>,
{
    struct Whole<const MIN: i64, const MAX: i64>;

    impl<const MIN: i64, const MAX: i64> Visitor<'_> for Whole<MIN, MAX> {
        type Value = i64;

        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            write!(f, "a whole number from {MIN} to {MAX}")
        }

        fn visit_i64<E: Error>(self, number: i64) -> Result<i64, E> {
            let wrong = || E::invalid_value(Unexpected::Signed(number), &self);
            (MIN..=MAX).contains(&number).then_some(number).ok_or_else(wrong)
        }

        fn visit_u64<E: Error>(self, number: u64) -> Result<i64, E> {
            self.visit_i64(number.try_into().unwrap_or(i64::MAX))
        }
    }

    let whole = Whole::<MIN, MAX>;
    let number = deserializer.deserialize_i64(whole)?;
    T::try_from(number).map_err(|_| D::Error::invalid_value(Unexpected::Signed(number), &Whole::<MIN, MAX>))
}
