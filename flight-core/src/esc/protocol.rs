//! What goes over the wire to an ESC, as counts of a timer.
//!
//! Everything here starts from a pulse on the servo scale, 1,000 µs (stop) to 2,000 µs (full), which is what
//! [`crate::FlightController`] puts out with [`EscParams::STANDARD`]; with any other map the stop pulse would
//! not be where these protocols expect it.
//!
//! | protocol | on the wire | source |
//! |---|---|---|
//! | PWM | the pulse itself, 50 to 400 times a second | ArduPilot, *PWM, OneShot and OneShot125 ESCs* |
//! | OneShot125 | an eighth of it: 125 to 250 µs, once a control step | Betaflight, *Oneshot* |
//! | DShot300 | 16 bits of 3⅓ µs, high for 1.25 µs (0) or 2.5 µs (1) | DShotRMT's README, timing table |
//! | DShot600 | 16 bits of 1⅔ µs, high for 0.625 µs (0) or 1.25 µs (1) | the same |
//!
//! ```text
//!  DShot:  throttle ───11 bits─── │ telemetry │ ──checksum──      highest bit first
//!          0 stop, 48..=2047 run  │ 0 or 1    │ 4 bits
//! ```
//! The values 1 to 47 are commands, among them the reversal of a motor's direction: no pulse gives one of
//! them. The bits of a frame and their checksum come from `dshot-frame` (MIT, `no_std`, no dependencies); its
//! table of duties is not used, because it makes the pulses a third and two thirds of a bit.

use dshot_frame::{Command, Frame, NormalDshot};

use super::EscParams;
use crate::arithmetic::{max, min};
use crate::range::{ConfigError, check};

/// The stop pulse, µs.
pub const STOP_US: f32 = EscParams::STANDARD.stop_us;
/// The longest pulse, µs.
pub const FULL_US: f32 = EscParams::STANDARD.full_us;

/// Which protocol an ESC is driven with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Protocol {
    /// Servo pulses.
    Pwm {
        /// Pulses a second: 50, which every ESC takes, to 400, whose 2,500 µs hold the longest pulse and the
        /// pause behind it.
        rate_hz: f32,
    },
    /// Servo pulses, eight times as fast.
    OneShot125,
    /// Digital, 300 kbit/s.
    DShot300,
    /// Digital, 600 kbit/s.
    DShot600,
}

impl Protocol {
    /// Checks its parameters.
    ///
    /// # Errors
    /// A rate of PWM outside 50 to 400 Hz.
    pub fn validate(&self) -> Result<(), ConfigError> {
        match *self {
            Self::Pwm { rate_hz } => check("esc.protocol.rate_hz", rate_hz, 50.0, 400.0),
            Self::OneShot125 | Self::DShot300 | Self::DShot600 => Ok(()),
        }
    }
}

/// A pulse of `us` in counts of a timer with `per_us` counts a microsecond (up to 32), to the nearest one.
///
/// Whatever comes in, what goes out is a pulse that an ESC understands: values out of range go to the range's
/// ends, and NaN to the stop pulse.
pub fn pwm_counts(us: f32, per_us: f32) -> u16 {
    (within_range(us) * per_us + 0.5) as u16
}

/// As [`pwm_counts`], for OneShot125, with up to 262 counts a microsecond.
pub fn oneshot125_counts(us: f32, per_us: f32) -> u16 {
    pwm_counts(us, per_us / 8.0)
}

fn within_range(us: f32) -> f32 {
    // `max` here returns the limit for a NaN.
    min(max(us, STOP_US), FULL_US)
}

/// A throttle of DShot: stop, or 48 to 2047, and never a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct DshotThrottle(u16);

impl DshotThrottle {
    /// No rotation.
    pub const STOP: Self = Self(0);
    /// The slowest rotation; below are the commands.
    const SLOWEST: f32 = 48.0;
    const FULL: f32 = 2047.0;

    /// For a pulse of `us`: [`Self::STOP`] up to 1,000 µs and for NaN; above, 48 to 2047 in a straight line.
    pub fn from_pulse(us: f32) -> Self {
        let us = within_range(us);
        if us <= STOP_US {
            return Self::STOP;
        }
        const PER_US: f32 = (DshotThrottle::FULL - DshotThrottle::SLOWEST) / (FULL_US - STOP_US);
        Self((Self::SLOWEST + (us - STOP_US) * PER_US + 0.5) as u16)
    }

    /// 0, or 48 to 2047.
    pub fn value(self) -> u16 {
        self.0
    }

    /// The frame with its checksum; `telemetry` asks the ESC to report on its telemetry wire.
    pub fn frame(self, telemetry: bool) -> u16 {
        // The crate counts the throttle from 48 and calls the stop a command.
        let running = self.0.checked_sub(Self::SLOWEST as u16);
        let frame = running.and_then(|speed| Frame::<NormalDshot>::new(speed, telemetry));
        frame.unwrap_or_else(|| Frame::command(Command::MotorStop, telemetry)).inner()
    }
}

/// Timer periods of one DShot frame: 16 bits, and two of silence, so that the line stays low when the last
/// compare value stays in the timer.
pub const DSHOT_SLOTS: usize = 18;

/// The compare values that make a timer play a frame, one for each period of `ticks_per_bit` counts.
///
/// A 1 is high for ¾ of a bit, a 0 for ⅜: of DShot300's 3⅓ µs, 2.5 and 1.25. At 84 MHz a bit of DShot300 has 280
/// counts, one of DShot600 140; half a count is 6 ns.
pub fn dshot_duties(frame: u16, ticks_per_bit: u16) -> [u16; DSHOT_SLOTS] {
    let (zero, one) = bit_duties(ticks_per_bit);
    let mut duties = [0; DSHOT_SLOTS];
    for (duty, bit) in duties.iter_mut().zip((0..u16::BITS).rev()) {
        *duty = if frame >> bit & 1 == 1 { one } else { zero };
    }
    duties
}

/// [`dshot_duties`] of two frames for DMA that plays them side by side: in each word the first frame's duty is the
/// lower half, which comes first in memory.
///
/// Both at once, because that is half of the work: for each word two bits are picked, and two products added.
#[inline]
pub fn dshot_duty_pairs([first, second]: [u16; 2], ticks_per_bit: u16) -> [u32; DSHOT_SLOTS] {
    let (zero, one) = bit_duties(ticks_per_bit);
    // A 0's duty in both halves, and what a 1 has more.
    let zeros = u32::from(zero) * 0x0001_0001;
    let more = u32::from(one - zero);
    let (first, second) = (u32::from(first), u32::from(second));
    let mut duties = [0; DSHOT_SLOTS];
    for (duty, bit) in duties.iter_mut().zip((0..u16::BITS).rev()) {
        *duty = zeros + (first >> bit & 1) * more + (second >> bit & 1) * (more << 16);
    }
    duties
}

/// The duties of a 0 and of a 1.
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
        /// Any pulse and any timer: what goes out is that pulse cut to its range, to half a count; and DShot's
        /// throttle is the one of the same pulse.
        #[test]
        fn counts_of_any_pulse(
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

        /// Of a timer that is too fast or no timer, the counts are those of its 16 bits: the longest, or none.
        #[test]
        fn counts_of_any_timer(us in ANY, per_us in ANY) {
            let exact = f64::from(within_range(us)) * f64::from(per_us);
            let expected = if exact.is_nan() { 0.0 } else { exact.clamp(0.0, 65_535.0) };
            prop_assert!((f64::from(pwm_counts(us, per_us)) - expected).abs() <= 0.51);
        }

        #[test]
        fn any_rate_of_pwm(rate_hz in prop_oneof![0.0..500.0_f32, ANY]) {
            prop_assert_eq!(Protocol::Pwm { rate_hz }.validate().is_ok(), (50.0..=400.0).contains(&rate_hz));
        }

        /// Any frame on any timer: as many highs as bits, each ¾ or ⅜ of a bit to half a count.
        #[test]
        fn duties_of_any_frame(frame in any::<u16>(), ticks in any::<u16>()) {
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
        fn duties_of_two_frames_are_those_of_each(frames: [u16; 2], ticks: u16) {
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

    /// Pulses from below to above the range, closer together than the counts of any timer here.
    fn sweep() -> impl Iterator<Item = f32> {
        (0..=220_000).step_by(if cfg!(miri) { 5_000 } else { 1 }).map(|n| 950.0 + n as f32 * 0.005)
    }

    #[test]
    fn a_pulse_is_one_that_an_esc_understands() {
        let counts = |us| pwm_counts(us, 21.0);
        assert_eq!(counts(1_500.0), 31_500);
        assert_eq!(counts(1_234.56), 25_926);
        for (us, end) in OUT_OF_RANGE {
            assert_eq!(f32::from(counts(us)), 21.0 * end, "{us}");
        }
        assert!(sweep().is_sorted_by_key(counts));
    }

    #[test]
    fn oneshot125_is_an_eighth_of_it() {
        // 125, 187.5 and 250 µs at 84 counts a microsecond.
        for (us, expected) in [(1_000.0, 10_500), (1_500.0, 15_750), (2_000.0, 21_000)] {
            assert_eq!(oneshot125_counts(us, 84.0), expected);
        }
        for (us, end) in OUT_OF_RANGE {
            assert_eq!(f32::from(oneshot125_counts(us, 84.0)), 84.0 / 8.0 * end, "{us}");
        }
        assert!(sweep().is_sorted_by_key(|us| oneshot125_counts(us, 84.0)));
    }

    #[test]
    fn the_rate_of_pwm_is_checked() {
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
        // The stop ends where the pulse does; the next f32 runs.
        assert_eq!((throttle(1_000.0), throttle(1_000.0_f32.next_up())), (0, 48));
        assert_eq!((throttle(1_500.0), throttle(2_000.0)), (1_048, 2_047));
        for (us, end) in OUT_OF_RANGE {
            assert_eq!(throttle(us), if end == STOP_US { 0 } else { 2_047 }, "{us}");
        }
        assert!(sweep().is_sorted_by_key(throttle));
        let reached: BTreeSet<u16> = sweep().map(throttle).collect();
        // Miri's sweep has great gaps.
        assert!(cfg!(miri) || reached.into_iter().eq([0].into_iter().chain(48..=2_047)));
    }

    /// The checksum bit by bit: bit n of it is the parity of the bits n + 4, n + 8 and n + 12 of the frame.
    fn checksum(frame: u16) -> u16 {
        let parity = |n: u16| [4, 8, 12].map(|nibble| frame >> (n + nibble) & 1).iter().sum::<u16>() % 2;
        (0..4).map(|n| parity(n) << n).sum()
    }

    #[test]
    fn dshot_frames_carry_value_telemetry_and_checksum() {
        for value in (0..=2_047).step_by(if cfg!(miri) { 89 } else { 1 }) {
            for telemetry in [false, true] {
                let frame = DshotThrottle(value).frame(telemetry);
                // A command, were it ever to come here, would stop the motor.
                assert_eq!(frame >> 5, if value < 48 { 0 } else { value });
                assert_eq!(frame >> 4 & 1 == 1, telemetry);
                assert_eq!(frame & 0xf, checksum(frame), "{value}");
            }
        }
    }

    /// From the tests of the DShotCodec in martinbudden/Library-MotorMixers, and from those of `dshot-frame`
    /// (998 on its own scale).
    #[test]
    fn published_dshot_frames() {
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
    fn a_dshot_frame_is_played_highest_bit_first_and_then_silence() {
        let duties = dshot_duties(0b1000_0010_1100_0110, 280);
        let (played, silence) = duties.split_at(16);
        assert_eq!(silence, [0, 0]);
        // 1.25 and 2.5 µs at 84 MHz.
        let bits: Vec<u16> =
            played.iter().map(|duty| [105, 210].binary_search(duty).unwrap() as u16).collect();
        assert_eq!(bits, [1, 0, 0, 0, 0, 0, 1, 0, 1, 1, 0, 0, 0, 1, 1, 0]);
        // DShot600: 0.625 µs are 52.5 counts, 1.25 µs are 105.
        let [one, zero, ..] = dshot_duties(0x8000, 140);
        assert_eq!((zero, one), (53, 105));
        // The longest bit of a 16-bit timer does not overflow, and no pulse fills its period.
        for ticks in [8, 140, 281, u16::MAX] {
            let [one, zero, ..] = dshot_duties(0x8000, ticks);
            assert!(0 < zero && zero < one && one < ticks, "{ticks}: {zero}, {one}");
        }
    }
}
