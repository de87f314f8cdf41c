//! TOML from several files, merged, with every value still knowing the line it came from.
//!
//! A scene may include another and override it, and an effect that it names takes from the sensor's preset
//! the figures that it doesn't give. The merge is of tables, key by key. The spans of the second and further
//! texts are shifted behind the first's, so that one number says file and line.

use std::fs::File;
use std::io::{self, Read as _};
use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;
use toml::Spanned;
use toml::de::{DeTable, DeValue, Deserializer};
use xxhash_rust::xxh3::xxh3_64;

use crate::InputError;
use crate::check::with_suggestion;

/// Reads a file that a scene names.
pub type ReadText<'a> = &'a dyn Fn(&Path) -> io::Result<String>;

/// The longest text, bytes. A device that never ends is no scene.
const LONGEST_TEXT: u64 = 1 << 20;

/// The text of a file on disk.
pub fn text_of(path: &Path) -> io::Result<String> {
    let mut text = String::new();
    if File::open(path)?.take(LONGEST_TEXT + 1).read_to_string(&mut text)? as u64 > LONGEST_TEXT {
        return Err(io::Error::other(format!("longer than {LONGEST_TEXT} bytes")));
    }
    Ok(text)
}

/// A file that can't be read, and why.
pub type Unreadable = (PathBuf, io::Error);

/// The name for errors and the text of a built-in `kind` of this name, or of a file of TOML beside `from`; nothing, if `name`
/// is neither.
///
/// # Errors
/// A file that can't be read.
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

/// The texts that a scene was put together from.
#[derive(Default)]
pub struct Layers<'a> {
    /// Name, text, and where the text's spans begin.
    texts: Vec<(String, &'a str, usize)>,
}

impl<'a> Layers<'a> {
    /// Reads one more text.
    pub fn add(&mut self, name: &str, text: &'a str) -> Result<DeTable<'a>, InputError> {
        let base = self.texts.last().map_or(0, |(_, text, base)| base + text.len() + 1);
        self.texts.push((name.into(), text, base));
        let table = DeTable::parse(text).map_err(|error| {
            let span = error.span().map(|span| span.start + base);
            self.error(error.message(), span)
        })?;
        Ok(shifted(table.into_inner(), base))
    }

    /// Turns a table into what it describes.
    pub fn read<T: DeserializeOwned>(&self, table: DeTable<'a>) -> Result<T, InputError> {
        T::deserialize(Deserializer::from(Spanned::new(0..0, table)))
            .map_err(|error| self.error(error.message(), error.span().map(|span| span.start)))
    }

    /// Hash of all texts, each with its length, so that a line which moves from one to the next is seen.
    pub fn hash(&self) -> u64 {
        self.texts.iter().fold(0, |hash, (_, text, _)| {
            let lengths = [hash, text.len() as u64].map(u64::to_le_bytes).concat();
            xxh3_64(&[&lengths, text.as_bytes()].concat())
        })
    }

    fn error(&self, message: &str, at: Option<usize>) -> InputError {
        let one_line = message.split_whitespace().collect::<Vec<_>>().join(" ");
        let said = InputError::new(with_suggestion(&one_line));
        // A span of 0 with 0 is the whole table: something is missing from it, not wrong in it. Of several texts only
        // the caller knows in which it should stand.
        let Some(at) = at.filter(|at| *at > 0) else {
            return match &self.texts[..] {
                [(name, ..)] => said.file(name),
                _ => said,
            };
        };
        let Some((name, text, base)) = self.texts.iter().rev().find(|(_, _, base)| at >= *base) else {
            return said;
        };
        let before = &text[..(at - base).min(text.len())];
        said.file(name).line(1 + before.matches('\n').count() as u64)
    }
}

/// The string at the top of a text under `key`, if there is one.
///
/// # Errors
/// No TOML; something else under `key`.
pub fn text_at(name: &str, text: &str, key: &str) -> Result<Option<String>, InputError> {
    let table = Layers::default().add(name, text)?;
    string(&table, key).map_err(|error| error.file(name))
}

/// The string in a table under `key`, if there is one.
///
/// # Errors
/// Something else is there.
pub fn string(table: &DeTable<'_>, key: &str) -> Result<Option<String>, InputError> {
    match table.get(key).map(Spanned::get_ref) {
        None => Ok(None),
        Some(DeValue::String(text)) => Ok(Some(text.to_string())),
        Some(_) => Err(InputError::new("must be a string").field(key)),
    }
}

/// Whether a table has what a dotted key names.
pub fn has(table: &DeTable<'_>, dotted: &str) -> bool {
    let (first, rest) = dotted.split_once('.').map_or((dotted, None), |(first, rest)| (first, Some(rest)));
    match (table.get(first).map(Spanned::get_ref), rest) {
        (Some(DeValue::Table(inner)), Some(rest)) => has(inner, rest),
        (found, None) => found.is_some(),
        _ => false,
    }
}

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
        // In place: whether it is an array of tables stays with it.
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

/// `over` on top of `under`: tables are merged, everything else is replaced.
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

/// Gives every table of `over` that stands two levels deep (`gyro.white_noise`) the keys it lacks from the
/// table of that name in `under`. What `over` does not name stays unnamed.
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
