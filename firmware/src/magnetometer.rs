//! The magnetometer: looked for, read, given up, looked for again.
//!
//! It hangs on a connector, and may not be there, or not any more. None of that is anybody else's concern: the
//! task has the lowest priority, and its bus ends every run in time, whatever the wires do. The watchdog does not look at
//! it.

use drivers::qmc5883l::{Qmc5883l, SampleError};
use embedded_hal::delay::DelayNs;
use embedded_hal::i2c::I2c;
use flight_core::sample::MagSample;

use tasks::counters::COUNTERS;

/// Runs from one attempt to find the sensor to the next: a second.
const RETRY_RUNS: u32 = 200;

/// The magnetometer on its bus.
pub struct Magnetometer<B> {
    bus: B,
    sensor: Option<Qmc5883l<B>>,
    runs_to_retry: u32,
}

impl<B: I2c + Clone> Magnetometer<B> {
    /// Not looked for yet.
    pub fn new(bus: B) -> Self {
        Self { bus, sensor: None, runs_to_retry: 0 }
    }

    /// A run: the sample that is new, if there is one. Looks for the sensor first, if it is time to.
    pub fn run(&mut self, delay: &mut impl DelayNs) -> Option<MagSample> {
        let Some(sensor) = &mut self.sensor else {
            self.look_for_it(delay);
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
            // The field is beyond the range: the sensor is well.
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

    fn look_for_it(&mut self, delay: &mut impl DelayNs) {
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
