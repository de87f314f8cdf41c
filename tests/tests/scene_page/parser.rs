//! The keys that the parser has, from its error messages.

use std::collections::{BTreeMap, BTreeSet};

use toml::{Table, Value};

use crate::document::{PRESET, bare, get, parsed, table, with};

/// The kind of a key.
#[derive(Clone, Debug, PartialEq)]
pub enum Kind {
    Table(Vec<String>),
    Tables(Vec<String>),
    /// One of these words.
    Words(Vec<String>),
    /// A value of this type, as the page calls it.
    Value(String),
}

pub fn quoted(text: &str) -> Vec<String> {
    text.split('`').skip(1).step_by(2).map(str::to_owned).collect()
}

pub fn unknown() -> Value {
    table("no_such_key = 1").into()
}

/// Returns the kind of the key at a path of `document`. The parser is given a table with an unknown key there, or nested
/// arrays of such tables with these `lengths`, the outermost first.
pub fn kind(document: &Table, path: &str, lengths: &[usize]) -> Kind {
    let value = lengths.iter().rev().fold(unknown(), |inner, length| Value::Array(vec![inner; *length]));
    let exists = lengths.is_empty() && (path.is_empty() || get(document, path).is_some_and(Value::is_table));
    // An existing table keeps its keys: the parser reports those of `[scene]` only if it has a vehicle.
    let at = if exists { format!("{path}.no_such_key") } else { path.into() };
    let at = at.trim_start_matches('.');
    let said = match parsed(&with(document, at, value)) {
        Err((said, _)) => said,
        Ok(_) => panic!("`{path}` takes a key that does not exist"),
    };
    let said = said.split(" (did you mean").next().unwrap_or_default();
    let behind = |start: &str| said.split_once(start).map(|(_, rest)| rest);
    let list = |rest: &str| rest.split(", ").map(str::to_owned).collect::<Vec<_>>();
    if let Some(rest) = behind("no_such_key: unknown key: ") {
        assert!(rest.starts_with("must be one of ") || rest == "the table has no keys", "{path}: {said}");
        assert!(lengths.is_empty() || lengths == [1], "{path}: arrays of {lengths:?} tables");
        let keys = rest.strip_prefix("must be one of ").map_or(Vec::new(), list);
        return if lengths.is_empty() { Kind::Table(keys) } else { Kind::Tables(keys) };
    }
    if let Some(rest) = behind(" = no_such_key: must be one of ").filter(|_| lengths.is_empty()) {
        return Kind::Words(list(rest));
    }
    if let Some(expected) = behind(": must be ").filter(|expected| !expected.starts_with("a number of ")) {
        let longer = |length| kind(document, path, &[lengths, &[length]].concat());
        let name = match expected {
            "a list" => return longer(1),
            "a list of three values" => return longer(3),
            "a number" => "number",
            "true or false" => "boolean",
            "text in quotes" => "string",
            _ if expected.starts_with("a whole number from ") => "integer",
            other => panic!("{path}: a type that this test does not know: {other}"),
        };
        return Kind::Value(match lengths {
            [] => name.into(),
            [1] => format!("{name}s"),
            [3] => format!("3 {name}s"),
            [3, 3] => format!("3 × 3 {name}s"),
            other => panic!("{path}: arrays of {other:?} that this test does not know"),
        });
    }
    match said {
        _ if said.contains(": must be a number of ") => Kind::Value("number or string".into()),
        _ => panic!("{path}: an answer that this test does not know: {said}"),
    }
}

/// The keys of the parser: every key that is not a table, every table without keys, and the paths of arrays of tables.
#[derive(Default)]
pub struct Parser {
    pub keys: BTreeMap<String, Kind>,
    pub arrays: BTreeSet<String>,
}

impl Parser {
    pub fn walk(&mut self, document: &Table, path: &str) {
        let below = |keys: Vec<String>| {
            let dot = if path.is_empty() { "" } else { "." };
            keys.into_iter().map(move |key| format!("{path}{dot}{key}"))
        };
        match kind(document, path, &[]) {
            Kind::Table(keys) if !keys.is_empty() => below(keys).for_each(|path| self.walk(document, &path)),
            Kind::Table(_) => drop(self.keys.insert(path.into(), Kind::Value("table".into()))),
            Kind::Tables(keys) => {
                let document = with(document, path, Value::Array(vec![Table::new().into()]));
                self.arrays.insert(path.into());
                below(keys).for_each(|path| self.walk(&document, &path));
            }
            leaf => drop(self.keys.insert(path.into(), leaf)),
        }
    }

    /// Returns the keys of a scene and of a preset. Asserts that both have the same effects.
    pub fn all() -> Self {
        let mut all = Self::default();
        all.walk(&bare(), "");
        all.walk(&bare(), PRESET);
        let effects = format!("{PRESET}.effects");
        let of_preset: BTreeMap<_, _> = all
            .keys
            .iter()
            .filter_map(|(key, kind)| Some((key.strip_prefix(&effects)?, kind.clone())))
            .collect();
        let of_scene: BTreeMap<_, _> = all
            .keys
            .iter()
            .filter_map(|(key, kind)| Some((key.strip_prefix("effects")?, kind.clone())))
            .collect();
        assert_eq!(of_preset, of_scene);
        all.keys.retain(|key, _| !key.starts_with(&effects));
        assert!(all.keys.len() > 200, "only {} keys", all.keys.len());
        all
    }
}
