//! Reading of a record in a board's flash for the flight controller of that board.
//!
//! A record holds the vehicle's configuration and the sensors' calibration. The board's own properties, such as the
//! mounting of its IMU, are not from the record. A record is used as a whole or not at all: a part of it would
//! be the configuration of a vehicle that does not exist.

use flight_core::{Config, FlightController, Params};

use crate::{DecodeError, decode};

/// Maximum difference of sensitivities that count as equal, as a share of the board's. They can differ, because the
/// host computes them in f64.
const SAME_SENSITIVITY: f32 = 1.0e-3;

/// The reason why a record is not used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refused {
    /// The record is missing or invalid.
    Record(DecodeError),
    /// This field is out of range.
    OutOfRange(&'static str),
    /// This field differs from the board's value.
    WrongBoard(&'static str),
}

impl Refused {
    /// Returns the error and the field, for a log.
    pub const fn text(self) -> (&'static str, &'static str) {
        match self {
            Self::Record(error) => (error.name(), ""),
            Self::OutOfRange(field) => ("out of range: ", field),
            Self::WrongBoard(field) => ("for another board: ", field),
        }
    }
}

/// Returns the configuration of the record at the beginning of `bytes`, for a board with the rate, the sensitivities and
/// the mounting of `board`.
///
/// The record gives the mounting of the board in the vehicle, and that of the magnetometer, which is not on the board. The
/// mounting of the IMU on the board is from `board`. The drivers set the sensors' rate and sensitivities. A
/// record with other values is refused, because its gains and calibration belong to another board.
///
/// # Errors
/// The record is invalid, is for another board, or the flight controller rejects it.
pub fn read_for_board(bytes: &[u8], board: &Params) -> Result<Config, Refused> {
    let mut config = decode(bytes).map_err(Refused::Record)?;
    let params = &mut config.params;
    if params.imu_rate_hz != board.imu_rate_hz {
        return Err(Refused::WrongBoard("imu_rate_hz"));
    }
    for (field, stored, ours) in [
        ("gyro.per_count", params.gyro.per_count, board.gyro.per_count),
        ("accel.per_count", params.accel.per_count, board.accel.per_count),
        ("mag.per_count", params.mag.per_count, board.mag.per_count),
    ] {
        let share = stored / ours - 1.0;
        // A range check, because a NaN fails it.
        if !(-SAME_SENSITIVITY..=SAME_SENSITIVITY).contains(&share) {
            return Err(Refused::WrongBoard(field));
        }
    }
    params.gyro.mounting = params.gyro.mounting * board.gyro.mounting;
    params.accel.mounting = params.accel.mounting * board.accel.mounting;
    match FlightController::new(&config) {
        Ok(_) => Ok(config),
        Err(error) => Err(Refused::OutOfRange(error.field)),
    }
}
