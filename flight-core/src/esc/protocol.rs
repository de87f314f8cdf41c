//! ESC protocols: conversion of pulses into compare values of a timer.
//!
//! The input is a pulse on the servo scale, 1,000 µs (stop) to 2,000 µs (full). [`crate::FlightController`] puts out
//! this scale with [`EscParams::STANDARD`]; with any other map the stop pulse would not be where these protocols
//! expect it.
//!
//! | protocol | on the wire | source |
//! |---|---|---|
//! | PWM | the pulse itself, 50 to 400 times per second | ArduPilot, *PWM, OneShot and OneShot125 ESCs* |
//! | OneShot125 | an eighth of the pulse, 125 to 250 µs, once per control step | Betaflight, *Oneshot* |
//! | DShot300 | 16 bits of 3⅓ µs, high for 1.25 µs (0) or 2.5 µs (1) | DShotRMT's README, timing table |
//! | DShot600 | 16 bits of 1⅔ µs, high for 0.625 µs (0) or 1.25 µs (1) | the same |
//!
//! ```text
//!  DShot:  throttle ───11 bits─── │ telemetry │ ──checksum──      highest bit first
//!          0 stop, 48..=2047 run  │ 0 or 1    │ 4 bits
//! ```
//! The values 1 to 47 are commands, for example to reverse the direction of a motor. No pulse is converted into one
//! of them. The crate `dshot-frame` (MIT, `no_std`, no dependencies) provides the bits of a frame and their checksum.
//! Its table of duties is not used, because it makes the pulses a third and two thirds of a bit.

use dshot_frame::{Command, Frame, NormalDshot};

use super::EscParams;
use crate::arithmetic::{max, min};
use crate::range::{ConfigError, check};

/// The stop pulse, µs.
pub const STOP_US: f32 = EscParams::STANDARD.stop_us;
/// The longest pulse, µs.
pub const FULL_US: f32 = EscParams::STANDARD.full_us;

/// The protocol that drives an ESC.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Protocol {
    /// Servo pulses.
    Pwm {
        /// Pulse rate, Hz: from 50, which every ESC accepts, to 400, whose period of 2,500 µs holds the longest pulse
        /// and the pause after it.
        rate_hz: f32,
    },
    /// Servo pulses, shortened to an eighth.
    OneShot125,
    /// Digital, 300 kbit/s.
    DShot300,
    /// Digital, 600 kbit/s.
    DShot600,
}

impl Protocol {
    /// Checks the parameters of the protocol.
    ///
    /// # Errors
    /// Returns an error for a PWM rate outside 50 to 400 Hz.
    pub fn validate(&self) -> Result<(), ConfigError> {
        match *self {
            Self::Pwm { rate_hz } => check("esc.protocol.rate_hz", rate_hz, 50.0, 400.0),
            Self::OneShot125 | Self::DShot300 | Self::DShot600 => Ok(()),
        }
    }
}

/// Returns a pulse of `us` (µs) in counts of a timer with `per_us` (up to 32) counts per microsecond, to the nearest
/// count.
///
/// A pulse outside 1,000 to 2,000 µs is limited to that range; NaN gives the stop pulse.
pub fn pwm_counts(us: f32, per_us: f32) -> u16 {
    (clamp_to_range(us) * per_us + 0.5) as u16
}

/// Like [`pwm_counts`], for OneShot125 and up to 262 counts per microsecond.
pub fn oneshot125_counts(us: f32, per_us: f32) -> u16 {
    pwm_counts(us, per_us / 8.0)
}

fn clamp_to_range(us: f32) -> f32 {
    // `max` of `arithmetic` returns the limit for a NaN.
    min(max(us, STOP_US), FULL_US)
}

/// A DShot throttle: 0 (stop) or 48 to 2047, never a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct DshotThrottle(u16);

impl DshotThrottle {
    /// Stop.
    pub const STOP: Self = Self(0);
    /// Throttle value of the slowest rotation; lower values are commands.
    const SLOWEST: f32 = 48.0;
    const FULL: f32 = 2047.0;

    /// Converts a pulse of `us` (µs): up to 1,000 µs and for NaN to [`Self::STOP`], above it linearly to 48 to 2047.
    pub fn from_pulse(us: f32) -> Self {
        let us = clamp_to_range(us);
        if us <= STOP_US {
            return Self::STOP;
        }
        const PER_US: f32 = (DshotThrottle::FULL - DshotThrottle::SLOWEST) / (FULL_US - STOP_US);
        Self((Self::SLOWEST + (us - STOP_US) * PER_US + 0.5) as u16)
    }

    /// Returns the value, 0 or 48 to 2047.
    pub fn value(self) -> u16 {
        self.0
    }

    /// Returns the frame with its checksum. `telemetry` requests a report from the ESC on its telemetry wire.
    pub fn frame(self, telemetry: bool) -> u16 {
        // `dshot-frame` counts the throttle from 48 and treats the stop as a command.
        let running = self.0.checked_sub(Self::SLOWEST as u16);
        let frame = running.and_then(|speed| Frame::<NormalDshot>::new(speed, telemetry));
        frame.unwrap_or_else(|| Frame::command(Command::MotorStop, telemetry)).inner()
    }
}

/// Timer periods of one DShot frame: 16 bits, then two periods of silence, so that the line stays low when the last
/// compare value remains in the timer.
pub const DSHOT_SLOTS: usize = 18;

/// Returns the compare values of a frame, one for each timer period of `ticks_per_bit` counts.
///
/// A 1 is high for ¾ of a bit, a 0 for ⅜: 2.5 µs and 1.25 µs of the 3⅓ µs of DShot300. At 84 MHz a bit of DShot300
/// has 280 counts, a bit of DShot600 140; the rounding of half a count is 6 ns.
pub fn dshot_duties(frame: u16, ticks_per_bit: u16) -> [u16; DSHOT_SLOTS] {
    let (zero, one) = bit_duties(ticks_per_bit);
    let mut duties = [0; DSHOT_SLOTS];
    for (duty, bit) in duties.iter_mut().zip((0..u16::BITS).rev()) {
        *duty = if frame >> bit & 1 == 1 { one } else { zero };
    }
    duties
}

/// Returns the [`dshot_duties`] of two frames for DMA that sends them in parallel. The duty of the first frame is the
/// lower half of each word, which is first in memory.
///
/// Computing both together halves the work: each word takes the selection of two bits and the sum of two products.
#[inline]
pub fn dshot_duty_pairs([first, second]: [u16; 2], ticks_per_bit: u16) -> [u32; DSHOT_SLOTS] {
    let (zero, one) = bit_duties(ticks_per_bit);
    // The duty of a 0 in both halves of a word, and the difference between a 1 and a 0.
    let zeros = u32::from(zero) * 0x0001_0001;
    let more = u32::from(one - zero);
    let (first, second) = (u32::from(first), u32::from(second));
    let mut duties = [0; DSHOT_SLOTS];
    for (duty, bit) in duties.iter_mut().zip((0..u16::BITS).rev()) {
        *duty = zeros + (first >> bit & 1) * more + (second >> bit & 1) * (more << 16);
    }
    duties
}

/// Returns the duties of a 0 and of a 1.
const fn bit_duties(ticks_per_bit: u16) -> (u16, u16) {
    let bit = ticks_per_bit as u32;
    (((bit * 3 + 4) / 8) as u16, ((bit * 6 + 4) / 8) as u16)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;
    use std::vec::Vec;

    use super::*;
    use proptest::num::f32::ANY;
    use proptest::prelude::*;

    proptest! {
        /// For any pulse and any timer: the counts are the pulse limited to its range, to half a count, and the DShot
        /// throttle is the throttle of the same pulse.
        #[test]
        fn any_pulse_is_limited_and_scaled(
            us in prop_oneof![900.0..2100.0_f32, ANY],
            per_us in prop_oneof![1.0..=32.0_f32, Just(32.0), Just(1.0)],
            fast_per_us in prop_oneof![8.0..=262.0_f32, Just(262.0)],
        ) {
            let within = if us.is_nan() { 1_000.0 } else { f64::from(us).clamp(1_000.0, 2_000.0) };
            let near = |counts: u16, exact: f64| (f64::from(counts) - exact).abs() <= 0.5 + 1e-7 * exact;
            prop_assert!(near(pwm_counts(us, per_us), within * f64::from(per_us)));
            prop_assert!(near(oneshot125_counts(us, fast_per_us), within * f64::from(fast_per_us) / 8.0));

            let throttle = DshotThrottle::from_pulse(us).value();
            if within <= 1_000.0 {
                prop_assert_eq!(throttle, 0);
            } else {
                prop_assert!(near(throttle, 48.0 + (within - 1_000.0) * 1.999), "{}: {}", us, throttle);
            }
        }

        /// For a timer that is too fast or an invalid scale, the counts saturate at the 16 bits of the timer: the
        /// largest count or 0.
        #[test]
        fn any_timer_scale_saturates(us in ANY, per_us in ANY) {
            let exact = f64::from(clamp_to_range(us)) * f64::from(per_us);
            let expected = if exact.is_nan() { 0.0 } else { exact.clamp(0.0, 65_535.0) };
            prop_assert!((f64::from(pwm_counts(us, per_us)) - expected).abs() <= 0.51);
        }

        #[test]
        fn pwm_rate_is_accepted_from_50_to_400_hz(rate_hz in prop_oneof![0.0..500.0_f32, ANY]) {
            prop_assert_eq!(Protocol::Pwm { rate_hz }.validate().is_ok(), (50.0..=400.0).contains(&rate_hz));
        }

        /// For any frame and any timer: one high for each bit, ¾ or ⅜ of a bit long to half a count.
        #[test]
        fn any_frame_has_the_duties_of_its_bits(frame in any::<u16>(), ticks in any::<u16>()) {
            let duties = dshot_duties(frame, ticks);
            for (index, duty) in duties.into_iter().enumerate() {
                let share = match index {
                    16.. => 0.0,
                    index if frame & 0x8000 >> index != 0 => 0.75,
                    _ => 0.375,
                };
                prop_assert!((f64::from(duty) - share * f64::from(ticks)).abs() <= 0.5);
            }
        }

        #[test]
        fn duty_pairs_equal_the_duties_of_each_frame(frames: [u16; 2], ticks: u16) {
            let pairs = dshot_duty_pairs(frames, ticks);
            for (index, frame) in frames.into_iter().enumerate() {
                prop_assert_eq!(pairs.map(|pair| (pair >> (16 * index)) as u16), dshot_duties(frame, ticks));
            }
        }
    }

    const OUT_OF_RANGE: [(f32, f32); 7] = [
        (f32::NAN, STOP_US),
        (f32::NEG_INFINITY, STOP_US),
        (-0.0, STOP_US),
        (999.9, STOP_US),
        (2_000.1, FULL_US),
        (f32::MAX, FULL_US),
        (f32::INFINITY, FULL_US),
    ];

    /// Pulses from below to above the range, at smaller steps than the counts of any timer here.
    fn sweep() -> impl Iterator<Item = f32> {
        (0..=220_000).step_by(if cfg!(miri) { 5_000 } else { 1 }).map(|n| 950.0 + n as f32 * 0.005)
    }

    #[test]
    fn pwm_counts_are_limited_and_monotonic() {
        let counts = |us| pwm_counts(us, 21.0);
        assert_eq!(counts(1_500.0), 31_500);
        assert_eq!(counts(1_234.56), 25_926);
        for (us, end) in OUT_OF_RANGE {
            assert_eq!(f32::from(counts(us)), 21.0 * end, "{us}");
        }
        assert!(sweep().is_sorted_by_key(counts));
    }

    #[test]
    fn oneshot125_counts_are_an_eighth() {
        // 125, 187.5 and 250 µs at 84 counts per microsecond.
        for (us, expected) in [(1_000.0, 10_500), (1_500.0, 15_750), (2_000.0, 21_000)] {
            assert_eq!(oneshot125_counts(us, 84.0), expected);
        }
        for (us, end) in OUT_OF_RANGE {
            assert_eq!(f32::from(oneshot125_counts(us, 84.0)), 84.0 / 8.0 * end, "{us}");
        }
        assert!(sweep().is_sorted_by_key(|us| oneshot125_counts(us, 84.0)));
    }

    #[test]
    fn pwm_rate_outside_its_range_is_rejected() {
        let validate = |rate_hz| Protocol::Pwm { rate_hz }.validate();
        for rate_hz in [50.0, 333.0, 400.0] {
            assert_eq!(validate(rate_hz), Ok(()));
        }
        for rate_hz in [0.0, 49.9, 400.1, f32::NAN, f32::INFINITY] {
            assert_eq!(validate(rate_hz).unwrap_err().field, "esc.protocol.rate_hz");
        }
        for other in [Protocol::OneShot125, Protocol::DShot300, Protocol::DShot600] {
            assert_eq!(other.validate(), Ok(()));
        }
    }

    #[test]
    fn dshot_throttle_rises_and_is_never_a_command() {
        let throttle = |us| DshotThrottle::from_pulse(us).value();
        // The stop range ends at 1,000 µs; the next f32 turns the motor.
        assert_eq!((throttle(1_000.0), throttle(1_000.0_f32.next_up())), (0, 48));
        assert_eq!((throttle(1_500.0), throttle(2_000.0)), (1_048, 2_047));
        for (us, end) in OUT_OF_RANGE {
            assert_eq!(throttle(us), if end == STOP_US { 0 } else { 2_047 }, "{us}");
        }
        assert!(sweep().is_sorted_by_key(throttle));
        let reached: BTreeSet<u16> = sweep().map(throttle).collect();
        // The sweep under Miri is too coarse to reach all values.
        assert!(cfg!(miri) || reached.into_iter().eq([0].into_iter().chain(48..=2_047)));
    }

    /// Computes the checksum bit by bit: bit n is the parity of the bits n + 4, n + 8 and n + 12 of the frame.
    fn checksum(frame: u16) -> u16 {
        let parity = |n: u16| [4, 8, 12].map(|nibble| frame >> (n + nibble) & 1).iter().sum::<u16>() % 2;
        (0..4).map(|n| parity(n) << n).sum()
    }

    #[test]
    fn dshot_frames_carry_value_telemetry_and_checksum() {
        for value in (0..=2_047).step_by(if cfg!(miri) { 89 } else { 1 }) {
            for telemetry in [false, true] {
                let frame = DshotThrottle(value).frame(telemetry);
                // The values of commands, which no pulse gives, are sent as a stop.
                assert_eq!(frame >> 5, if value < 48 { 0 } else { value });
                assert_eq!(frame >> 4 & 1 == 1, telemetry);
                assert_eq!(frame & 0xf, checksum(frame), "{value}");
            }
        }
    }

    /// From the tests of DShotCodec in martinbudden/Library-MotorMixers, and from the tests of `dshot-frame` (998 on
    /// its own scale).
    #[test]
    fn dshot_frames_equal_published_ones() {
        for (value, frame) in [
            (0, 0),
            (48, 0x0606),
            (49, 0x0624),
            (1_046, 0b1000_0010_1100_0110),
            (1_048, 0x830b),
            (2_046, 0xffcc),
            (2_047, 0xffee),
        ] {
            assert_eq!(DshotThrottle(value).frame(false), frame, "{value}");
        }
        assert_eq!(DshotThrottle(48 + 998).frame(true) & 0xf, 7);
    }

    #[test]
    fn dshot_frame_is_sent_msb_first_then_silence() {
        let duties = dshot_duties(0b1000_0010_1100_0110, 280);
        let (played, silence) = duties.split_at(16);
        assert_eq!(silence, [0, 0]);
        // 1.25 and 2.5 µs at 84 MHz.
        let bits: Vec<u16> =
            played.iter().map(|duty| [105, 210].binary_search(duty).unwrap() as u16).collect();
        assert_eq!(bits, [1, 0, 0, 0, 0, 0, 1, 0, 1, 1, 0, 0, 0, 1, 1, 0]);
        // DShot600: 0.625 µs is 52.5 counts, 1.25 µs is 105.
        let [one, zero, ..] = dshot_duties(0x8000, 140);
        assert_eq!((zero, one), (53, 105));
        // The longest bit of a 16-bit timer does not overflow, and no pulse fills its whole period.
        for ticks in [8, 140, 281, u16::MAX] {
            let [one, zero, ..] = dshot_duties(0x8000, ticks);
            assert!(0 < zero && zero < one && one < ticks, "{ticks}: {zero}, {one}");
        }
    }
}
