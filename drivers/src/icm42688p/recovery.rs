//! Decides when a sampling IMU needs a new set-up.

use flight_core::sample::ImuSample;

use super::FrameError;

/// Time without a sample after which the IMU needs a new set-up, µs. The flight controller takes 100 ms without a
/// sample as the loss of the IMU; a set-up takes 59 ms at most ([`Setup`](super::Setup)).
const SAMPLE_TIMEOUT_US: u32 = 10_000;

/// Monitors the frames.
///
/// A set-up stops the samples for 55 ms, so one frame alone must not cause it: SPI has no checksum, and a flipped bit
/// may look like a reset. A new set-up is needed
/// - if a frame reports a reset, and the next frame has no sample either;
/// - if no sample has come for 10 ms, for any reason.
#[derive(Clone, Copy, Debug, Default)]
pub struct Recovery {
    /// Time of the last frame that shows a sampling IMU, or of the first frame, µs.
    last_sample_us: Option<u32>,
    /// Whether the last frame reported a reset.
    reset: bool,
}

impl Recovery {
    /// Returns the state after a set-up, before the first frame.
    pub const fn new() -> Self {
        Self { last_sample_us: None, reset: false }
    }

    /// Returns whether the IMU needs a new set-up, by the frame at `at_us`, on a counter that may wrap. A burst that
    /// failed on the bus is a [`FrameError::NoAnswer`]. After `true`, the next frames are taken as those after a
    /// set-up.
    #[inline]
    pub fn needs_setup(&mut self, frame: Result<ImuSample, FrameError>, at_us: u32) -> bool {
        let error = match frame {
            // A torn sample also shows that the IMU samples.
            Ok(_) | Err(FrameError::Torn) => {
                *self = Self { last_sample_us: Some(at_us), reset: false };
                return false;
            }
            Err(error) => error,
        };
        self.on_no_sample(error, at_us)
    }

    fn on_no_sample(&mut self, error: FrameError, at_us: u32) -> bool {
        let last_sample_us = *self.last_sample_us.get_or_insert(at_us);
        let must = self.reset || at_us.wrapping_sub(last_sample_us) > SAMPLE_TIMEOUT_US;
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
    fn reset_without_next_sample_needs_setup() {
        let mut recovery = Recovery::new();
        assert!(!recovery.needs_setup(SAMPLE, 0));
        assert!(!recovery.needs_setup(RESET, 1_000), "a bit may have flipped");
        assert!(!recovery.needs_setup(SAMPLE, 2_000), "it was a flipped bit");
        assert!(!recovery.needs_setup(NO_DATA, 3_000));
        assert!(!recovery.needs_setup(RESET, 4_000));
        assert!(recovery.needs_setup(NO_DATA, 5_000));
        // After a set-up, the earlier errors no longer count.
        assert!(!recovery.needs_setup(NO_DATA, 65_000));
        assert!(!recovery.needs_setup(SAMPLE, 66_000));
    }

    #[test]
    fn no_sample_for_10_ms_needs_setup() {
        for error in [FrameError::NoAnswer, FrameError::NoData, FrameError::Repeated] {
            // The counter wraps during the test.
            let mut at_us = u32::MAX - 5_000;
            let mut recovery = Recovery::new();
            assert!(!recovery.needs_setup(SAMPLE, at_us));
            for _ in 0..10 {
                at_us = at_us.wrapping_add(1_000);
                assert!(!recovery.needs_setup(Err(error), at_us));
            }
            assert!(recovery.needs_setup(Err(error), at_us.wrapping_add(1_000)));
        }
    }

    #[test]
    fn torn_samples_need_no_setup() {
        let mut recovery = Recovery::new();
        for at_us in (0..100_000).step_by(1_000) {
            assert!(!recovery.needs_setup(Err(FrameError::Torn), at_us));
        }
    }
}
