//! Whether an inertial sample is one.

use crate::arithmetic::max;
use crate::sample::ImuSample;

/// What the ICM-42688-P's registers hold when there is no valid sample, on every axis (datasheet DS-000347,
/// section 14.1 on the data registers); a single axis at this value is one at the end of its range.
const INVALID: i16 = i16::MIN;

/// The ends of the range. The ICM-42688-P's counts end at −32,766, because the two below mark invalid data (the same
/// section); a simulated converter's end at −32,768.
const HIGHEST: i16 = i16::MAX;
const LOWEST: i16 = -32_766;

/// How long an axis may read the same, s.
const IMU_STUCK_S: f32 = 0.1;
/// And in how many looks, at least.
const MIN_STUCK_LOOKS: f32 = 50.0;

/// Which sensors are noisy enough that an axis which reads the same for long must be stuck.
///
/// A real chip's noise is about a count or more: the ICM-42688-P's gyroscope has 0.0028 °/s/√Hz, over 258 Hz
/// 0.045 °/s rms, 0.74 counts. Two samples are equal with a chance of about 0.28 over the noise in counts, 0.4
/// here, and fifty pairs in succession with 10⁻²⁰; with half a count it is 10⁻¹³. A simulated sensor without noise
/// may stand still for ever.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct StuckCheck {
    /// The gyroscope.
    pub gyro: bool,
    /// The accelerometer.
    pub accel: bool,
}

/// Looks at samples as they come.
#[derive(Clone, Debug)]
pub struct ImuCheck {
    check: StuckCheck,
    /// Looks in which an axis may stand still.
    limit: u32,
    /// Whether the gyroscope is the next to be looked at: it and the accelerometer take turns.
    gyro_next: bool,
    last: ImuSample,
    /// Looks since each axis of gyroscope and accelerometer last moved.
    still: [[u32; 3]; 2],
    stuck: bool,
}

impl ImuCheck {
    /// Before the first of `rate_hz` samples a second.
    pub fn new(check: StuckCheck, rate_hz: f32) -> Self {
        let limit = max(0.5 * rate_hz * IMU_STUCK_S, MIN_STUCK_LOOKS) as u32;
        Self { check, limit, gyro_next: true, last: ImuSample::default(), still: [[0; 3]; 2], stuck: false }
    }

    /// Whether the sample is one, and no code for the lack of one.
    #[inline]
    pub fn is_valid(sample: &ImuSample) -> bool {
        sample.gyro.iter().chain(&sample.accel).any(|&counts| counts != INVALID)
    }

    /// Takes a valid sample.
    #[inline]
    pub fn take(&mut self, sample: &ImuSample) {
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
        let longest = count(still, *last, now);
        *last = now;
        // Until the stuck sensor's next turn the verdict stands.
        if longest >= self.limit || self.stuck {
            self.stuck = self.stuck_within_range();
        }
    }

    /// At the end of its range an axis is not stuck: the vehicle does more than the sensor can say.
    #[cold]
    fn stuck_within_range(&self) -> bool {
        let counts = self.last.gyro.iter().chain(&self.last.accel);
        let mut axes = self.still.as_flattened().iter().zip(counts);
        axes.any(|(&still, &counts)| still >= self.limit && counts > LOWEST && counts < HIGHEST)
    }

    /// Whether an axis has stood still for too long.
    #[inline(always)]
    pub fn stuck(&self) -> bool {
        self.stuck
    }
}

/// Counts each axis's looks since it last moved; the largest of the three.
#[inline(always)]
fn count(still: &mut [u32; 3], last: [i16; 3], now: [i16; 3]) -> u32 {
    let mut longest = 0;
    for ((still, last), now) in still.iter_mut().zip(last).zip(now) {
        // At the highest rate it takes a day and a half to wrap, and then the axis is found again in a tenth of a second.
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
        /// From the whole past: an axis is stuck if its last looks, as many as fit into a tenth of a second, were all
        /// alike and not at an end of the range. The verdict is given when the sensor has its turn.
        #[test]
        fn stuck_is_who_reads_the_same_for_a_tenth_of_a_second(
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
            // A look is at every other sample. Equal to the one before it: of n + 1 looks alike, n are.
            let limit = ((0.5 * f64::from(rate_hz) * 0.1) as usize).max(50);

            let mut looks: [Vec<[i16; 3]>; 2] = [std::vec![[0; 3]], std::vec![[0; 3]]];
            let (mut step, mut stuck) = (0_usize, false);
            for (held, times) in runs {
                for _ in 0..times {
                    let axis = |index: usize| held[index].unwrap_or(100 + (step as i16 & 0xff) * 7 + index as i16);
                    let sample = ImuSample { gyro: [axis(0), axis(1), axis(2)], accel: [axis(3), axis(4), axis(5)] };
                    ours.take(&sample);
                    let turn = step % 2;
                    let (checked, now) = if turn == 0 { (gyro_checked, sample.gyro) } else { (accel_checked, sample.accel) };
                    if checked {
                        looks[turn].push(now);
                        let alike = |looks: &[[i16; 3]], axis: usize| {
                            let last = looks[looks.len() - 1][axis];
                            let run = looks.iter().rev().take_while(|look| look[axis] == last).count() - 1;
                            run >= limit && !ENDS.contains(&last)
                        };
                        stuck = looks.iter().any(|looks| (0..3).any(|axis| alike(looks, axis)));
                    }
                    prop_assert_eq!(ours.stuck(), stuck, "at {}", step);
                    step += 1;
                }
            }
        }

        #[test]
        fn one_count_that_is_not_the_code_makes_a_sample(axis in 0..6_usize, counts in any::<i16>()) {
            let mut all = [i16::MIN; 6];
            all[axis] = counts;
            let [a, b, c, d, e, f] = all;
            prop_assert_eq!(ImuCheck::is_valid(&ImuSample { gyro: [a, b, c], accel: [d, e, f] }), counts != i16::MIN);
        }
    }

    /// A chip's and a simulated converter's ends, and what lies between these.
    const ENDS: [i16; 4] = [32_767, -32_766, -32_767, -32_768];

    const BOTH: StuckCheck = StuckCheck { gyro: true, accel: true };

    fn moving(step: i16) -> ImuSample {
        ImuSample { gyro: [step, -step, step ^ 1], accel: [step + 1, step + 2, step + 3] }
    }

    #[test]
    fn any_one_axis_that_stands_still_for_a_tenth_of_a_second_is_stuck() {
        for axis in 0..6 {
            let mut check = ImuCheck::new(BOTH, 1000.0);
            for step in 0..100 {
                check.take(&with_axis(step, axis, 7));
                assert!(!check.stuck(), "axis {axis}, step {step}");
            }
            // Each sensor is looked at in every other sample.
            check.take(&with_axis(100, axis, 7));
            check.take(&with_axis(101, axis, 7));
            assert!(check.stuck(), "axis {axis}");
            check.take(&moving(102));
            check.take(&moving(103));
            assert!(!check.stuck(), "axis {axis} moves again");
        }
    }

    #[test]
    fn a_slow_sensor_is_given_fifty_looks() {
        let mut check = ImuCheck::new(BOTH, 100.0);
        for _ in 0..100 {
            check.take(&moving(2));
            assert!(!check.stuck());
        }
        check.take(&moving(2));
        assert!(check.stuck());
    }

    /// The sample of a vehicle in motion, but for one axis, which reads `counts`.
    fn with_axis(step: i16, axis: usize, counts: i16) -> ImuSample {
        let mut sample = moving(step);
        let ImuSample { gyro, accel } = &mut sample;
        [gyro, accel][axis / 3][axis % 3] = counts;
        sample
    }

    #[test]
    fn an_axis_at_either_end_of_its_range_is_not_stuck() {
        let stuck_at = |axis, counts| {
            let mut check = ImuCheck::new(BOTH, 1000.0);
            (0..1_000).any(|step| {
                check.take(&with_axis(step, axis, counts));
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
    fn a_sensor_without_noise_is_not_checked() {
        let mut ideal = ImuCheck::new(StuckCheck { gyro: false, accel: false }, 1000.0);
        for _ in 0..1_000 {
            ideal.take(&moving(1));
            assert!(!ideal.stuck());
        }
    }

    #[test]
    fn the_code_for_invalid_is_on_all_axes() {
        let invalid = ImuSample { gyro: [i16::MIN; 3], accel: [i16::MIN; 3] };
        assert!(!ImuCheck::is_valid(&invalid));
        assert!(ImuCheck::is_valid(&ImuSample { gyro: [i16::MIN, i16::MIN, -32_767], ..invalid }));
        assert!(ImuCheck::is_valid(&ImuSample::default()));
    }
}
