//! Checks of IMU samples: invalid data, and axes that are stuck.

use crate::arithmetic::max;
use crate::sample::ImuSample;

/// Value of all axis registers of the ICM-42688-P when there is no valid sample (datasheet DS-000347, section 14.1 on
/// the data registers). A single axis with this value is at the end of its range.
const INVALID: i16 = i16::MIN;

/// Largest count of the range; [`LOWEST`] is the smallest. The counts of the ICM-42688-P end at −32,766, because the
/// two smaller values mark invalid data (the same section); the counts of a simulated converter end at −32,768.
const HIGHEST: i16 = i16::MAX;
const LOWEST: i16 = -32_766;

/// Time after which an axis with a constant value counts as stuck, s.
const IMU_STUCK_S: f32 = 0.1;
/// Minimum number of checks with a constant value before an axis counts as stuck.
const MIN_STUCK_CHECKS: f32 = 50.0;

/// Selects the sensors that have enough noise to be checked: an axis of these that reads a constant value for long is
/// stuck.
///
/// A real chip has a noise of about one count or more. The gyroscope of the ICM-42688-P has 0.0028 °/s/√Hz. In its band
/// of 258 Hz this is 0.045 °/s rms, or 0.74 counts. Two samples are equal with a probability of about 0.28 divided by
/// the noise in counts, here 0.4; fifty equal pairs in succession have a probability of 10⁻²⁰, or 10⁻¹³ with half a
/// count of noise. A simulated sensor without noise may read a constant value for ever, so it is not checked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct StuckCheck {
    /// Checks the gyroscope.
    pub gyro: bool,
    /// Checks the accelerometer.
    pub accel: bool,
}

/// The check for stuck axes. It examines gyroscope and accelerometer in turn, one of them per sample.
#[derive(Clone, Debug)]
pub struct ImuCheck {
    check: StuckCheck,
    /// Number of checks with a constant value from which an axis counts as stuck.
    limit: u32,
    /// Whether the gyroscope is checked next; otherwise the accelerometer is.
    gyro_next: bool,
    last: ImuSample,
    /// Checks since each axis of gyroscope and accelerometer last changed.
    still: [[u32; 3]; 2],
    stuck: bool,
}

impl ImuCheck {
    /// Creates the check for `rate_hz` (Hz) samples per second.
    pub fn new(check: StuckCheck, rate_hz: f32) -> Self {
        let limit = max(0.5 * rate_hz * IMU_STUCK_S, MIN_STUCK_CHECKS) as u32;
        Self { check, limit, gyro_next: true, last: ImuSample::default(), still: [[0; 3]; 2], stuck: false }
    }

    /// Returns whether the sample is valid: not the code for invalid data on all six axes.
    #[inline]
    pub fn is_valid(sample: &ImuSample) -> bool {
        sample.gyro.iter().chain(&sample.accel).any(|&counts| counts != INVALID)
    }

    /// Updates the check with a valid sample.
    #[inline]
    pub fn update(&mut self, sample: &ImuSample) {
        let [gyro, accel] = &mut self.still;
        let (checked, still, last, now) = if self.gyro_next {
            (self.check.gyro, gyro, &mut self.last.gyro, sample.gyro)
        } else {
            (self.check.accel, accel, &mut self.last.accel, sample.accel)
        };
        self.gyro_next = !self.gyro_next;
        if !checked {
            return;
        }
        let longest = count_unchanged(still, *last, now);
        *last = now;
        // The result stays until the next check of the stuck sensor.
        if longest >= self.limit || self.stuck {
            self.stuck = self.stuck_within_range();
        }
    }

    /// Returns whether an axis is stuck. An axis at the end of its range is not: the motion exceeds the range of the
    /// sensor.
    #[cold]
    fn stuck_within_range(&self) -> bool {
        let counts = self.last.gyro.iter().chain(&self.last.accel);
        let mut axes = self.still.as_flattened().iter().zip(counts);
        axes.any(|(&still, &counts)| still >= self.limit && counts > LOWEST && counts < HIGHEST)
    }

    /// Returns whether an axis has read a constant value for too long.
    #[inline(always)]
    pub fn stuck(&self) -> bool {
        self.stuck
    }
}

/// Counts for each axis the checks since it last changed. Returns the largest of the three counts.
#[inline(always)]
fn count_unchanged(still: &mut [u32; 3], last: [i16; 3], now: [i16; 3]) -> u32 {
    let mut longest = 0;
    for ((still, last), now) in still.iter_mut().zip(last).zip(now) {
        // At the highest rate the counter wraps after a day and a half; the axis is then detected again within 0.1 s.
        *still = if last == now { still.wrapping_add(1) } else { 0 };
        longest = longest.max(*still);
    }
    longest
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    proptest! {
        /// Computed from the whole history: an axis is stuck if its last checks, as many as fit into 0.1 s, all read
        /// the same value, which is not at an end of the range. The result changes only when its sensor is checked.
        #[test]
        fn constant_value_for_a_tenth_of_a_second_is_stuck(
            rate_hz in prop_oneof![Just(1000.0_f32), 10.0..32_000.0_f32, Just(1130.0)],
            gyro_checked in any::<bool>(), accel_checked in prop::bool::weighted(0.7),
            runs in prop::collection::vec((
                prop::array::uniform6(prop_oneof![
                    6 => Just(None), 1 => (-9_i16..9).prop_map(Some), 1 => prop::sample::select(&ENDS[..]).prop_map(Some),
                    1 => prop::sample::select(&[32_766_i16, -32_765][..]).prop_map(Some),
                ]),
                1..400_usize,
            ), 1..6),
        ) {
            let mut ours = ImuCheck::new(StuckCheck { gyro: gyro_checked, accel: accel_checked }, rate_hz);
            // Every other sample is checked. Of n + 1 equal values, n equal the one before.
            let limit = ((0.5 * f64::from(rate_hz) * 0.1) as usize).max(50);

            let mut checks: [Vec<[i16; 3]>; 2] = [std::vec![[0; 3]], std::vec![[0; 3]]];
            let (mut step, mut stuck) = (0_usize, false);
            for (held, times) in runs {
                for _ in 0..times {
                    let axis = |index: usize| held[index].unwrap_or(100 + (step as i16 & 0xff) * 7 + index as i16);
                    let sample = ImuSample { gyro: [axis(0), axis(1), axis(2)], accel: [axis(3), axis(4), axis(5)] };
                    ours.update(&sample);
                    let turn = step % 2;
                    let (checked, now) = if turn == 0 { (gyro_checked, sample.gyro) } else { (accel_checked, sample.accel) };
                    if checked {
                        checks[turn].push(now);
                        let alike = |checks: &[[i16; 3]], axis: usize| {
                            let last = checks[checks.len() - 1][axis];
                            let run = checks.iter().rev().take_while(|check| check[axis] == last).count() - 1;
                            run >= limit && !ENDS.contains(&last)
                        };
                        stuck = checks.iter().any(|checks| (0..3).any(|axis| alike(checks, axis)));
                    }
                    prop_assert_eq!(ours.stuck(), stuck, "at {}", step);
                    step += 1;
                }
            }
        }

        #[test]
        fn one_axis_without_the_code_makes_it_valid(axis in 0..6_usize, counts in any::<i16>()) {
            let mut all = [i16::MIN; 6];
            all[axis] = counts;
            let [a, b, c, d, e, f] = all;
            prop_assert_eq!(ImuCheck::is_valid(&ImuSample { gyro: [a, b, c], accel: [d, e, f] }), counts != i16::MIN);
        }
    }

    /// Ends of the range of a chip and of a simulated converter, and the values between them.
    const ENDS: [i16; 4] = [32_767, -32_766, -32_767, -32_768];

    const BOTH: StuckCheck = StuckCheck { gyro: true, accel: true };

    fn moving(step: i16) -> ImuSample {
        ImuSample { gyro: [step, -step, step ^ 1], accel: [step + 1, step + 2, step + 3] }
    }

    #[test]
    fn any_single_constant_axis_is_stuck() {
        for axis in 0..6 {
            let mut check = ImuCheck::new(BOTH, 1000.0);
            for step in 0..100 {
                check.update(&with_axis(step, axis, 7));
                assert!(!check.stuck(), "axis {axis}, step {step}");
            }
            // Each sensor is checked in every other sample.
            check.update(&with_axis(100, axis, 7));
            check.update(&with_axis(101, axis, 7));
            assert!(check.stuck(), "axis {axis}");
            check.update(&moving(102));
            check.update(&moving(103));
            assert!(!check.stuck(), "axis {axis} moves again");
        }
    }

    #[test]
    fn slow_sensor_is_stuck_after_fifty_checks() {
        let mut check = ImuCheck::new(BOTH, 100.0);
        for _ in 0..100 {
            check.update(&moving(2));
            assert!(!check.stuck());
        }
        check.update(&moving(2));
        assert!(check.stuck());
    }

    /// The sample of a vehicle in motion, except for one axis, which reads `counts`.
    fn with_axis(step: i16, axis: usize, counts: i16) -> ImuSample {
        let mut sample = moving(step);
        let ImuSample { gyro, accel } = &mut sample;
        [gyro, accel][axis / 3][axis % 3] = counts;
        sample
    }

    #[test]
    fn axis_at_an_end_of_its_range_is_not_stuck() {
        let stuck_at = |axis, counts| {
            let mut check = ImuCheck::new(BOTH, 1000.0);
            (0..1_000).any(|step| {
                check.update(&with_axis(step, axis, counts));
                check.stuck()
            })
        };
        for axis in 0..6 {
            for end in ENDS {
                assert!(!stuck_at(axis, end), "axis {axis} at {end}");
            }
            for within in [32_766, -32_765] {
                assert!(stuck_at(axis, within), "axis {axis} at {within}");
            }
        }
    }

    #[test]
    fn sensor_without_noise_is_not_checked() {
        let mut ideal = ImuCheck::new(StuckCheck { gyro: false, accel: false }, 1000.0);
        for _ in 0..1_000 {
            ideal.update(&moving(1));
            assert!(!ideal.stuck());
        }
    }

    #[test]
    fn sample_is_invalid_with_the_code_on_all_axes() {
        let invalid = ImuSample { gyro: [i16::MIN; 3], accel: [i16::MIN; 3] };
        assert!(!ImuCheck::is_valid(&invalid));
        assert!(ImuCheck::is_valid(&ImuSample { gyro: [i16::MIN, i16::MIN, -32_767], ..invalid }));
        assert!(ImuCheck::is_valid(&ImuSample::default()));
    }
}
