//! When a sensor that samples must be set up again.

use flight_core::sample::ImuSample;

use super::FrameError;

/// How long a sensor may bring nothing, µs. The flight controller takes 100 ms without a sample for the loss of the
/// sensor; a set-up takes 59 ms at most ([`Setup`](super::Setup)).
const PATIENCE_US: u32 = 10_000;

/// Watches the frames.
///
/// A set-up stops the samples for 55 ms, so a single frame must not bring it about: SPI has no checksum, and a bit
/// that flips on the way looks like a reset. The sensor is set up again
/// - if it says that it has reset, and the next frame has no sample either;
/// - if it has brought no sample for 10 ms, for whatever reason.
#[derive(Clone, Copy, Debug, Default)]
pub struct Recovery {
    /// The last frame that shows that the sensor samples, or the first of all.
    alive_us: Option<u32>,
    /// The last frame said that the sensor has reset.
    reset: bool,
}

impl Recovery {
    /// Nothing has been seen since the last set-up.
    pub const fn new() -> Self {
        Self { alive_us: None, reset: false }
    }

    /// Whether the sensor must be set up, by the frame of `at_us`, on a counter that may wrap. A burst that the bus
    /// could not bring is a [`FrameError::NoAnswer`]. After a yes, frames are those of a sensor that is set up.
    #[inline]
    pub fn must_set_up(&mut self, frame: Result<ImuSample, FrameError>, at_us: u32) -> bool {
        let error = match frame {
            // A sample that was torn has been taken.
            Ok(_) | Err(FrameError::Torn) => {
                *self = Self { alive_us: Some(at_us), reset: false };
                return false;
            }
            Err(error) => error,
        };
        self.vain(error, at_us)
    }

    fn vain(&mut self, error: FrameError, at_us: u32) -> bool {
        let alive_us = *self.alive_us.get_or_insert(at_us);
        let must = self.reset || at_us.wrapping_sub(alive_us) > PATIENCE_US;
        self.reset = error == FrameError::Reset;
        if must {
            *self = Self::new();
        }
        must
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SAMPLE: Result<ImuSample, FrameError> = Ok(ImuSample { accel: [0; 3], gyro: [0; 3] });
    const RESET: Result<ImuSample, FrameError> = Err(FrameError::Reset);
    const NO_DATA: Result<ImuSample, FrameError> = Err(FrameError::NoData);

    #[test]
    fn a_reset_is_believed_when_no_sample_follows() {
        let mut recovery = Recovery::new();
        assert!(!recovery.must_set_up(SAMPLE, 0));
        assert!(!recovery.must_set_up(RESET, 1_000), "a bit may have flipped");
        assert!(!recovery.must_set_up(SAMPLE, 2_000), "it had");
        assert!(!recovery.must_set_up(NO_DATA, 3_000));
        assert!(!recovery.must_set_up(RESET, 4_000));
        assert!(recovery.must_set_up(NO_DATA, 5_000));
        // Set up again: nothing is held against it.
        assert!(!recovery.must_set_up(NO_DATA, 65_000));
        assert!(!recovery.must_set_up(SAMPLE, 66_000));
    }

    #[test]
    fn ten_milliseconds_without_a_sample_are_enough() {
        for error in [FrameError::NoAnswer, FrameError::NoData, FrameError::Repeated] {
            // Over the counter's wrap.
            let mut at_us = u32::MAX - 5_000;
            let mut recovery = Recovery::new();
            assert!(!recovery.must_set_up(SAMPLE, at_us));
            for _ in 0..10 {
                at_us = at_us.wrapping_add(1_000);
                assert!(!recovery.must_set_up(Err(error), at_us));
            }
            assert!(recovery.must_set_up(Err(error), at_us.wrapping_add(1_000)));
        }
    }

    #[test]
    fn a_sensor_whose_samples_are_torn_is_alive() {
        let mut recovery = Recovery::new();
        for at_us in (0..100_000).step_by(1_000) {
            assert!(!recovery.must_set_up(Err(FrameError::Torn), at_us));
        }
    }
}
