//! The magnetometer: search, read, detect loss, search again.
//!
//! It is on a connector, so it may be missing, or be unplugged at any time. That must not affect other tasks: this task
//! has the lowest priority, its bus limits the time of each run in any state of the wires, and the watchdog does not check
//! it.

use drivers::qmc5883l::{Qmc5883l, SampleError};
use embedded_hal::delay::DelayNs;
use embedded_hal::i2c::I2c;
use flight_core::sample::MagSample;

use tasks::counters::COUNTERS;

/// Runs from one search for the sensor to the next: one second at 200 Hz.
const RETRY_RUNS: u32 = 200;

/// The magnetometer on its bus.
pub struct Magnetometer<B> {
    bus: B,
    sensor: Option<Qmc5883l<B>>,
    runs_to_retry: u32,
}

impl<B: I2c + Clone> Magnetometer<B> {
    /// Returns the magnetometer before the first search.
    pub fn new(bus: B) -> Self {
        Self { bus, sensor: None, runs_to_retry: 0 }
    }

    /// Returns the new sample, if there is one. Searches for the sensor first if that is due.
    pub fn run(&mut self, delay: &mut impl DelayNs) -> Option<MagSample> {
        let Some(sensor) = &mut self.sensor else {
            self.search(delay);
            return None;
        };
        match sensor.sample() {
            Ok(sample) => {
                if sample.is_some() {
                    COUNTERS.mag.add();
                }
                sample
            }
            Err(SampleError::Skipped(sample)) => {
                COUNTERS.mag.add();
                Some(sample)
            }
            // The field exceeds the range, but the sensor works.
            Err(SampleError::Overflow) => {
                COUNTERS.mag_errors.add();
                None
            }
            Err(SampleError::Bus(_) | SampleError::SettingLost) => {
                COUNTERS.mag_errors.add();
                defmt::warn!("magnetometer lost");
                self.sensor = None;
                None
            }
        }
    }

    fn search(&mut self, delay: &mut impl DelayNs) {
        if self.runs_to_retry > 0 {
            self.runs_to_retry -= 1;
            return;
        }
        self.runs_to_retry = RETRY_RUNS;
        self.sensor = Qmc5883l::new(self.bus.clone(), delay).ok();
        if self.sensor.is_some() {
            defmt::info!("magnetometer found");
        }
    }
}
