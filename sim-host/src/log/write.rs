//! Writes a log.

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;

use super::{COLUMNS, LogRow};
use crate::output_file::OutputFile;
use input::InputError;

/// A writer of a log in the project's axes. The file appears when [`finish`](Self::finish) is called.
///
/// A number is written with the fewest digits that read back as the same f64, in the same way on every machine. So
/// equal flights give equal files.
#[derive(Debug)]
pub struct LogWriter {
    file: OutputFile,
    line: String,
}

impl LogWriter {
    /// Starts the log file `path`.
    pub fn create(path: impl AsRef<Path>) -> Result<Self, InputError> {
        Self::create_with(path, &[])
    }

    /// Starts a log file with further columns after the standard ones. [`LogReader`](super::LogReader) ignores them.
    pub fn create_with(path: impl AsRef<Path>, further: &[&str]) -> Result<Self, InputError> {
        let file = OutputFile::create(path)?;
        let mut writer = Self { file, line: COLUMNS.join(",") };
        for name in further {
            writer.line.push(',');
            writer.line.push_str(name);
        }
        writer.end_line()?;
        Ok(writer)
    }

    /// Writes one row. `None` becomes empty cells.
    pub fn write(&mut self, row: &LogRow) -> Result<(), InputError> {
        self.write_with(row, &[])
    }

    /// Writes one row with the values of the further columns.
    pub fn write_with(&mut self, row: &LogRow, further: &[f64]) -> Result<(), InputError> {
        self.cell(row.time_s);
        row.gyro_rad_s.into_iter().for_each(|x| self.cell(x));
        row.accel_m_s2.into_iter().for_each(|x| self.cell(x));
        self.cells(row.mag_ut);
        self.cells(row.reference);
        self.line.push(if row.moving { '1' } else { '0' });
        for x in further {
            write!(self.line, ",{x}").expect("writing to a String does not fail");
        }
        self.end_line()
    }

    /// Completes the file.
    pub fn finish(self) -> Result<(), InputError> {
        self.file.finish()
    }

    /// Returns the written file, which the caller completes.
    pub fn into_file(self) -> OutputFile {
        self.file
    }

    fn cell(&mut self, x: f64) {
        write!(self.line, "{x},").expect("writing to a String does not fail");
    }

    fn cells<const N: usize>(&mut self, values: Option<[f64; N]>) {
        match values {
            Some(values) => values.into_iter().for_each(|x| self.cell(x)),
            None => self.line.extend([','; N]),
        }
    }

    fn end_line(&mut self) -> Result<(), InputError> {
        self.line.push('\n');
        let written = self.file.write_all(self.line.as_bytes());
        self.line.clear();
        written.map_err(|error| self.file.error(&error))
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Axes, Log};
    use super::*;

    #[test]
    fn written_rows_read_back_bit_for_bit() {
        let rows = [
            LogRow {
                time_s: 0.1 + 0.2,
                gyro_rad_s: [1.0 / 3.0, -0.0, 5e-324],
                accel_m_s2: [-9.806_65, 1e5, f64::EPSILON],
                mag_ut: Some([20.0, -3.7, 43.1]),
                reference: Some([0.5, -0.5, 0.5, -0.5]),
                moving: true,
            },
            LogRow {
                time_s: 1_234.567_891,
                gyro_rad_s: [0.0; 3],
                accel_m_s2: [0.0; 3],
                mag_ut: None,
                reference: None,
                moving: false,
            },
        ];
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("log.csv");
        let mut writer = LogWriter::create(&path).unwrap();
        for row in &rows {
            writer.write(row).unwrap();
        }
        assert!(!path.exists(), "the file appears only when it is complete");
        writer.finish().unwrap();
        assert_eq!(Log::read(&path, Axes::default()).unwrap().rows, rows);
    }

    #[test]
    fn log_file_has_fixed_bytes() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("log.csv");
        let mut writer = LogWriter::create(&path).unwrap();
        writer
            .write(&LogRow {
                time_s: 0.001,
                gyro_rad_s: [0.5, -0.25, 0.1],
                accel_m_s2: [0.0, 0.0, -9.806_65],
                mag_ut: None,
                reference: Some([1.0, 0.0, 0.0, 0.0]),
                moving: true,
            })
            .unwrap();
        writer.finish().unwrap();
        assert_eq!(
            std::fs::read_to_string(&path).unwrap(),
            "time_s,gyro_x_rad_s,gyro_y_rad_s,gyro_z_rad_s,accel_x_m_s2,accel_y_m_s2,accel_z_m_s2,mag_x_ut,mag_y_ut,\
             mag_z_ut,ref_qw,ref_qx,ref_qy,ref_qz,moving\n0.001,0.5,-0.25,0.1,0,0,-9.80665,,,,1,0,0,0,1\n"
        );
    }
}
