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
use toml::de::{DeTable, DeValue, Deserializer};
use xxhash_rust::xxh3::xxh3_64;

use crate::InputError;
use crate::check::with_suggestion;

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
            let span = error.span().map(|span| span.start + base);
            self.error(error.message(), span)
        })?;
        Ok(shifted(table.into_inner(), base))
    }

    /// Deserializes a table.
    ///
    /// # Errors
    /// A key that is unknown or missing; a value of the wrong type.
    pub fn read<T: DeserializeOwned>(&self, table: DeTable<'a>) -> Result<T, InputError> {
        T::deserialize(Deserializer::from(Spanned::new(0..0, table)))
            .map_err(|error| self.error(error.message(), error.span().map(|span| span.start)))
    }

    /// Returns the hash of all texts. It includes each text's length, so that it changes when a line moves from one text
    /// to the next.
    pub fn hash(&self) -> u64 {
        self.texts.iter().fold(0, |hash, (_, text, _)| {
            let lengths = [hash, text.len() as u64].map(u64::to_le_bytes).concat();
            xxh3_64(&[&lengths, text.as_bytes()].concat())
        })
    }

    fn error(&self, message: &str, at: Option<usize>) -> InputError {
        let one_line = message.split_whitespace().collect::<Vec<_>>().join(" ");
        let input_error = InputError::new(with_suggestion(&one_line));
        // A span at 0 is the whole table: a key is missing. With several texts only the caller knows in which one it
        // should be.
        let Some(at) = at.filter(|at| *at > 0) else {
            return match &self.texts[..] {
                [(name, ..)] => input_error.file(name),
                _ => input_error,
            };
        };
        let Some((name, text, base)) = self.texts.iter().rev().find(|(_, _, base)| at >= *base) else {
            return input_error;
        };
        let before = &text[..(at - base).min(text.len())];
        input_error.file(name).line(1 + before.matches('\n').count() as u64)
    }
}

/// Returns the string under the top-level `key` of a text, if the key is present.
///
/// # Errors
/// The text is not TOML; the value is not a string.
pub fn text_at(name: &str, text: &str, key: &str) -> Result<Option<String>, InputError> {
    let table = Layers::default().add(name, text)?;
    string(&table, key).map_err(|error| error.file(name))
}

/// Returns the string under `key` of a table, if the key is present.
///
/// # Errors
/// The value is not a string.
pub fn string(table: &DeTable<'_>, key: &str) -> Result<Option<String>, InputError> {
    match table.get(key).map(Spanned::get_ref) {
        None => Ok(None),
        Some(DeValue::String(text)) => Ok(Some(text.to_string())),
        Some(_) => Err(InputError::new("must be a string").field(key)),
    }
}

/// Returns whether a table has a dotted key.
pub fn has(table: &DeTable<'_>, dotted: &str) -> bool {
    let (first, rest) = dotted.split_once('.').map_or((dotted, None), |(first, rest)| (first, Some(rest)));
    match (table.get(first).map(Spanned::get_ref), rest) {
        (Some(DeValue::Table(inner)), Some(rest)) => has(inner, rest),
        (found, None) => found.is_some(),
        _ => false,
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
/// same name in `under`. Tables that `over` does not have are not added.
pub fn complete<'a>(over: &mut DeTable<'a>, under: &DeTable<'a>) {
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
                if !effect.contains_key(key) {
                    effect.insert(key.clone(), value.clone());
                }
            }
        }
    }
}
