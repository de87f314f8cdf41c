//! From a record in a board's flash to what the flight controller is built from.
//!
//! The vehicle's configuration and its sensors' calibration are stored; what is soldered to the board is not. A record
//! is taken whole or not at all: part of one would be a vehicle that nobody has set up.

use flight_core::{Config, FlightController, Params};

use crate::{DecodeError, decode};

/// Sensitivities this close to the board's, as a share, are the same: a host computes them in f64.
const SAME_SENSITIVITY: f32 = 1.0e-3;

/// Why a record is not used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refused {
    /// There is none, or it is damaged.
    Record(DecodeError),
    /// This field is out of range.
    OutOfRange(&'static str),
    /// This field is not what the board has.
    NotTheBoards(&'static str),
}

impl Refused {
    /// What is wrong, and with which field.
    pub const fn text(self) -> (&'static str, &'static str) {
        match self {
            Self::Record(error) => (error.name(), ""),
            Self::OutOfRange(field) => ("out of range: ", field),
            Self::NotTheBoards(field) => ("not this board's: ", field),
        }
    }
}

/// The configuration of the record at the beginning of `bytes`, for a board with the rate, the sensitivities and the
/// mounting of `board`.
///
/// The record says how the board lies in the vehicle, and how the magnetometer does, which is not soldered to the board; the
/// inertial sensor's mounting on the board is the board's. The sensors' rate and sensitivities are what the drivers set the
/// chips to, and a record for others is refused: its gains and its calibration belong to another board.
///
/// # Errors
/// The record is not whole, or not for this board, or no flight controller can be built from it.
pub fn read_for_board(bytes: &[u8], board: &Params) -> Result<Config, Refused> {
    let mut config = decode(bytes).map_err(Refused::Record)?;
    let params = &mut config.params;
    if params.imu_rate_hz != board.imu_rate_hz {
        return Err(Refused::NotTheBoards("imu_rate_hz"));
    }
    for (field, stored, ours) in [
        ("gyro.per_count", params.gyro.per_count, board.gyro.per_count),
        ("accel.per_count", params.accel.per_count, board.accel.per_count),
        ("mag.per_count", params.mag.per_count, board.mag.per_count),
    ] {
        let share = stored / ours - 1.0;
        // A NaN is within nothing.
        if !(-SAME_SENSITIVITY..=SAME_SENSITIVITY).contains(&share) {
            return Err(Refused::NotTheBoards(field));
        }
    }
    params.gyro.mounting = params.gyro.mounting * board.gyro.mounting;
    params.accel.mounting = params.accel.mounting * board.accel.mounting;
    match FlightController::new(&config) {
        Ok(_) => Ok(config),
        Err(error) => Err(Refused::OutOfRange(error.field)),
    }
}
