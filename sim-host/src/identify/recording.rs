//! Reads columns of any CSV file, not only of the project's logs.
//!
//! Columns are separated by commas, semicolons or tabs, with or without a header row. In a file with semicolons a comma
//! is a decimal comma. The layout is found from the first lines. If they are ambiguous, the result is an error that
//! names the option to set, not a guess.
//!
//! Missing data are not interpolated. A cell that is not a number, an irregular time stamp, or a constant column
//! is an error with file, line and column. A column with values in every k-th row only, such as a magnetometer's
//! next to a faster gyroscope, has a lower rate. A missing value in that pattern is a gap, which is an error.
//!
//! # Memory
//! A column is stored as doubles and converted to its running sums in place: 0.8 GB for 10⁸ rows. The file is read
//! several times if the columns need more than `MEMORY` together.

use std::fmt;
use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use crate::log::Records;
use input::InputError;

/// Memory for samples, bytes.
const MEMORY: u64 = 1 << 30;
/// Length of the start of the file from which the layout is found, bytes.
const PROBE_BYTES: u64 = 1 << 16;
/// Largest magnitude of a value: the square of a sum of 10⁹ of them is still finite.
const MAX_VALUE: f64 = 1e100;
/// Rows between two reports of progress.
const ROWS_PER_PROGRESS: u64 = 1 << 16;
/// Largest deviation of a time step from the mean, as a share of the mean. The rounding of the stamps is allowed in any
/// case.
const JITTER: f64 = 0.1;
/// Number of samples in which the converter's step is searched.
const STEP_SAMPLES: usize = 4096;

/// A source that can be read several times.
pub trait Source: fmt::Debug {
    /// Returns a reader at the start of the source.
    fn open(&self) -> io::Result<Box<dyn Read + '_>>;
}

impl Source for PathBuf {
    fn open(&self) -> io::Result<Box<dyn Read + '_>> {
        Ok(Box::new(File::open(self)?))
    }
}

impl Source for Vec<u8> {
    fn open(&self) -> io::Result<Box<dyn Read + '_>> {
        Ok(Box::new(self.as_slice()))
    }
}

/// A file with a known layout.
#[derive(Debug)]
pub struct Recording {
    path: PathBuf,
    source: Box<dyn Source>,
    separator: u8,
    /// Names of the columns, or numbers from 1 if there is no header.
    names: Vec<String>,
    has_header: bool,
    bytes: u64,
    bytes_per_row: f64,
}

/// The layout that the caller gives; `None` to find it in the file.
#[derive(Clone, Copy, Debug, Default)]
pub struct Layout {
    /// Separator of the columns.
    pub separator: Option<u8>,
    /// True if the first row is a header.
    pub header: Option<bool>,
}

/// A column that was read.
#[derive(Clone, Debug)]
pub struct Column {
    /// Name or number of the column.
    pub name: String,
    /// Values.
    pub samples: Vec<f64>,
    /// Rows per value: 1, or more for a slow sensor next to a fast one.
    pub rows_per_value: u64,
    /// Mean of the values.
    pub mean: f64,
    /// Step of the converter, if all differences are integer multiples of one step.
    pub step: Option<f64>,
}

/// The data read from a file.
#[derive(Clone, Debug, Default)]
pub struct Contents {
    /// The columns, in the requested order.
    pub columns: Vec<Column>,
    /// The time stamps, if requested.
    pub stamps: Option<Stamps>,
    /// Lowest and highest temperature, in the unit of its column, if requested and present.
    pub temperature: Option<(f64, f64)>,
}

/// The time stamps of the rows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stamps {
    /// Mean interval between rows, s.
    pub interval_s: f64,
}

fn parse(cell: &[u8], decimal_comma: bool) -> Option<f64> {
    let text = std::str::from_utf8(cell).ok()?.trim();
    if decimal_comma && text.contains(',') {
        if text.contains('.') {
            return None;
        }
        return text.replacen(',', ".", 1).parse().ok();
    }
    text.parse().ok()
}

fn separator_name(separator: u8) -> &'static str {
    match separator {
        b',' => "comma",
        b';' => "semicolon",
        _ => "tab",
    }
}

impl Recording {
    /// Opens the file at `path` and finds its layout.
    ///
    /// # Errors
    /// The file cannot be read, has no rows, or has an ambiguous layout.
    pub fn open(path: impl AsRef<Path>, layout: Layout) -> Result<Self, InputError> {
        let path = path.as_ref();
        let found = std::fs::metadata(path)
            .map_err(|error| InputError::new(format!("cannot be read: {error}")).file(path))?;
        if !found.is_file() {
            return Err(
                InputError::new("must be a regular file: it may have to be read more than once").file(path)
            );
        }
        Self::of(path.to_path_buf(), found.len(), path, layout)
    }

    /// Finds the layout of a source of `bytes` bytes. Error messages name it `path`.
    ///
    /// # Errors
    /// As for [`Self::open`].
    pub fn of(
        source: impl Source + 'static,
        bytes: u64,
        path: impl AsRef<Path>,
        layout: Layout,
    ) -> Result<Self, InputError> {
        let path = path.as_ref().to_path_buf();
        let cannot_read = |error: io::Error| InputError::new(format!("cannot be read: {error}")).file(&path);
        let mut probe = Vec::new();
        let start = source.open().map_err(cannot_read)?;
        start.take(PROBE_BYTES).read_to_end(&mut probe).map_err(cannot_read)?;
        if (probe.len() as u64) < bytes {
            // The last line is incomplete, and would look like a row with a different layout.
            let whole = probe.iter().rposition(|&b| b == b'\n').map_or(probe.len(), |at| at + 1);
            probe.truncate(whole);
        }
        let separator = match layout.separator {
            Some(separator) => separator,
            None => find_separator(&probe).map_err(|error| error.file(&path))?,
        };
        let rows = rows(&probe, separator).map_err(|error| error.file(&path))?;
        let Some((first, others)) = rows.split_first() else {
            return Err(InputError::new("the file is empty: it must have rows of numbers").file(&path));
        };
        let has_header = match layout.header {
            Some(header) => header,
            None => has_header(first, others, separator).map_err(|error| error.file(&path))?,
        };
        let names = if has_header {
            first.clone()
        } else {
            (1..=first.len()).map(|number| number.to_string()).collect()
        };
        let bytes_per_row = probe.len() as f64 / rows.len() as f64;
        let source = Box::new(source);
        Ok(Self { path, source, separator, names, has_header, bytes, bytes_per_row })
    }

    /// Returns the names of the columns, or numbers from 1 if there is no header.
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// Returns true if the file has a header.
    pub fn has_header(&self) -> bool {
        self.has_header
    }

    /// Returns the size of the file, bytes.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Returns an error about this file.
    pub fn error(&self, what: impl Into<String>) -> InputError {
        InputError::new(what).file(&self.path)
    }

    /// Returns the index of a column, found by its name or its number from 1.
    ///
    /// # Errors
    /// There is no such column, or the name is ambiguous.
    pub fn find(&self, column: &str) -> Result<usize, InputError> {
        let error = |what: String| Err(self.error(what).field("--column").value(column));
        let named: Vec<usize> = (0..self.names.len()).filter(|&i| self.names[i] == column).collect();
        let numbered =
            column.parse::<usize>().ok().filter(|n| (1..=self.names.len()).contains(n)).map(|n| n - 1);
        match (named.as_slice(), numbered) {
            ([_, _, ..], _) => error(format!("{} columns have this name: give its number", named.len())),
            (&[named], Some(number)) if named != number => error(format!(
                "column {} has this name, and column {column} this number: rename one",
                named + 1
            )),
            (&[found], _) | (&[], Some(found)) => Ok(found),
            (&[], None) if self.has_header => error(format!(
                "must be the name of a column or its number from 1 to {}; there are {}",
                self.names.len(),
                self.names.join(", ")
            )),
            (&[], None) => error(format!(
                "the file has no header row: must be the number of a column, from 1 to {}",
                self.names.len()
            )),
        }
    }

    /// Returns the number of columns that fit into memory at the same time.
    pub fn columns_at_once(&self) -> usize {
        let rows = (self.bytes as f64 / self.bytes_per_row).max(1.0) as u64;
        (MEMORY / (8 * rows)).max(1) as usize
    }

    /// Reads the columns at these indices, each with the name to use for it; the time stamps in the column `time`; and
    /// the range of the column `temperature`. `progress` gets the number of bytes read.
    ///
    /// # Errors
    /// A column is not a series of evenly sampled, finite numbers.
    pub fn read(
        &self,
        columns: &[(usize, String)],
        time: Option<usize>,
        temperature: Option<usize>,
        progress: &dyn Fn(u64),
    ) -> Result<Contents, InputError> {
        let cannot_read = |error: &dyn std::fmt::Display| self.error(format!("cannot be read: {error}"));
        let source = self.source.open().map_err(|error| cannot_read(&error))?;
        let mut records = Records::separated_by(self.separator, Some(b'#'), source);
        let estimate = (self.bytes as f64 / self.bytes_per_row * 1.02) as usize + 16;
        let mut builders: Vec<ColumnBuilder> =
            columns.iter().map(|(at, name)| ColumnBuilder::new(*at, name, estimate)).collect();
        let mut stamps = time.map(StampChecker::new);
        let mut range: Option<(f64, f64)> = None;
        let mut rows = 0_u64;
        if self.has_header {
            records.advance().map_err(|error| cannot_read(&error))?;
        }
        while records.advance().map_err(|error| cannot_read(&error))? {
            let at_line = |error: InputError| error.line(records.line()).file(&self.path);
            let cells = &records.current;
            if cells.len() != self.names.len() {
                let allowed = if self.has_header { "as in the header" } else { "as in the first row" };
                let error = InputError::new(format!("must be {}, {allowed}", self.names.len()));
                return Err(at_line(error.field("number of cells").value(cells.len())));
            }
            for builder in &mut builders {
                builder.add(&cells[builder.at], rows, self.separator == b';').map_err(at_line)?;
            }
            if let Some(stamps) = &mut stamps {
                let name = &self.names[stamps.at];
                stamps
                    .add(&cells[stamps.at], rows, records.line(), self.separator == b';')
                    .map_err(|error| at_line(error.field(name)))?;
            }
            // The temperature is only a comment in the results, so a cell that is not a number is skipped.
            if let Some(value) = temperature.and_then(|at| parse(&cells[at], self.separator == b';')) {
                let (low, high) = range.unwrap_or((value, value));
                range = Some((low.min(value), high.max(value)));
            }
            rows += 1;
            if rows.is_multiple_of(ROWS_PER_PROGRESS) {
                progress((rows as f64 * self.bytes_per_row) as u64);
            }
        }
        let columns: Result<Vec<Column>, InputError> =
            builders.into_iter().map(|b| b.finish(rows).map_err(|e| e.file(&self.path))).collect();
        let stamps = stamps.map(|stamps| {
            let name = &self.names[stamps.at];
            stamps.finish(rows).map_err(|error| error.field(name).file(&self.path))
        });
        Ok(Contents { columns: columns?, stamps: stamps.transpose()?, temperature: range })
    }
}

/// A column while it is read.
struct ColumnBuilder {
    at: usize,
    name: String,
    samples: Vec<f64>,
    /// Row of the last value.
    last: Option<u64>,
    /// Rows between values, known after the second value.
    rows_per_value: Option<u64>,
    first_row: u64,
    low: f64,
    high: f64,
}

impl ColumnBuilder {
    fn new(at: usize, name: &str, rows: usize) -> Self {
        Self {
            at,
            name: name.into(),
            samples: Vec::with_capacity(rows),
            last: None,
            rows_per_value: None,
            first_row: 0,
            low: f64::INFINITY,
            high: f64::NEG_INFINITY,
        }
    }

    #[inline]
    fn add(&mut self, cell: &[u8], row: u64, decimal_comma: bool) -> Result<(), InputError> {
        if cell.is_empty() {
            let due = self.last.zip(self.rows_per_value).is_some_and(|(last, every)| row >= last + every);
            return if due { Err(self.gap(cell)) } else { Ok(()) };
        }
        let value = match parse(cell, decimal_comma) {
            Some(value) if value.abs() <= MAX_VALUE => value,
            Some(value) if value.is_nan() => return Err(self.gap(cell)),
            _ => {
                let allowed = format!("must be a number from -{MAX_VALUE:e} to {MAX_VALUE:e}");
                return Err(InputError::new(allowed).field(&self.name).value(String::from_utf8_lossy(cell)));
            }
        };
        match (self.last, self.rows_per_value) {
            (None, _) => self.first_row = row,
            (Some(last), None) => self.rows_per_value = Some(row - last),
            (Some(last), Some(every)) if row - last != every => return Err(self.gap(cell)),
            _ => {}
        }
        self.last = Some(row);
        self.low = self.low.min(value);
        self.high = self.high.max(value);
        self.samples.push(value);
        Ok(())
    }

    fn gap(&self, cell: &[u8]) -> InputError {
        let every = self.rows_per_value.unwrap_or(1);
        let rhythm = if every == 1 { "every row".into() } else { format!("every {every}th row") };
        InputError::new(format!(
            "gap: the column must have a number in {rhythm}; cut the recording there and analyse the longer part"
        ))
        .field(&self.name)
        .value(String::from_utf8_lossy(cell))
    }

    fn finish(self, rows: u64) -> Result<Column, InputError> {
        let every = self.rows_per_value.unwrap_or(1);
        let count = self.samples.len();
        if count < 3 {
            return Err(InputError::new("must have at least 3 values").field(&self.name).value(count));
        }
        if self.first_row >= every || self.last.is_some_and(|last| last + every < rows) {
            return Err(InputError::new(format!(
                "gap: the column has values only in rows {} to {} of {rows}",
                self.first_row + 1,
                self.last.unwrap_or(0) + 1
            ))
            .field(&self.name));
        }
        if self.low == self.high {
            return Err(InputError::new(
                "the column is constant: there is no noise to analyse (a stuck sensor?)",
            )
            .field(&self.name)
            .value(self.low));
        }
        let origin = self.samples[0];
        let mean = origin + self.samples.iter().map(|y| y - origin).sum::<f64>() / count as f64;
        let step = converter_step(&self.samples);
        Ok(Column { name: self.name, samples: self.samples, rows_per_value: every, mean, step })
    }
}

/// Returns the step of which all differences of neighbours are integer multiples, if there is one. It is the smallest
/// difference, as far as the rounding of printed numbers allows.
fn converter_step(samples: &[f64]) -> Option<f64> {
    let some = &samples[..samples.len().min(STEP_SAMPLES)];
    let differences = || some.windows(2).map(|w| (w[1] - w[0]).abs());
    let largest = some.iter().fold(0.0, |largest: f64, y| largest.max(y.abs()));
    let negligible = largest * 1e-12;
    let minimum = differences().filter(|&d| d > negligible).fold(f64::INFINITY, f64::min);
    // The differences are rounded, so the mean of those near one step is more accurate than each of them.
    let ones = || differences().filter(|&d| d > negligible && d < 1.5 * minimum);
    let step = ones().sum::<f64>() / ones().count() as f64;
    let is_multiple = |d: f64| {
        let steps = d / step;
        (steps - libm::round(steps)).abs() < 0.05 && steps < 1e6
    };
    // If one in 64 differences is at most a single step, it comes from a converter and not from chance.
    let few = differences().filter(|&d| d < 1.5 * step).count() * 64 > some.len();
    (step.is_finite() && few && differences().all(is_multiple)).then_some(step)
}

/// Checks the time stamps while they are read.
struct StampChecker {
    at: usize,
    first: f64,
    last: f64,
    /// Shortest step, s, and the line in which it ends.
    shortest: (f64, u64),
    /// Longest step, s, and the line in which it ends.
    longest: (f64, u64),
    /// Maximum number of digits after the point.
    digits: u32,
}

impl StampChecker {
    fn new(at: usize) -> Self {
        Self { at, first: 0.0, last: 0.0, shortest: (f64::INFINITY, 0), longest: (0.0, 0), digits: 0 }
    }

    fn add(&mut self, cell: &[u8], row: u64, line: u64, decimal_comma: bool) -> Result<(), InputError> {
        let time_s = parse(cell, decimal_comma).filter(|t| t.abs() <= 1e12).ok_or_else(|| {
            InputError::new("must be a number from -1e12 to 1e12 s").value(String::from_utf8_lossy(cell))
        })?;
        let point = cell.iter().position(|&b| b == b'.' || (decimal_comma && b == b','));
        let digits = point.map_or(0, |at| cell[at + 1..].iter().take_while(|b| b.is_ascii_digit()).count());
        self.digits = self.digits.max(if cell.contains(&b'e') { 15 } else { digits as u32 });
        if row == 0 {
            self.first = time_s;
        } else {
            let step = time_s - self.last;
            if step <= 0.0 {
                let before = self.last;
                return Err(
                    InputError::new(format!("must increase: the previous row has {before}")).value(time_s)
                );
            }
            if step < self.shortest.0 {
                self.shortest = (step, line);
            }
            if step > self.longest.0 {
                self.longest = (step, line);
            }
        }
        self.last = time_s;
        Ok(())
    }

    fn finish(self, rows: u64) -> Result<Stamps, InputError> {
        let interval_s = (self.last - self.first) / (rows.max(2) - 1) as f64;
        let rounding = libm::pow(10.0, -f64::from(self.digits));
        let tolerance = (JITTER * interval_s).max(1.01 * rounding);
        for (step, line) in [self.longest, self.shortest] {
            if (step - interval_s).abs() > tolerance {
                return Err(InputError::new(format!(
                    "uneven time stamps: the steps must be within {tolerance:.3e} s of their mean, {interval_s:.6e} s; \
                     set --rate-hz to treat the rows as even"
                ))
                .line(line)
                .value(format_args!("{step:.6e} s after the previous row")));
            }
        }
        Ok(Stamps { interval_s })
    }
}

/// Returns the rows of a text, as cells of text.
fn rows(text: &[u8], separator: u8) -> Result<Vec<Vec<String>>, InputError> {
    let mut records = Records::separated_by(separator, Some(b'#'), text);
    let mut rows = Vec::new();
    while records.advance().map_err(|error| InputError::new(format!("cannot be read: {error}")))? {
        let cell = |cell: &[u8]| String::from_utf8_lossy(cell).trim_start_matches('\u{feff}').to_owned();
        rows.push(records.current.iter().map(cell).collect());
    }
    Ok(rows)
}

/// Finds the separator of the columns: the one with which all lines have the same number of cells, more than one, and no
/// cell contains another separator.
fn find_separator(text: &[u8]) -> Result<u8, InputError> {
    let mut candidates = Vec::new();
    for separator in *b",;\t" {
        let rows = rows(text, separator)?;
        let width = rows.first().map_or(0, Vec::len);
        let decimal = |cell: &str| separator == b';' && parse(cell.as_bytes(), true).is_some();
        let left = |cell: &String| cell.contains([',', ';', '\t']) && !decimal(cell);
        if width > 1 && rows.iter().all(|row| row.len() == width && !row.iter().any(left)) {
            candidates.push(separator);
        }
    }
    match candidates.as_slice() {
        [one] => Ok(*one),
        [] => {
            // The file has one column, or its lines differ. In the second case the reader reports the line.
            let used = b",;\t".iter().copied().filter(|s| text.contains(s)).collect::<Vec<_>>();
            match used.as_slice() {
                [] => Ok(b','),
                [one] => Ok(*one),
                _ => Err(InputError::new(
                    "the separator of the columns is ambiguous: set --separator to comma, semicolon or tab",
                )),
            }
        }
        several => {
            let names: Vec<&str> = several.iter().map(|&s| separator_name(s)).collect();
            Err(InputError::new(format!(
                "the separator of the columns may be {}: set --separator",
                names.join(" or ")
            )))
        }
    }
}

/// Returns true if the first row is a header: text above numbers.
fn has_header(first: &[String], others: &[Vec<String>], separator: u8) -> Result<bool, InputError> {
    let is_number = |cell: &String| parse(cell.as_bytes(), separator == b';').is_some();
    let mut text_above_numbers = false;
    let mut number_above_numbers = false;
    for (column, cell) in first.iter().enumerate() {
        let numbers = others.iter().filter_map(|row| row.get(column)).any(is_number);
        match (is_number(cell), numbers) {
            (false, true) => text_above_numbers = true,
            (true, true) => number_above_numbers = true,
            _ => {}
        }
    }
    match (text_above_numbers, number_above_numbers) {
        (true, true) if first.iter().all(|cell| !cell.is_empty()) => {
            Err(InputError::new("the first row is partly text and partly numbers: set --header to yes or no")
                .line(1))
        }
        (true, false) => Ok(true),
        (false, false) => Ok(!first.iter().any(is_number)),
        _ => Ok(false),
    }
}
