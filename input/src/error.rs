//! The error type for bad input: one line that says where the error is, what was found there and what is
//! allowed.
//!
//! The format is `FILE:LINE: FIELD = VALUE: what is allowed`. Parts that don't apply are left out: a missing
//! column has no value, a command-line option has no file. The error is always one line, so that a script can
//! parse it and a terminal shows all of it: control characters are escaped and long values are cut.

use std::fmt::{self, Write as _};
use std::path::Path;

/// Longest value shown, characters; an ellipsis replaces the rest. This is enough for any number, and a binary
/// file given as a log does not fill the screen.
const MAX_VALUE_CHARS: usize = 60;

/// Longest text about what is allowed, characters: more than any list of keys. The columns of a file can be more.
const MAX_ALLOWED_CHARS: usize = 1_000;

/// What an error says about a key that must be given.
const MISSING: &str = "is missing";

/// What is wrong with the input, and where.
///
/// Each caller adds the parts that it knows:
/// ```
/// use input::InputError;
/// let error = InputError::new("must be above 0 kg").field("mass_kg").value("-0.65").line(12).file("x4.toml");
/// assert_eq!(error.to_string(), "x4.toml:12: mass_kg = -0.65: must be above 0 kg");
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct InputError {
    file: Option<String>,
    line: Option<u64>,
    field: Option<String>,
    value: Option<String>,
    allowed: String,
}

impl InputError {
    /// Returns an error that says only what is allowed, or what went wrong.
    pub fn new(allowed: impl Into<String>) -> Self {
        Self { file: None, line: None, field: None, value: None, allowed: allowed.into() }
    }

    /// Returns the error for a key that must be given.
    pub fn missing() -> Self {
        Self::new(MISSING)
    }

    /// Returns whether this is [`InputError::missing`].
    pub fn is_missing(&self) -> bool {
        self.allowed == MISSING
    }

    /// Appends to what is allowed.
    pub fn also(mut self, more: &str) -> Self {
        self.allowed.push_str(more);
        self
    }

    /// Sets the file that the error is in.
    pub fn file(mut self, path: impl AsRef<Path>) -> Self {
        self.file = Some(path.as_ref().display().to_string());
        self
    }

    /// Returns whether the file is set.
    pub fn has_file(&self) -> bool {
        self.file.is_some()
    }

    /// Returns the file, if it is set.
    pub fn file_name(&self) -> Option<&str> {
        self.file.as_deref()
    }

    /// Returns whether the value is set.
    pub(crate) fn has_value(&self) -> bool {
        self.value.is_some()
    }

    /// Returns the column, key or option, if it is set.
    pub fn field_name(&self) -> Option<&str> {
        self.field.as_deref()
    }

    /// Sets the line, counted from 1.
    pub fn line(mut self, line: u64) -> Self {
        self.line = Some(line);
        self
    }

    /// Sets the column, key or option.
    pub fn field(mut self, field: impl Into<String>) -> Self {
        self.field = Some(field.into());
        self
    }

    /// Sets the value found there, as written.
    pub fn value(mut self, value: impl fmt::Display) -> Self {
        self.value = Some(value.to_string());
        self
    }
}

impl fmt::Display for InputError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(file) = &self.file {
            on_one_line(f, file, usize::MAX)?;
            f.write_str(":")?;
        }
        if let Some(line) = self.line {
            let prefix = if self.file.is_some() { "" } else { "line " };
            write!(f, "{prefix}{line}:")?;
        }
        if self.file.is_some() || self.line.is_some() {
            f.write_str(" ")?;
        }
        if let Some(field) = &self.field {
            on_one_line(f, field, MAX_VALUE_CHARS)?;
        }
        if let Some(value) = &self.value {
            f.write_str(if self.field.is_some() { " = " } else { "" })?;
            // Quotes make an empty cell visible in the message.
            on_one_line(f, if value.is_empty() { "\"\"" } else { value }, MAX_VALUE_CHARS)?;
        }
        if self.field.is_some() || self.value.is_some() {
            f.write_str(": ")?;
        }
        on_one_line(f, &self.allowed, MAX_ALLOWED_CHARS)
    }
}

impl std::error::Error for InputError {}

/// Returns whether a character ends a line, changes the direction of the text or controls the terminal. A description of
/// one line has none, and a message shows none.
pub fn is_control(c: char) -> bool {
    c.is_control()
        || matches!(c, '\u{61c}' | '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
}

/// Writes at most `max_chars` characters of `text`, with control characters ([`is_control`]) escaped.
fn on_one_line(f: &mut fmt::Formatter<'_>, text: &str, max_chars: usize) -> fmt::Result {
    for (i, c) in text.chars().enumerate() {
        if i == max_chars {
            return f.write_char('…');
        }
        if is_control(c) {
            write!(f, "{}", c.escape_default())?;
        } else {
            f.write_char(c)?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_that_do_not_apply_are_left_out() {
        let allowed = || InputError::new("must be finite");
        for (error, line) in [
            (allowed(), "must be finite"),
            (allowed().file("a.csv"), "a.csv: must be finite"),
            (allowed().line(3), "line 3: must be finite"),
            (allowed().file("a.csv").line(3), "a.csv:3: must be finite"),
            (allowed().field("--seed"), "--seed: must be finite"),
            (allowed().field("--seed").value("x"), "--seed = x: must be finite"),
            (allowed().value("x"), "x: must be finite"),
            (allowed().file("a.csv").line(3).field("t").value(""), "a.csv:3: t = \"\": must be finite"),
        ] {
            assert_eq!(error.to_string(), line);
        }
    }

    #[test]
    fn error_is_one_short_line() {
        let error =
            InputError::new("must be\na number").file("a\nb").line(1).field("c\r").value("\u{1b}[2J\u{2028}");
        assert_eq!(error.to_string(), "a\\nb:1: c\\r = \\u{1b}[2J\\u{2028}: must be\\na number");
        let long = InputError::new("short").value("9".repeat(1000)).to_string();
        assert_eq!(long.chars().count(), MAX_VALUE_CHARS + "…: short".chars().count());
        let long = InputError::new("column, ".repeat(1000)).to_string();
        assert_eq!(long.chars().count(), MAX_ALLOWED_CHARS + 1);
        let turned = InputError::new("short").value("a\u{202e}b\u{2066}c\u{200f}").to_string();
        assert_eq!(turned, "a\\u{202e}b\\u{2066}c\\u{200f}: short");
    }
}
