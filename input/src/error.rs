//! The one error that bad input ends in: a single line that says where it is, what was found there and what
//! is allowed.
//!
//! `FILE:LINE: FIELD = VALUE: what is allowed`. Parts that don't apply are left out: a missing column has
//! no value, a command-line option no file. It stays one line whatever the input holds, so that a script
//! can read it and a person sees it whole: control characters are escaped, and long values cut.

use std::fmt::{self, Write as _};
use std::path::Path;

/// Longest value shown, in characters; the rest becomes an ellipsis. Enough for any number, and a log
/// that turns out to be a picture does not fill the screen.
const LONGEST_VALUE: usize = 60;

/// What is wrong with the input, and where.
///
/// Built up from what the place of the error knows:
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
    /// An error that so far says only what is allowed, or what went wrong.
    pub fn new(allowed: impl Into<String>) -> Self {
        Self { file: None, line: None, field: None, value: None, allowed: allowed.into() }
    }

    /// The file it is in.
    pub fn file(mut self, path: impl AsRef<Path>) -> Self {
        self.file = Some(path.as_ref().display().to_string());
        self
    }

    /// Whether it says which file it is in.
    pub fn has_file(&self) -> bool {
        self.file.is_some()
    }

    /// The column, key or option, if it says one.
    pub fn field_name(&self) -> Option<&str> {
        self.field.as_deref()
    }

    /// The line, counted from 1.
    pub fn line(mut self, line: u64) -> Self {
        self.line = Some(line);
        self
    }

    /// The column, key or option.
    pub fn field(mut self, field: impl Into<String>) -> Self {
        self.field = Some(field.into());
        self
    }

    /// The value found there, as written.
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
            let what = if self.file.is_some() { "" } else { "line " };
            write!(f, "{what}{line}:")?;
        }
        if self.file.is_some() || self.line.is_some() {
            f.write_str(" ")?;
        }
        if let Some(field) = &self.field {
            on_one_line(f, field, LONGEST_VALUE)?;
        }
        if let Some(value) = &self.value {
            f.write_str(if self.field.is_some() { " = " } else { "" })?;
            // An empty cell would otherwise read as if the message had lost a word.
            on_one_line(f, if value.is_empty() { "\"\"" } else { value }, LONGEST_VALUE)?;
        }
        if self.field.is_some() || self.value.is_some() {
            f.write_str(": ")?;
        }
        on_one_line(f, &self.allowed, usize::MAX)
    }
}

impl std::error::Error for InputError {}

/// Writes `text` with control characters and line separators escaped, and at most `longest` characters.
fn on_one_line(f: &mut fmt::Formatter<'_>, text: &str, longest: usize) -> fmt::Result {
    for (i, c) in text.chars().enumerate() {
        if i == longest {
            return f.write_char('…');
        }
        if c.is_control() || matches!(c, '\u{2028}' | '\u{2029}') {
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
    fn stays_one_short_line() {
        let error =
            InputError::new("must be\na number").file("a\nb").line(1).field("c\r").value("\u{1b}[2J\u{2028}");
        assert_eq!(error.to_string(), "a\\nb:1: c\\r = \\u{1b}[2J\\u{2028}: must be\\na number");
        let long = InputError::new("short").value("9".repeat(1000)).to_string();
        assert_eq!(long.chars().count(), LONGEST_VALUE + "…: short".chars().count());
    }
}
