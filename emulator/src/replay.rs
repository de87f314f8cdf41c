//! Replay of the records from the emulated chip through the same flight controller in this process.
//!
//! The record of a step has its inputs (time, counts, frames and voltages) and its outputs (pulses, state and attitude). The
//! same inputs must give the same outputs here, bit for bit. This shows that the emulated processor, its floating-point unit
//! and the firmware's use of the flight controller change nothing.

use flight_core::calibration::Sensitivity;
use flight_core::record::{Outcome, StepRecord};
use flight_core::{Config, FlightController};
use input::axes::Axes;

use crate::board::Wiring;

/// Returns the firmware's configuration in flight: the stored one, with the mountings of the sensors on the board.
pub fn on_board(config: &Config, wiring: &Wiring) -> Config {
    let mut config = *config;
    let mounted =
        |axes: &Axes, sensor: Sensitivity| Sensitivity { mounting: vehicle::matrix(axes), ..sensor };
    config.params.gyro = mounted(&wiring.imu_axes, config.params.gyro);
    config.params.accel = mounted(&wiring.imu_axes, config.params.accel);
    config.params.mag = mounted(&wiring.magnetometer_axes, config.params.mag);
    config
}

/// The first step with another outcome.
#[derive(Debug)]
pub struct Difference {
    /// Index of the record.
    pub step: usize,
    /// Record of the chip.
    pub on_chip: Box<StepRecord>,
    /// Outcome in this process.
    pub here: Box<Outcome>,
}

/// Replays the records of one start of the firmware with this configuration. Returns the number of steps.
///
/// # Errors
/// A step has another outcome in this process.
///
/// # Panics
/// The configuration is out of range.
pub fn replay(records: &[StepRecord], config: &Config) -> Result<usize, Difference> {
    let mut controller = FlightController::new(config).expect("the firmware flew with it");
    for (step, record) in records.iter().enumerate() {
        let output = controller.step(&record.input());
        let here = Outcome {
            driven: output.permit.is_some(),
            pulses_us: output.pulses_us,
            state: output.state,
            event: output.event,
            attitude: controller.attitude(),
        };
        // The comparison as words compares the bits of floats.
        if (StepRecord { outcome: here, ..*record }).to_words() != record.to_words() {
            return Err(Difference { step, on_chip: Box::new(*record), here: Box::new(here) });
        }
    }
    Ok(records.len())
}
