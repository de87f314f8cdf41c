//! Checks of values and names. Each failure is an [`InputError`].

use crate::InputError;

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
