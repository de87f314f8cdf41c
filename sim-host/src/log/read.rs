//! Reads a log and checks every cell.

use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use csv::ByteRecord;

use super::{Axes, COLUMNS, LogRow};
use crate::input_file::{self, RowLimit};
use input::InputError;

/// Largest time, s: beyond 2⁵³ µs a double no longer resolves microseconds.
const MAX_TIME_S: f64 = 9.0e9;

/// Largest magnitude of a reading, in its own unit. It is far beyond any sensor, and its square is still far below the
/// largest f32, in which the flight code computes.
const MAX_READING: f64 = 1e6;

/// Largest deviation of the norm of a reference from 1. Rounded and interpolated attitudes have smaller deviations.
const NORM_TOLERANCE: f64 = 0.1;

/// A whole log in memory.
#[derive(Clone, Debug, PartialEq)]
pub struct Log {
    /// The samples in order of time; at least one.
    pub rows: Vec<LogRow>,
}

impl Log {
    /// Reads the file at `path` with the axes `axes`.
    pub fn read(path: impl AsRef<Path>, axes: Axes) -> Result<Self, InputError> {
        Self::collect(LogReader::open(path, axes)?)
    }

    fn collect<R: Read>(reader: LogReader<R>) -> Result<Self, InputError> {
        let path = reader.path.clone();
        let rows = reader.collect::<Result<Vec<_>, _>>()?;
        if rows.is_empty() {
            return Err(InputError::new("a log must have at least one row below its header").file(path));
        }
        Ok(Self { rows })
    }

    /// Returns the mean interval between samples, s; `None` if there is only one sample.
    pub fn mean_interval_s(&self) -> Option<f64> {
        match self.rows.as_slice() {
            [first, .., last] => Some((last.time_s - first.time_s) / (self.rows.len() - 1) as f64),
            _ => None,
        }
    }
}

/// A reader of a log, row by row. It ends after an error.
#[derive(Debug)]
pub struct LogReader<R> {
    records: Records<R>,
    path: PathBuf,
    axes: Axes,
    columns: Columns,
    /// Number of cells in the header.
    width: usize,
    /// Time of the previous row, µs.
    last_us: Option<i64>,
    ended: bool,
}

/// Index of each column in the file; `None` for a group that is missing.
#[derive(Debug)]
struct Columns {
    time: usize,
    gyro: [usize; 3],
    accel: [usize; 3],
    mag: Option<[usize; 3]>,
    reference: Option<[usize; 4]>,
    moving: Option<usize>,
}

impl LogReader<File> {
    /// Opens the file at `path` with the axes `axes`, and reads its header.
    pub fn open(path: impl AsRef<Path>, axes: Axes) -> Result<Self, InputError> {
        let path = path.as_ref();
        Self::new(input_file::open(path)?, path, axes)
    }
}

impl<R: Read> LogReader<R> {
    /// Creates a reader of `source`, which error messages name `path`, and reads the header.
    pub fn new(source: R, path: impl AsRef<Path>, axes: Axes) -> Result<Self, InputError> {
        let path = path.as_ref().to_path_buf();
        let mut records = Records::new(source);
        if !records.advance().map_err(|error| unreadable(&path, &error))? {
            return Err(InputError::new("the file is empty: a log must begin with a header row").file(path));
        }
        let columns =
            Columns::find(&records.current).map_err(|error| error.line(records.line()).file(&path))?;
        let width = records.current.len();
        Ok(Self { records, path, axes, columns, width, last_us: None, ended: false })
    }

    /// Converts the current record to a row in the project's axes. The caller adds file and line to errors.
    fn row(&mut self) -> Result<LogRow, InputError> {
        let cells = &self.records.current;
        if cells.len() != self.width {
            return Err(InputError::new(format!("must be {}, as in the header", self.width))
                .field("number of cells")
                .value(cells.len()));
        }
        let columns = &self.columns;
        let row = LogRow {
            time_s: number(cells, "time_s", columns.time, MAX_TIME_S)?,
            gyro_rad_s: numbers(cells, GYRO, columns.gyro, MAX_READING)?,
            accel_m_s2: numbers(cells, ACCEL, columns.accel, MAX_READING)?,
            mag_ut: optional(cells, MAG, columns.mag, MAX_READING)?,
            reference: optional(cells, REFERENCE, columns.reference, 1.0 + NORM_TOLERANCE)?
                .map(rotation)
                .transpose()?,
            moving: columns.moving.map_or(Ok(true), |column| flag(cells, "moving", column))?,
        };
        let now_us = row.time_us();
        if let Some(last_us) = self.last_us
            && now_us <= last_us
        {
            let before = last_us as f64 / 1e6;
            return Err(InputError::new(format!(
                "must be at least 1 µs after the previous row ({before} s)"
            ))
            .field("time_s")
            .value(text(&cells[columns.time])));
        }
        self.last_us = Some(now_us);
        Ok(self.axes.convert(row))
    }
}

impl<R: Read> Iterator for LogReader<R> {
    type Item = Result<LogRow, InputError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.ended {
            return None;
        }
        let row = match self.records.advance() {
            Ok(false) => None,
            Ok(true) => Some(self.row().map_err(|error| error.line(self.records.line()).file(&self.path))),
            Err(error) => Some(Err(unreadable(&self.path, &error))),
        };
        self.ended = !matches!(row, Some(Ok(_)));
        row
    }
}

/// The non-blank records of a file.
#[derive(Debug)]
pub(crate) struct Records<R> {
    csv: csv::Reader<RowLimit<io::Chain<R, &'static [u8]>>>,
    pub(crate) current: ByteRecord,
}

impl<R: Read> Records<R> {
    fn new(source: R) -> Self {
        Self::separated_by(b',', None, source)
    }

    /// Creates a reader of records with this separator of cells. Lines that begin with `comment` are skipped.
    pub(crate) fn separated_by(separator: u8, comment: Option<u8>, source: R) -> Self {
        let csv = csv::ReaderBuilder::new()
            .delimiter(separator)
            .comment(comment)
            .buffer_capacity(1 << 16)
            // This module reports rows of the wrong length and a missing header with its own error messages.
            .flexible(true)
            .has_headers(false)
            // A newline ends every record, including the last one, so that `line` can count back from it. Carriage
            // returns are trimmed as white space.
            .terminator(csv::Terminator::Any(b'\n'))
            .trim(csv::Trim::All)
            .from_reader(RowLimit::new(source.chain(b"\n".as_slice())));
        Self { csv, current: ByteRecord::new() }
    }

    /// Advances to the next non-blank record. Returns false at the end of the file.
    pub(crate) fn advance(&mut self) -> Result<bool, csv::Error> {
        loop {
            self.csv.get_mut().next_row();
            if !self.csv.read_byte_record(&mut self.current)? {
                return Ok(false);
            }
            if self.current.len() > 1 || !self.current[0].is_empty() {
                return Ok(true);
            }
        }
    }

    /// Returns the line in which the current record begins, counted from 1. (The record's own position is that of the
    /// blank lines before it.)
    pub(crate) fn line(&self) -> u64 {
        let inside = self.current.as_slice().iter().filter(|&&byte| byte == b'\n').count() as u64;
        self.csv.position().line().saturating_sub(1 + inside)
    }
}

const GYRO: [&str; 3] = [COLUMNS[1], COLUMNS[2], COLUMNS[3]];
const ACCEL: [&str; 3] = [COLUMNS[4], COLUMNS[5], COLUMNS[6]];
const MAG: [&str; 3] = [COLUMNS[7], COLUMNS[8], COLUMNS[9]];
const REFERENCE: [&str; 4] = [COLUMNS[10], COLUMNS[11], COLUMNS[12], COLUMNS[13]];

impl Columns {
    fn find(header: &ByteRecord) -> Result<Self, InputError> {
        for name in COLUMNS {
            if header.iter().filter(|cell| *cell == name.as_bytes()).count() > 1 {
                return Err(InputError::new("the column must be in the header only once").field(name));
            }
        }
        let position = |name: &str| header.iter().position(|cell| cell == name.as_bytes());
        let required = |name: &str| {
            position(name).ok_or_else(|| {
                InputError::new(
                    "the column is missing: a log must have time_s, gyro_{x,y,z}_rad_s and accel_{x,y,z}_m_s2",
                )
                .field(name)
            })
        };
        Ok(Self {
            time: required("time_s")?,
            gyro: all_of(GYRO, required)?,
            accel: all_of(ACCEL, required)?,
            mag: all_or_none(MAG, position)?,
            reference: all_or_none(REFERENCE, position)?,
            moving: position("moving"),
        })
    }
}

fn all_of<const N: usize>(
    names: [&str; N],
    required: impl Fn(&str) -> Result<usize, InputError>,
) -> Result<[usize; N], InputError> {
    let mut columns = [0; N];
    for (column, name) in columns.iter_mut().zip(names) {
        *column = required(name)?;
    }
    Ok(columns)
}

fn all_or_none<const N: usize>(
    names: [&str; N],
    position: impl Fn(&str) -> Option<usize>,
) -> Result<Option<[usize; N]>, InputError> {
    if names.iter().all(|name| position(name).is_none()) {
        return Ok(None);
    }
    all_of(names, |name| {
        position(name).ok_or_else(|| {
            InputError::new(format!("the column is missing: must be all of {}, or none", names.join(", ")))
                .field(name)
        })
    })
    .map(Some)
}

/// Parses a cell as a finite number of magnitude at most `largest`.
fn number(cells: &ByteRecord, name: &str, column: usize, largest: f64) -> Result<f64, InputError> {
    let cell = &cells[column];
    std::str::from_utf8(cell)
        .ok()
        .and_then(|cell| cell.parse::<f64>().ok())
        // NaN also fails this comparison.
        .filter(|x| x.abs() <= largest)
        .ok_or_else(|| {
            InputError::new(format!("must be a number from -{largest} to {largest}"))
                .field(name)
                .value(text(cell))
        })
}

fn numbers<const N: usize>(
    cells: &ByteRecord,
    names: [&str; N],
    columns: [usize; N],
    largest: f64,
) -> Result<[f64; N], InputError> {
    let mut values = [0.0; N];
    for ((value, name), column) in values.iter_mut().zip(names).zip(columns) {
        *value = number(cells, name, column, largest)?;
    }
    Ok(values)
}

/// Reads optional columns as [`numbers`] does. Returns `None` if the columns are missing or all cells are empty.
fn optional<const N: usize>(
    cells: &ByteRecord,
    names: [&str; N],
    columns: Option<[usize; N]>,
    largest: f64,
) -> Result<Option<[f64; N]>, InputError> {
    let Some(columns) = columns else {
        return Ok(None);
    };
    let empty = columns.map(|column| cells[column].is_empty());
    if empty.iter().all(|&empty| empty) {
        return Ok(None);
    }
    if let Some(i) = empty.iter().position(|&empty| empty) {
        let allowed = format!("must be a number, or all of {} empty", names.join(", "));
        return Err(InputError::new(allowed).field(names[i]).value(""));
    }
    numbers(cells, names, columns, largest).map(Some)
}

/// Parses a cell that is 0 or 1.
fn flag(cells: &ByteRecord, name: &str, column: usize) -> Result<bool, InputError> {
    match &cells[column] {
        b"0" => Ok(false),
        b"1" => Ok(true),
        cell => Err(InputError::new("must be 0 or 1").field(name).value(text(cell))),
    }
}

/// Normalises `q` to a unit quaternion.
fn rotation(q: [f64; 4]) -> Result<[f64; 4], InputError> {
    let norm = libm::sqrt(q.iter().map(|c| c * c).sum());
    if (norm - 1.0).abs() > NORM_TOLERANCE {
        let (minimum, maximum) = (1.0 - NORM_TOLERANCE, 1.0 + NORM_TOLERANCE);
        return Err(InputError::new(format!("must have a norm from {minimum} to {maximum}"))
            .field("ref_qw, ref_qx, ref_qy, ref_qz")
            .value(format_args!("{}, {}, {}, {}", q[0], q[1], q[2], q[3])));
    }
    Ok(q.map(|c| c / norm))
}

fn text(cell: &[u8]) -> String {
    String::from_utf8_lossy(cell).into_owned()
}

fn unreadable(path: &Path, error: &csv::Error) -> InputError {
    InputError::new(format!("cannot be read: {error}")).file(path)
}

#[cfg(test)]
mod tests {
    use super::super::{AccelSign, Frame};
    use super::*;

    const HEADER: &str = "time_s,gyro_x_rad_s,gyro_y_rad_s,gyro_z_rad_s,accel_x_m_s2,accel_y_m_s2,accel_z_m_s2,\
                          mag_x_ut,mag_y_ut,mag_z_ut,ref_qw,ref_qx,ref_qy,ref_qz,moving";

    fn read(text: &str) -> Result<Log, InputError> {
        LogReader::new(text.as_bytes(), "log.csv", Axes::default()).and_then(Log::collect)
    }

    fn with_rows(rows: &[&str]) -> String {
        format!("{HEADER}\n{}\n", rows.join("\n"))
    }

    #[test]
    fn empty_cells_are_unknown() {
        let log =
            read(&with_rows(&["0,1,2,3,4,5,6,7,8,9,1,0,0,0,0", "0.0035,1,2,3,4,5,6,,,,,,,,1"])).unwrap();
        assert_eq!(
            log.rows,
            [
                LogRow {
                    time_s: 0.0,
                    gyro_rad_s: [1.0, 2.0, 3.0],
                    accel_m_s2: [4.0, 5.0, 6.0],
                    mag_ut: Some([7.0, 8.0, 9.0]),
                    reference: Some([1.0, 0.0, 0.0, 0.0]),
                    moving: false,
                },
                LogRow {
                    time_s: 0.0035,
                    gyro_rad_s: [1.0, 2.0, 3.0],
                    accel_m_s2: [4.0, 5.0, 6.0],
                    mag_ut: None,
                    reference: None,
                    moving: true,
                },
            ]
        );
        assert_eq!(log.mean_interval_s(), Some(0.0035));
    }

    #[test]
    fn columns_may_be_reordered_added_and_left_out() {
        let log = read(
            "\u{feff}note, accel_z_m_s2,accel_y_m_s2,accel_x_m_s2,gyro_z_rad_s,gyro_y_rad_s,gyro_x_rad_s,time_s\r\n\
             \"a, b\",6,5,4,3,2,1,-1e-3\r\n",
        )
        .unwrap();
        let row = log.rows[0];
        assert_eq!((row.time_s, row.gyro_rad_s, row.accel_m_s2), (-1e-3, [1.0, 2.0, 3.0], [4.0, 5.0, 6.0]));
        assert_eq!((row.mag_ut, row.reference, row.moving), (None, None, true));
        assert_eq!(log.mean_interval_s(), None);
    }

    #[test]
    fn rounded_reference_is_normalised() {
        let log = read(&with_rows(&["0,1,2,3,4,5,6,7,8,9,0.7071,0,0,-0.7071,0"])).unwrap();
        let [w, _, _, z] = log.rows[0].reference.unwrap();
        assert!((w * w + z * z - 1.0).abs() < 1e-15 && w == -z);
    }

    #[test]
    fn rows_are_converted_to_the_project_axes() {
        let text = with_rows(&["0,1,2,3,4,5,9.81,7,8,9,1,0,0,0,0"]);
        let axes = Axes { frame: Frame::Enu, accel_sign: AccelSign::Reaction };
        let row = LogReader::new(text.as_bytes(), "log.csv", axes).unwrap().next().unwrap().unwrap();
        assert_eq!((row.gyro_rad_s, row.accel_m_s2), ([1.0, -2.0, -3.0], [4.0, -5.0, -9.81]));
        assert_eq!(row.mag_ut, Some([7.0, -8.0, -9.0]));
        assert_eq!(row.reference.map(|q| q[0] == q[3] && q[1] == 0.0), Some(true));
    }

    #[test]
    fn every_bad_log_gives_one_line_with_its_position() {
        let good = "0,1,2,3,4,5,6,7,8,9,1,0,0,0,0";
        let without = |name: &str| HEADER.replace(&format!("{name},"), "");
        let number = "must be a number from -1000000 to 1000000";
        for (text, error) in [
            (String::new(), "log.csv: the file is empty: a log must begin with a header row".into()),
            ("\n\n".into(), "log.csv: the file is empty: a log must begin with a header row".into()),
            (format!("{HEADER}\n"), "log.csv: a log must have at least one row below its header".into()),
            (
                without("accel_z_m_s2"),
                "log.csv:1: accel_z_m_s2: the column is missing: a log must have time_s, gyro_{x,y,z}_rad_s and \
                 accel_{x,y,z}_m_s2"
                    .into(),
            ),
            (
                without("mag_y_ut"),
                "log.csv:1: mag_y_ut: the column is missing: must be all of mag_x_ut, mag_y_ut, mag_z_ut, or none"
                    .into(),
            ),
            (
                without("ref_qw"),
                "log.csv:1: ref_qw: the column is missing: must be all of ref_qw, ref_qx, ref_qy, ref_qz, or none"
                    .into(),
            ),
            (
                format!("{HEADER},time_s"),
                "log.csv:1: time_s: the column must be in the header only once".into(),
            ),
            (
                with_rows(&["0,NaN,2,3,4,5,6,7,8,9,1,0,0,0,0"]),
                format!("log.csv:2: gyro_x_rad_s = NaN: {number}"),
            ),
            (
                with_rows(&[good, "1,1,2,3,4,5,-inf,7,8,9,1,0,0,0,0"]),
                format!("log.csv:3: accel_z_m_s2 = -inf: {number}"),
            ),
            (
                with_rows(&["0,1,2,3,4,5,6,7,8,1e300,1,0,0,0,0"]),
                format!("log.csv:2: mag_z_ut = 1e300: {number}"),
            ),
            (with_rows(&["0,1,2,3,4;5,5,6,7,8,9,1,0,0,0,0"]), format!("log.csv:2: accel_x_m_s2 = 4;5: {number}")),
            (with_rows(&["0,1,,3,4,5,6,7,8,9,1,0,0,0,0"]), format!("log.csv:2: gyro_y_rad_s = \"\": {number}")),
            (
                with_rows(&["0,1,2,3,4,5,6,7,,9,1,0,0,0,0"]),
                "log.csv:2: mag_y_ut = \"\": must be a number, or all of mag_x_ut, mag_y_ut, mag_z_ut empty".into(),
            ),
            (
                with_rows(&["1e10,1,2,3,4,5,6,7,8,9,1,0,0,0,0"]),
                "log.csv:2: time_s = 1e10: must be a number from -9000000000 to 9000000000".into(),
            ),
            (
                with_rows(&["2.5,1,2,3,4,5,6,7,8,9,1,0,0,0,0", "2.4,1,2,3,4,5,6,7,8,9,1,0,0,0,0"]),
                "log.csv:3: time_s = 2.4: must be at least 1 µs after the previous row (2.5 s)".into(),
            ),
            (
                with_rows(&[good, good]),
                "log.csv:3: time_s = 0: must be at least 1 µs after the previous row (0 s)".into(),
            ),
            (
                with_rows(&["0,1,2,3,4,5,6,7,8,9,0,0,0,0,0"]),
                "log.csv:2: ref_qw, ref_qx, ref_qy, ref_qz = 0, 0, 0, 0: must have a norm from 0.9 to 1.1".into(),
            ),
            (
                with_rows(&["0,1,2,3,4,5,6,7,8,9,1,0,0,0,yes"]),
                "log.csv:2: moving = yes: must be 0 or 1".into(),
            ),
            (
                with_rows(&["0,1,2,3,4,5,6"]),
                "log.csv:2: number of cells = 7: must be 15, as in the header".into(),
            ),
        ] {
            assert_eq!(read(&text).unwrap_err().to_string(), error);
        }
    }

    #[test]
    fn line_numbers_match_those_of_an_editor() {
        for text in [
            format!("{HEADER}\n\n\n0,1,2,3,4,5,6,7,8,9,1,0,0,0,x\n"),
            format!("{HEADER}\r\n\r\n\r\n0,1,2,3,4,5,6,7,8,9,1,0,0,0,x\r\n"),
            format!("\n\n{HEADER}\n0,1,2,3,4,5,6,7,8,9,1,0,0,0,x"),
            format!(
                "note,{HEADER}\n\"a\nb\",0,1,2,3,4,5,6,7,8,9,1,0,0,0,0\n\"c\nd\",1,1,2,3,4,5,6,7,8,9,1,0,0,0,x\n"
            ),
        ] {
            assert_eq!(
                read(&text).unwrap_err().to_string(),
                "log.csv:4: moving = x: must be 0 or 1",
                "{text:?}"
            );
        }
        let missing = read("\n\ntime_s\n").unwrap_err().to_string();
        assert!(missing.starts_with("log.csv:3: gyro_x_rad_s: "), "{missing}");
    }

    #[test]
    fn invalid_utf_8_is_an_error() {
        let mut bytes = with_rows(&["0,1,2,3,4,5,6,7,8,9,1,0,0,0,#"]).into_bytes();
        let place = bytes.iter().position(|&b| b == b'#').unwrap();
        bytes[place] = 0xff;
        let mut reader = LogReader::new(bytes.as_slice(), "log.csv", Axes::default()).unwrap();
        let error = reader.next().unwrap().unwrap_err().to_string();
        assert_eq!(error, "log.csv:2: moving = \u{fffd}: must be 0 or 1");
        assert!(reader.next().is_none(), "nothing follows an error");
    }

    #[test]
    fn unreadable_file_is_named() {
        let directory = tempfile::tempdir().unwrap();
        let error_of = |path: &Path| Log::read(path, Axes::default()).unwrap_err().to_string();
        let missing = directory.path().join("none.csv");
        assert!(error_of(&missing).starts_with(&format!("{}: cannot be read: ", missing.display())));
        let folder = directory.path().display();
        assert_eq!(error_of(directory.path()), format!("{folder}: must be a regular file or a pipe"));
    }

    #[test]
    fn endless_row_is_an_error() {
        let row = io::repeat(b'7');
        let error = LogReader::new(row, "log.csv", Axes::default()).unwrap_err().to_string();
        assert_eq!(error, "log.csv: cannot be read: a row is longer than 1048576 bytes");
        let quoted = io::repeat(b'\n');
        let log = format!("{HEADER}\n\"").into_bytes();
        let mut log = LogReader::new(log.as_slice().chain(quoted), "log.csv", Axes::default()).unwrap();
        let error = log.next().unwrap().unwrap_err().to_string();
        assert_eq!(error, "log.csv: cannot be read: a row is longer than 1048576 bytes");
    }
}
