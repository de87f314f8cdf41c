//! The rows of the page's tables.

use toml::{Table, Value};

use crate::document::{PRESET, VEHICLE, get, parsed, table};
use crate::parser::quoted;

pub const HEADER: &str = "| key | type | unit | range | default | meaning |";

/// A key of the page.
#[derive(Clone, Debug)]
pub struct Row {
    pub key: String,
    /// Whether the heading has the table in an array.
    pub in_array: bool,
    pub type_name: String,
    pub unit: String,
    pub range: String,
    pub default: String,
    pub meaning: String,
}

/// Returns every key of the page's tables, with its whole path.
pub fn rows(page: &str) -> Vec<Row> {
    let mut rows = Vec::new();
    let (mut heading, mut inside) = ("", false);
    for line in page.lines() {
        if let Some(title) = line.strip_prefix("### ") {
            heading = title;
        }
        inside = line == HEADER || inside && line.starts_with('|');
        if !inside || line == HEADER || line.starts_with("|---") {
            continue;
        }
        let table = match heading {
            "At the top" => String::new(),
            "The preset of the sensors" => format!("{PRESET}."),
            _ => format!("{}.", heading.trim_matches(['`', '[', ']'])),
        };
        let cells: Vec<&str> = line.trim_matches('|').split(" | ").map(str::trim).collect();
        let [keys, type_name, unit, range, default, meaning] = cells[..] else {
            panic!("not six cells: {line}");
        };
        for key in quoted(keys) {
            rows.push(Row {
                key: format!("{table}{key}"),
                in_array: heading.starts_with("`[["),
                type_name: type_name.into(),
                unit: unit.into(),
                range: range.into(),
                default: default.into(),
                meaning: meaning.into(),
            });
        }
    }
    rows
}

impl Row {
    /// Returns whether an error is about this key.
    pub fn is_in(&self, (_, field): &(String, String)) -> bool {
        let in_file = format!("{PRESET}.");
        *field == self.key || self.key.strip_prefix(&in_file) == Some(field)
    }

    /// Returns the permitted words.
    pub fn words(&self) -> Vec<String> {
        quoted(&self.range)
            .iter()
            .filter_map(|word| Some(word.strip_prefix('"')?.strip_suffix('"')?.into()))
            .collect()
    }

    /// Returns the range of a number, without alternative words: both ends, and whether the ends are refused.
    pub fn ends<'a>(&'a self, clause: &'a str) -> Option<(&'a str, &'a str, bool)> {
        let clause = clause.split(", or ").next().unwrap_or_default();
        match clause.strip_prefix("above ") {
            Some(rest) => rest.split_once(", below ").map(|(low, high)| (low, high, true)),
            None => clause.split_once(" to ").map(|(low, high)| (low, high, false)),
        }
    }

    /// Returns `number` in the type of this key; in an array it is the last entry.
    pub fn value(&self, document: &Table, number: f64) -> Value {
        let number: Value = if self.type_name == "integer" { (number as i64).into() } else { number.into() };
        let mut value = match self.type_name.as_str() {
            "integer" | "number" | "number or string" => return number,
            "numbers" => Value::Array(vec![1.0.into()]),
            "3 numbers" => Value::Array(vec![1.0.into(); 3]),
            "3 × 3 numbers" => table("m = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]")["m"].clone(),
            other => panic!("{}: no numbers in a {other}", self.key),
        };
        if let Some(own) = get(document, &self.key) {
            value = own.clone();
        }
        let mut last = &mut value;
        while let Value::Array(entries) = last {
            last = entries.last_mut().expect("an entry");
        }
        *last = number;
        value
    }
}

pub fn literal(text: &str) -> Value {
    table(&format!("value = {text}"))["value"].clone()
}

pub fn number(value: &Value) -> f64 {
    value
        .as_float()
        .or_else(|| value.as_integer().map(|n| n as f64))
        .unwrap_or_else(|| panic!("{value} is no number"))
}

/// Returns the value of another key in the same table or a table above, or in the vehicle file.
pub fn beside(document: &Table, row: &Row, key: &str) -> Option<Value> {
    if let Some(key) = key.strip_prefix("vehicle.") {
        return get(document, &format!("{VEHICLE}.{key}")).cloned();
    }
    let mut path = row.key.as_str();
    while let Some((parent, _)) = path.rsplit_once('.') {
        let parent_in_file = if parent == "vehicle" { VEHICLE } else { parent };
        if let Some(value) = get(document, &format!("{parent_in_file}.{key}")) {
            return Some(value.clone());
        }
        path = parent;
    }
    None
}

/// Returns an end of a range as a number for this document.
pub fn end(document: &Table, row: &Row, text: &str) -> Option<f64> {
    let scene = || parsed(document).ok();
    match text {
        "half the nominal value" => {
            let vehicle = scene()?.vehicle;
            let figure = match row.key.split('.').nth(1)? {
                "mass_kg" => vehicle.mass_kg,
                "inertia_kg_m2" => {
                    <[f64; 3]>::from(vehicle.inertia_kg_m2).into_iter().fold(f64::MAX, f64::min)
                }
                "rotor_inertia_kg_m2" => vehicle.rotor_inertia_kg_m2,
                "arm_m" => vehicle.arm_m(),
                "thrust_coefficient_n_s2" => vehicle.thrust_coefficient,
                "torque_coefficient_n_m_s2" => vehicle.torque_coefficient,
                "motor_lag_tau_s" => {
                    get(document, "effects.vehicle.motor_lag.tau_s").map_or(vehicle.lag_s, number)
                }
                other => panic!("no nominal value is known for {other}"),
            };
            Some(0.5 * figure)
        }
        "0.7071 of the hover speed" => Some(std::f64::consts::FRAC_1_SQRT_2 * scene()?.vehicle.hover_rad_s()),
        _ if text.starts_with('`') => {
            let (key, more) = text.trim_start_matches('`').split_once('`')?;
            let more =
                more.strip_prefix(" + ").map_or(0.0, |more| more.parse().expect("a number behind the +"));
            Some(number(&beside(document, row, key)?) + more)
        }
        _ => Some(text.parse().unwrap_or_else(|_| panic!("{}: an end of a range: {text}", row.key))),
    }
}

/// Returns the range that an error names: both ends, whether the ends are refused, and the unit.
pub fn allowed(said: &str) -> Option<(f64, f64, bool, &str)> {
    let from = said.split_once("must be from ").or_else(|| said.split_once("must be a whole number from "));
    let inclusive = from.map(|(_, rest)| (rest, " to ", false));
    let (rest, between, exclusive) = inclusive
        .or_else(|| said.split_once("must be above ").map(|(_, rest)| (rest, " and below ", true)))?;
    let (low, rest) = rest.split_once(between)?;
    let (high, unit) = rest.split_once(' ').unwrap_or((rest, ""));
    // The unit may be followed by a reason, after a comma or in brackets.
    Some((
        low.parse().ok()?,
        high.parse().ok()?,
        exclusive,
        unit.split([',', '(']).next().unwrap_or_default(),
    ))
}

pub fn same(a: f64, b: f64) -> bool {
    (a - b).abs() <= 1e-9 * a.abs().max(b.abs())
}
