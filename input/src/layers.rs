//! TOML texts from several files, merged into one table. Each value keeps its file and line for errors.
//!
//! A scene can include another scene and override it. An effect that the scene names takes the keys that it
//! lacks from the sensor's preset. Tables are merged key by key. The spans of each further text are shifted past
//! the end of the text before it, so that one offset identifies file and line.

use std::fs::File;
use std::io::{self, Read as _};
use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;
use toml::Spanned;
use toml::de::{DeTable, DeValue};
use xxhash_rust::xxh3::xxh3_64;

use crate::InputError;
use crate::expected::{Found, in_words};
use crate::values;

/// A function that reads a file which a scene names.
pub type ReadText<'a> = &'a dyn Fn(&Path) -> io::Result<String>;

/// Longest text that is read, bytes. The limit stops the reading of an endless device such as `/dev/zero`.
const MAX_TEXT_BYTES: u64 = 1 << 20;

/// Reads a file from disk.
///
/// # Errors
/// The file cannot be read, or is longer than 1 MiB.
pub fn read_text(path: &Path) -> io::Result<String> {
    let mut text = String::new();
    if File::open(path)?.take(MAX_TEXT_BYTES + 1).read_to_string(&mut text)? as u64 > MAX_TEXT_BYTES {
        return Err(io::Error::other(format!("longer than {MAX_TEXT_BYTES} bytes")));
    }
    Ok(text)
}

/// The path of a file that cannot be read, and the reason.
pub type Unreadable = (PathBuf, io::Error);

/// Finds the built-in `kind` called `name`, or reads the TOML file `name` in the directory of `from`. Returns a name for
/// errors and the text, or nothing if `name` is neither.
///
/// # Errors
/// The file cannot be read.
pub fn built_in_or_file(
    kind: &str,
    built_in: &[(&str, &str)],
    name: &str,
    from: &Path,
    read: ReadText,
) -> Result<Option<(String, String)>, Unreadable> {
    if let Some((_, text)) = built_in.iter().find(|(built_in, _)| *built_in == name) {
        return Ok(Some((format!("{kind} {name}"), (*text).into())));
    }
    if !name.ends_with(".toml") {
        return Ok(None);
    }
    let path = from.with_file_name(name);
    match read(&path) {
        Ok(text) => Ok(Some((path.display().to_string(), text))),
        Err(error) => Err((path, error)),
    }
}

/// The texts that are merged into one scene.
#[derive(Default)]
pub struct Layers<'a> {
    /// Name, text, and the offset at which the text's spans begin.
    texts: Vec<(String, &'a str, usize)>,
}

impl<'a> Layers<'a> {
    /// Parses one more text.
    ///
    /// # Errors
    /// The text is not TOML.
    pub fn add(&mut self, name: &str, text: &'a str) -> Result<DeTable<'a>, InputError> {
        let base = self.texts.last().map_or(0, |(_, text, base)| base + text.len() + 1);
        self.texts.push((name.into(), text, base));
        let table = DeTable::parse(text).map_err(|error| {
            let one_line = error.message().split_whitespace().collect::<Vec<_>>().join(" ");
            let key = error.span().and_then(|span| text.get(span)).filter(|_| one_line == "duplicate key");
            let error_here = match key {
                Some(key) => InputError::new("must be given only once").field(key),
                None => InputError::new(one_line),
            };
            self.at(error_here, error.span().map(|span| span.start + base))
        })?;
        Ok(shifted(table.into_inner(), base))
    }

    /// Deserializes a table.
    ///
    /// # Errors
    /// A key that is unknown or missing; a value of the wrong type.
    pub fn read<T: DeserializeOwned>(&self, table: &DeTable<'a>) -> Result<T, InputError> {
        values::read(table).map_err(|error| {
            // Without an offset the error is about the whole table: a key is missing.
            let (path, value) = error.at.and_then(|at| find(table, at)).unwrap_or_default();
            self.at(in_words(&error.message, &path, value.map(|value| self.written(value))), error.at)
        })
    }

    /// Adds file and line of the key that an error names. If the key is not in the table, they are those of the innermost
    /// table around it.
    ///
    /// The error may count the entries of an array of tables from 0: `fault[1].at_s`. The line says which one it is, so the
    /// count is removed ([`without_counts`]). The value of a key that is a number is shown as it is written.
    pub fn locate(&self, error: InputError, table: &DeTable<'_>) -> InputError {
        if error.has_file() {
            return error;
        }
        let field = error.field_name().unwrap_or_default().to_owned();
        let (at, value) = offset(table, &field).unzip();
        let error = if field.contains('[') { error.field(without_counts(&field)) } else { error };
        let error = match value.flatten() {
            Some(number) if error.has_value() => error.value(self.written(number).text),
            _ => error,
        };
        self.at(error, at)
    }

    /// Returns the hash of all texts. It includes each text's length, so that it changes when a line moves from one text
    /// to the next.
    pub fn hash(&self) -> u64 {
        self.texts.iter().fold(0, |hash, (_, text, _)| {
            let lengths = [hash, text.len() as u64].map(u64::to_le_bytes).concat();
            xxh3_64(&[&lengths, text.as_bytes()].concat())
        })
    }

    /// Returns the string under `key` of a table, if the key is present.
    ///
    /// # Errors
    /// The value is not a string.
    pub fn string(&self, table: &DeTable<'_>, key: &str) -> Result<Option<String>, InputError> {
        let Some(value) = table.get(key) else { return Ok(None) };
        match value.get_ref() {
            DeValue::String(text) => Ok(Some(text.to_string())),
            _ => {
                let found = Some(self.written(value));
                Err(self.at(in_words(", expected a string", key, found), Some(value.span().start)))
            }
        }
    }

    /// Adds the file and the line of an offset. Without an offset the file is known only if there is one text.
    fn at(&self, error: InputError, at: Option<usize>) -> InputError {
        let Some((at, (name, text, base))) = at.and_then(|at| Some((at, self.text_at(at)?))) else {
            return match &self.texts[..] {
                [(name, ..)] => error.file(name),
                _ => error,
            };
        };
        let before = text.bytes().take(at - base);
        error.file(name).line(1 + before.filter(|byte| *byte == b'\n').count() as u64)
    }

    /// Returns whether an offset is in a text that was added after the text of another offset.
    pub fn is_after(&self, at: usize, other: usize) -> bool {
        let base = |at| self.text_at(at).map(|(_, _, base)| *base);
        base(at) > base(other)
    }

    fn text_at(&self, at: usize) -> Option<&(String, &'a str, usize)> {
        self.texts.iter().rev().find(|(_, _, base)| at >= *base)
    }

    /// Returns a value as it is written in its text.
    fn written<'v>(&'v self, value: &'v Spanned<DeValue<'v>>) -> Found<'v> {
        let span = value.span();
        let text =
            self.text_at(span.start).and_then(|(_, text, base)| text.get(span.start - base..span.end - base));
        Found { value: value.get_ref(), text: text.unwrap_or_default() }
    }
}

/// Returns the dotted key that an offset is at or whose value it is at, and the value. If there are several, the innermost
/// counts.
fn find<'t>(table: &'t DeTable<'t>, at: usize) -> Option<(String, Option<&'t Spanned<DeValue<'t>>>)> {
    table.iter().find_map(|(key, value)| {
        let below =
            |(path, value)| (format!("{}.{path}", key.get_ref()).trim_end_matches('.').to_owned(), value);
        if let Some(found) = find_in(value, at) {
            return Some(below(found));
        }
        (key.span().start == at).then(|| (key.get_ref().to_string(), None))
    })
}

fn find_in<'t>(
    value: &'t Spanned<DeValue<'t>>,
    at: usize,
) -> Option<(String, Option<&'t Spanned<DeValue<'t>>>)> {
    let inner = match value.get_ref() {
        DeValue::Table(table) => find(table, at),
        DeValue::Array(array) => array.iter().find_map(|item| find_in(item, at)),
        _ => None,
    };
    inner.or_else(|| (value.span().start == at).then(|| (String::new(), Some(value))))
}

/// Returns the offset of a dotted key, or of the innermost table around it that exists, and the key's value if it is a
/// number.
fn offset<'t>(table: &'t DeTable<'t>, field: &str) -> Option<(usize, Option<&'t Spanned<DeValue<'t>>>)> {
    let (first, rest) = field.split_once('.').unwrap_or((field, ""));
    let (name, entry) = first.trim_end_matches(']').split_once('[').unwrap_or((first, "0"));
    let (key, value) = table.get_key_value(name)?;
    let start = key.span().start;
    let (start, inner) = match value.get_ref() {
        DeValue::Table(inner) => (start, inner),
        DeValue::Array(entries) => {
            let entry = entry.parse().ok().and_then(|n: usize| entries.get(n));
            match entry.map(|entry| (entry.span().start, entry.get_ref())) {
                Some((start, DeValue::Table(inner))) => (start, inner),
                _ => return Some((start, None)),
            }
        }
        DeValue::Integer(_) | DeValue::Float(_) if rest.is_empty() => return Some((start, Some(value))),
        _ => return Some((start, None)),
    };
    offset(inner, rest).or(Some((start, None)))
}

/// Returns the string under the top-level `key` of a text, if the key is present.
///
/// # Errors
/// The text is not TOML; the value is not a string.
pub fn text_at(name: &str, text: &str, key: &str) -> Result<Option<String>, InputError> {
    let mut layers = Layers::default();
    let table = layers.add(name, text)?;
    layers.string(&table, key)
}

/// Returns a key without the counts of entries: `fault.at_s` for `fault[1].at_s`.
pub fn without_counts(key: &str) -> String {
    key.split('[').map(|part| part.split_once(']').map_or(part, |(_, rest)| rest)).collect()
}

/// Adds file and line to an error about a key of a single text.
pub fn located(name: &str, text: &str, error: InputError) -> InputError {
    let mut layers = Layers::default();
    match layers.add(name, text) {
        Ok(table) => layers.locate(error, &table),
        Err(_) => error.file(name),
    }
}

/// Adds `by` to all spans of a table.
fn shifted(table: DeTable<'_>, by: usize) -> DeTable<'_> {
    table
        .into_iter()
        .map(|(key, value)| {
            let span = key.span().start + by..key.span().end + by;
            (Spanned::new(span, key.into_inner()), shifted_value(value, by))
        })
        .collect()
}

fn shifted_value(value: Spanned<DeValue<'_>>, by: usize) -> Spanned<DeValue<'_>> {
    let span = value.span().start + by..value.span().end + by;
    let value = match value.into_inner() {
        DeValue::Table(inner) => DeValue::Table(shifted(inner, by)),
        // In place, because the array also records whether it is an array of tables.
        DeValue::Array(mut inner) => {
            for item in inner.iter_mut() {
                let place = Spanned::new(0..0, DeValue::Boolean(false));
                *item = shifted_value(std::mem::replace(item, place), by);
            }
            DeValue::Array(inner)
        }
        other => other,
    };
    Spanned::new(span, value)
}

/// Merges `over` into `under`: tables are merged key by key, other values of `under` are replaced.
pub fn merge<'a>(over: DeTable<'a>, mut under: DeTable<'a>) -> DeTable<'a> {
    for (key, value) in over {
        let below = under.remove(&key);
        let value = match (value, below) {
            (value, Some(below)) => {
                let span = value.span();
                match (value.into_inner(), below.into_inner()) {
                    (DeValue::Table(value), DeValue::Table(below)) => {
                        Spanned::new(span, DeValue::Table(merge(value, below)))
                    }
                    (value, _) => Spanned::new(span, value),
                }
            }
            (value, None) => value,
        };
        under.insert(key, value);
    }
    under
}

/// Adds missing keys to each table of `over` that is two levels deep (`gyro.white_noise`), from the table of the
/// same name in `under`. Tables that `over` does not have are not added. A value of `over` for which `yields` is true is
/// replaced; `yields` gets its offset.
pub fn complete<'a>(over: &mut DeTable<'a>, under: &DeTable<'a>, yields: impl Fn(usize) -> bool) {
    for (key, group) in over.iter_mut() {
        let (DeValue::Table(group), Some(DeValue::Table(preset))) =
            (group.get_mut(), under.get(key).map(Spanned::get_ref))
        else {
            continue;
        };
        for (key, effect) in group.iter_mut() {
            let (DeValue::Table(effect), Some(DeValue::Table(preset))) =
                (effect.get_mut(), preset.get(key).map(Spanned::get_ref))
            else {
                continue;
            };
            for (key, value) in preset {
                if effect.get(key).is_none_or(|present| yields(present.span().start)) {
                    effect.insert(key.clone(), value.clone());
                }
            }
        }
    }
}

#[cfg(test)]
mod tests;
