//! The log of a flight: sensor readings, the truth, and the output of the flight controller.

use std::path::Path;

use flight_core::geometry::{Vec3, vec3};

use super::{Observer, StepView};
use crate::log::{LogRow, LogWriter};
use crate::output_file::OutputFile;
use crate::scene::Scene;
use input::InputError;

/// The columns of a flight, after the standard columns.
const FURTHER: [&str; 11] = [
    "est_qw",
    "est_qx",
    "est_qy",
    "est_qz",
    "north_m",
    "east_m",
    "down_m",
    "pulse_1_us",
    "pulse_2_us",
    "pulse_3_us",
    "pulse_4_us",
];

/// An observer that writes a row at every step with an IMU sample. `moving` is 1 while the motors may turn.
#[derive(Debug)]
pub struct FlightLog {
    writer: LogWriter,
    /// SI units per count of gyroscope, accelerometer and magnetometer (µT).
    per_count: [f64; 3],
    failed: Option<InputError>,
}

impl FlightLog {
    /// Starts the log file `path`.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn create(path: impl AsRef<Path>, scene: &Scene) -> Result<Self, InputError> {
        let writer = LogWriter::create_with(path, &FURTHER)?;
        Ok(Self { writer, per_count: scene.converters.map(|c| c.per_count()), failed: None })
    }

    /// Completes the file.
    ///
    /// # Errors
    /// The first error in writing the file.
    pub fn finish(self) -> Result<(), InputError> {
        self.into_file()?.finish()
    }

    /// Returns the written file, which the caller completes.
    ///
    /// # Errors
    /// The first error in writing the file.
    pub fn into_file(self) -> Result<OutputFile, InputError> {
        self.failed.map_or(Ok(self.writer.into_file()), Err)
    }
}

impl Observer for FlightLog {
    fn step(&mut self, view: &StepView) {
        let Some(imu) = &view.input.imu else { return };
        let si = |counts: [i16; 3], per_count: f64| {
            let [x, y, z] = counts.map(f64::from);
            <[f64; 3]>::from(vec3(x, y, z) * per_count)
        };
        let [gyro, accel, mag] = self.per_count;
        let row = LogRow {
            time_s: view.time_us as f64 * 1e-6,
            gyro_rad_s: si(imu.gyro, gyro),
            accel_m_s2: si(imu.accel, accel),
            mag_ut: view.input.mag.map(|sample| si(sample.counts, mag)),
            reference: Some(view.truth.attitude.to_array()),
            moving: view.output.driven,
        };
        let [w, x, y, z] = view.estimate.to_array();
        let Vec3 { x: north, y: east, z: down } = view.truth.position;
        let [p1, p2, p3, p4] = view.output.pulses_us.map(f64::from);
        let further = [w, x, y, z, north, east, down, p1, p2, p3, p4];
        if self.failed.is_none() {
            self.failed = self.writer.write_with(&row, &further).err();
        }
    }
}
