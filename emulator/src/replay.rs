//! What the flight controller was given on the emulated chip, given again to the same code in this process.
//!
//! Every step's record has the times, counts, frames and voltages that went into the step, and the pulses, state and
//! attitude that came out. The same inputs must give the same outputs here, bit for bit: the processor, its
//! floating-point unit and the firmware's own wiring of the flight controller add nothing and lose nothing.

use flight_core::calibration::Sensitivity;
use flight_core::record::{Outcome, StepRecord};
use flight_core::{Config, FlightController};
use input::axes::Axes;

use crate::board::Wiring;

/// The configuration that the firmware flies with: the stored one, with the sensors mounted as on the board.
pub fn on_board(config: &Config, wiring: &Wiring) -> Config {
    let mut config = *config;
    let mounted =
        |axes: &Axes, sensor: Sensitivity| Sensitivity { mounting: vehicle::matrix(axes), ..sensor };
    config.params.gyro = mounted(&wiring.imu_axes, config.params.gyro);
    config.params.accel = mounted(&wiring.imu_axes, config.params.accel);
    config.params.mag = mounted(&wiring.magnetometer_axes, config.params.mag);
    config
}

/// The first step whose outcome differs: its place among the records, and what came here.
#[derive(Debug)]
pub struct Difference {
    /// Place among the records.
    pub step: usize,
    /// On the chip.
    pub there: Box<StepRecord>,
    /// In this process.
    pub here: Box<Outcome>,
}

/// Steps the records of one start of the firmware through a flight controller of this configuration. Returns how many
/// there were.
///
/// # Errors
/// A step has another outcome here.
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
        // As words, in which floats are bits.
        if (StepRecord { outcome: here, ..*record }).to_words() != record.to_words() {
            return Err(Difference { step, there: Box::new(*record), here: Box::new(here) });
        }
    }
    Ok(records.len())
}
