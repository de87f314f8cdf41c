//! One step of the flight controller as words: its input and its result.
//!
//! The firmware keeps the last step in RAM at the symbol `FLIGHT_RECORD` (`firmware/src/recorder.rs`). A debug probe
//! or the emulator can read it there, also after a crash. Floating-point numbers are stored as their bits, so a reader
//! gets exactly the input of the flight controller. A host that runs its own flight controller on this input gets the
//! same bits.
//!
//! | word | bits 0 to 7 | 8 to 15 | 16 to 23 | 24 to 31 |
//! |---|---|---|---|---|
//! | 0 | [`VERSION`] | flags, low | flags, high | link status |
//! | 1, 2 | time, µs: low word, then high word | | | |
//! | 3 | gyroscope x | | gyroscope y | |
//! | 4 | gyroscope z | | accelerometer x | |
//! | 5 | accelerometer y | | accelerometer z | |
//! | 6 | magnetometer x | | magnetometer y | |
//! | 7 | magnetometer z | | zero | |
//! | 8 | throttle | | roll | |
//! | 9 | pitch | | yaw | |
//! | 10 | arm switch | | mode switch | |
//! | 11 | battery voltage, V | | | |
//! | 12 | missed deadlines | | | |
//! | 13 to 16 | pulses of rotors 1 to 4, µs | | | |
//! | 17 | state | event: from | to | cause |
//! | 18 to 21 | attitude w, x, y, z | | | |
//!
//! Items of 16 bits take two columns. Sensor and stick values are in counts and ticks, voltage, pulses and attitude
//! are `f32`.
//!
//! Flags, from bit 8 of word 0 upward: IMU sample present, magnetometer sample present, receiver frame present,
//! battery measurement present, event present, motors driven, USB plugged in, maintenance requested, reset by the
//! watchdog. Words and bits of an absent item, and unassigned bits, are zero.
//!
//! Bench commands are not recorded, because no board accepts them.

use core::fmt;

use crate::arming::{ArmState, Cause, Event};
use crate::geometry::{Quaternion, vec3};
use crate::sample::{Battery, Health, ImuSample, Input, LinkStatus, MagSample, RcFrame};

/// Number of words of a record.
pub const WORDS: usize = 22;

/// Version of the layout. Zero is not a version, so memory that was never written is no record.
pub const VERSION: u8 = 1;

const IMU: u32 = 1 << 8;
const MAG: u32 = 1 << 9;
const RC: u32 = 1 << 10;
const BATTERY: u32 = 1 << 11;
const EVENT: u32 = 1 << 12;
const DRIVEN: u32 = 1 << 13;
const USB: u32 = 1 << 14;
const MAINTENANCE: u32 = 1 << 15;
const WATCHDOG_RESET: u32 = 1 << 16;

/// One step of the flight controller.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepRecord {
    /// [`Input::time_us`].
    pub time_us: u64,
    /// [`Input::imu`].
    pub imu: Option<ImuSample>,
    /// [`Input::mag`].
    pub mag: Option<MagSample>,
    /// [`Input::rc`].
    pub rc: Option<RcFrame>,
    /// [`Input::battery`].
    pub battery: Option<Battery>,
    /// [`Input::health`].
    pub health: Health,
    /// Result of the step.
    pub outcome: Outcome,
}

/// The result of a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outcome {
    /// Whether the flight controller issued a permit and the pulses were sent.
    pub driven: bool,
    /// Pulses of the flight controller for rotors 1 to 4, µs.
    pub pulses_us: [f32; 4],
    /// Arm state after the step.
    pub state: ArmState,
    /// Change of the arm state, or a refusal, in this step.
    pub event: Option<Event>,
    /// Attitude after the step, body to world.
    pub attitude: Quaternion<f32>,
}

/// The reason why words are not a valid record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RecordError {
    /// The layout has another version. 0 means that no step has been recorded yet.
    Version(u8),
    /// No arm state has this code.
    State(u8),
    /// No cause has this code.
    Cause(u8),
    /// No link status has this code.
    LinkStatus(u8),
    /// A bit is set that is unassigned or belongs to an absent item.
    Unused,
}

impl fmt::Display for RecordError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Version(0) => write!(f, "no step has been recorded"),
            Self::Version(version) => write!(f, "record version {version}: must be {VERSION}"),
            Self::State(code) => write!(f, "arm state {code}: no such code"),
            Self::Cause(code) => write!(f, "cause {code}: no such code"),
            Self::LinkStatus(code) => write!(f, "link status {code}: no such code"),
            Self::Unused => write!(f, "a bit is set that belongs to no field of this record"),
        }
    }
}

impl core::error::Error for RecordError {}

impl StepRecord {
    /// Creates a record from the input and the result of a step.
    #[inline(always)]
    pub fn new(input: &Input, outcome: &Outcome) -> Self {
        let Input { time_us, imu, mag, rc, battery, bench: _, health } = *input;
        Self { time_us, imu, mag, rc, battery, health, outcome: *outcome }
    }

    /// Returns the input of the flight controller, without a bench command.
    pub fn input(&self) -> Input {
        let Self { time_us, imu, mag, rc, battery, health, .. } = *self;
        Input { time_us, imu, mag, rc, battery, bench: None, health }
    }

    /// Encodes the record into words.
    #[inline(always)]
    pub fn to_words(&self) -> [u32; WORDS] {
        let Outcome { driven, pulses_us, state, event, attitude } = self.outcome;
        let flag = |set: bool, flag: u32| if set { flag } else { 0 };
        let mut head = u32::from(VERSION)
            | flag(self.imu.is_some(), IMU)
            | flag(self.mag.is_some(), MAG)
            | flag(self.rc.is_some(), RC)
            | flag(self.battery.is_some(), BATTERY)
            | flag(event.is_some(), EVENT)
            | flag(driven, DRIVEN)
            | flag(self.health.usb, USB)
            | flag(self.health.maintenance, MAINTENANCE)
            | flag(self.health.watchdog_reset, WATCHDOG_RESET);

        let ImuSample { gyro: [p, q, r], accel: [x, y, z] } = self.imu.unwrap_or_default();
        let MagSample { counts: [mx, my, mz] } = self.mag.unwrap_or_default();
        let (mut sticks, mut switches) = ([0; 2], 0);
        if let Some(rc) = self.rc {
            let [throttle, roll, pitch, yaw] = rc.channels;
            sticks = [pair(throttle, roll), pair(pitch, yaw)];
            switches = pair(rc.arm_switch, rc.mode_switch);
            head |= (rc.status as u32) << 24;
        }
        let mut states = state as u32;
        if let Some(Event { from, to, cause }) = event {
            states |= (from as u32) << 8 | (to as u32) << 16 | (cause as u32) << 24;
        }
        let [one, two, three, four] = pulses_us.map(f32::to_bits);
        let Quaternion { w, v } = attitude;
        [
            head,
            self.time_us as u32,
            (self.time_us >> 32) as u32,
            signed_pair(p, q),
            signed_pair(r, x),
            signed_pair(y, z),
            signed_pair(mx, my),
            signed_pair(mz, 0),
            sticks[0],
            sticks[1],
            switches,
            self.battery.map_or(0, |battery| battery.voltage_v.to_bits()),
            self.health.missed_deadlines,
            one,
            two,
            three,
            four,
            states,
            w.to_bits(),
            v.x.to_bits(),
            v.y.to_bits(),
            v.z.to_bits(),
        ]
    }

    /// Decodes a record from words. Decoding the words of a record returns that record bit for bit; all other words
    /// are rejected.
    ///
    /// # Errors
    /// Returns an error for another version, an unknown code, or a bit that is set outside the fields of this record.
    pub fn from_words(words: &[u32; WORDS]) -> Result<Self, RecordError> {
        let &[
            head,
            time_low,
            time_high,
            pq,
            rx,
            yz,
            mxy,
            mz,
            throttle_roll,
            pitch_yaw,
            switches,
            voltage,
            missed_deadlines,
            one,
            two,
            three,
            four,
            states,
            qw,
            qx,
            qy,
            qz,
        ] = words;
        let [version, _, _, status] = head.to_le_bytes();
        if version != VERSION {
            return Err(RecordError::Version(version));
        }
        let has = |flag: u32| head & flag != 0;
        let [state, from, to, cause] = states.to_le_bytes();
        let ([p, q], [r, x], [y, z]) = (signed_halves(pq), signed_halves(rx), signed_halves(yz));
        let ([mx, my], [mz, _]) = (signed_halves(mxy), signed_halves(mz));
        let ([throttle, roll], [pitch, yaw]) = (halves(throttle_roll), halves(pitch_yaw));
        let [arm_switch, mode_switch] = halves(switches);
        let rc = RcFrame {
            channels: [throttle, roll, pitch, yaw],
            arm_switch,
            mode_switch,
            status: link_status(status)?,
        };
        let event = Event { from: arm_state(from)?, to: arm_state(to)?, cause: cause_of(cause)? };
        let record = Self {
            time_us: u64::from(time_high) << 32 | u64::from(time_low),
            imu: has(IMU).then_some(ImuSample { gyro: [p, q, r], accel: [x, y, z] }),
            mag: has(MAG).then_some(MagSample { counts: [mx, my, mz] }),
            rc: has(RC).then_some(rc),
            battery: has(BATTERY).then_some(Battery { voltage_v: f32::from_bits(voltage) }),
            health: Health {
                usb: has(USB),
                maintenance: has(MAINTENANCE),
                watchdog_reset: has(WATCHDOG_RESET),
                missed_deadlines,
            },
            outcome: Outcome {
                driven: has(DRIVEN),
                pulses_us: [one, two, three, four].map(f32::from_bits),
                state: arm_state(state)?,
                event: has(EVENT).then_some(event),
                attitude: Quaternion {
                    w: f32::from_bits(qw),
                    v: vec3(f32::from_bits(qx), f32::from_bits(qy), f32::from_bits(qz)),
                },
            },
        };
        if record.to_words() == *words { Ok(record) } else { Err(RecordError::Unused) }
    }
}

#[inline(always)]
fn pair(low: u16, high: u16) -> u32 {
    u32::from(low) | u32::from(high) << 16
}

#[inline(always)]
fn signed_pair(low: i16, high: i16) -> u32 {
    pair(low as u16, high as u16)
}

fn halves(word: u32) -> [u16; 2] {
    [word as u16, (word >> 16) as u16]
}

fn signed_halves(word: u32) -> [i16; 2] {
    halves(word).map(|half| half as i16)
}

fn arm_state(code: u8) -> Result<ArmState, RecordError> {
    ArmState::ALL.get(usize::from(code)).copied().ok_or(RecordError::State(code))
}

fn cause_of(code: u8) -> Result<Cause, RecordError> {
    Cause::ALL.get(usize::from(code)).copied().ok_or(RecordError::Cause(code))
}

fn link_status(code: u8) -> Result<LinkStatus, RecordError> {
    match code {
        0 => Ok(LinkStatus::Good),
        1 => Ok(LinkStatus::FrameLost),
        2 => Ok(LinkStatus::Failsafe),
        _ => Err(RecordError::LinkStatus(code)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::num::f32::ANY;
    use proptest::prelude::*;
    use std::format;

    fn imu() -> impl Strategy<Value = ImuSample> {
        any::<([i16; 3], [i16; 3])>().prop_map(|(gyro, accel)| ImuSample { gyro, accel })
    }

    fn rc() -> impl Strategy<Value = RcFrame> {
        let status =
            prop::sample::select(&[LinkStatus::Good, LinkStatus::FrameLost, LinkStatus::Failsafe][..]);
        (any::<([u16; 4], u16, u16)>(), status).prop_map(|((channels, arm_switch, mode_switch), status)| {
            RcFrame { channels, arm_switch, mode_switch, status }
        })
    }

    fn health() -> impl Strategy<Value = Health> {
        any::<(bool, bool, bool, u32)>().prop_map(|(usb, maintenance, watchdog_reset, missed_deadlines)| {
            Health { usb, maintenance, watchdog_reset, missed_deadlines }
        })
    }

    fn state() -> impl Strategy<Value = ArmState> {
        prop::sample::select(&ArmState::ALL[..])
    }

    fn event() -> impl Strategy<Value = Event> {
        (state(), state(), prop::sample::select(&Cause::ALL[..])).prop_map(|(from, to, cause)| Event {
            from,
            to,
            cause,
        })
    }

    fn record() -> impl Strategy<Value = StepRecord> {
        let mag = any::<[i16; 3]>().prop_map(|counts| MagSample { counts });
        let input = (
            any::<u64>(),
            prop::option::of(imu()),
            prop::option::of(mag),
            prop::option::of(rc()),
            prop::option::of(ANY.prop_map(|voltage_v| Battery { voltage_v })),
            health(),
        );
        let outcome = (
            any::<bool>(),
            prop::array::uniform4(ANY),
            state(),
            prop::option::of(event()),
            prop::array::uniform4(ANY),
        );
        (input, outcome).prop_map(
            |((time_us, imu, mag, rc, battery, health), (driven, pulses_us, state, event, [w, x, y, z]))| {
                let input = Input { time_us, imu, mag, rc, battery, bench: None, health };
                let attitude = Quaternion { w, v: vec3(x, y, z) };
                StepRecord::new(&input, &Outcome { driven, pulses_us, state, event, attitude })
            },
        )
    }

    /// The record with its numbers as bits, so that NaNs compare as equal.
    fn bits(record: &StepRecord) -> impl PartialEq + fmt::Debug {
        let StepRecord { time_us, imu, mag, rc, battery, health, outcome } = *record;
        let Outcome { driven, pulses_us, state, event, attitude } = outcome;
        let Quaternion { w, v } = attitude;
        (
            (time_us, imu, mag, rc, battery.map(|battery| battery.voltage_v.to_bits()), health),
            (driven, pulses_us.map(f32::to_bits), state, event, [w, v.x, v.y, v.z].map(f32::to_bits)),
        )
    }

    proptest! {
        #[test]
        fn words_decode_to_the_same_record_bit_for_bit(record in record()) {
            let words = record.to_words();
            let back = StepRecord::from_words(&words);
            prop_assert_eq!(back.as_ref().map(bits), Ok(bits(&record)));
            let again = StepRecord::new(&record.input(), &record.outcome);
            prop_assert_eq!(bits(&again), bits(&record));
        }

        /// Any memory content either is the encoding of exactly one record or is rejected.
        #[test]
        fn corrupt_words_are_rejected_or_encode_a_record(
            record in record(),
            changes in prop::collection::vec((0..WORDS, any::<u32>()), 0..4),
            flips in prop::collection::vec((0..WORDS, 0..u32::BITS), 0..4),
        ) {
            let mut words = record.to_words();
            for (word, value) in changes {
                words[word] = value;
            }
            for (word, bit) in flips {
                words[word] ^= 1 << bit;
            }
            if let Ok(record) = StepRecord::from_words(&words) {
                prop_assert_eq!(record.to_words(), words);
            }
        }
    }

    #[test]
    fn codes_are_indices_into_the_lists() {
        for (code, state) in ArmState::ALL.into_iter().enumerate() {
            assert_eq!(state as usize, code);
        }
        for (code, cause) in Cause::ALL.into_iter().enumerate() {
            assert_eq!(cause as usize, code);
        }
        for status in [LinkStatus::Good, LinkStatus::FrameLost, LinkStatus::Failsafe] {
            assert_eq!(link_status(status as u8), Ok(status));
        }
    }

    #[test]
    fn version_1_layout_is_unchanged() {
        let record = StepRecord {
            time_us: 0x0102_0304_0506_0708,
            imu: Some(ImuSample { gyro: [1, -2, 3], accel: [-4, 5, i16::MIN] }),
            mag: Some(MagSample { counts: [-7, 8, -9] }),
            rc: Some(RcFrame {
                channels: [172, 992, 1811, 993],
                arm_switch: 1812,
                mode_switch: 173,
                status: LinkStatus::Failsafe,
            }),
            battery: Some(Battery { voltage_v: 11.5 }),
            health: Health { usb: false, maintenance: false, watchdog_reset: true, missed_deadlines: 10 },
            outcome: Outcome {
                driven: true,
                pulses_us: [1000.0, 1250.0, 1500.0, 2000.0],
                state: ArmState::Terminated,
                event: Some(Event {
                    from: ArmState::Armed,
                    to: ArmState::Terminated,
                    cause: Cause::TiltLimit,
                }),
                attitude: Quaternion { w: 1.0, v: vec3(-0.5, 0.25, 0.0) },
            },
        };
        let words = [
            0x0201_3f01,
            0x0506_0708,
            0x0102_0304,
            0xfffe_0001,
            0xfffc_0003,
            0x8000_0005,
            0x0008_fff9,
            0x0000_fff7,
            0x03e0_00ac,
            0x03e1_0713,
            0x00ad_0714,
            0x4138_0000,
            10,
            0x447a_0000,
            0x449c_4000,
            0x44bb_8000,
            0x44fa_0000,
            0x1604_0204,
            0x3f80_0000,
            0xbf00_0000,
            0x3e80_0000,
            0,
        ];
        assert_eq!(record.to_words(), words);
        assert_eq!(StepRecord::from_words(&words), Ok(record));
    }

    #[test]
    fn invalid_words_are_rejected_with_the_reason() {
        let outcome = Outcome {
            driven: false,
            pulses_us: [1000.0; 4],
            state: ArmState::Disarmed,
            event: None,
            attitude: Quaternion::IDENTITY,
        };
        let words = StepRecord::new(&Input::default(), &outcome).to_words();
        let changed = |word: usize, value: u32| {
            let mut words = words;
            words[word] |= value;
            StepRecord::from_words(&words).map(|_| ()).map_err(|error| format!("{error}"))
        };
        assert_eq!(changed(0, 0), Ok(()));
        let empty = StepRecord::from_words(&[0; WORDS]).unwrap_err();
        assert_eq!(
            (empty, format!("{empty}").as_str()),
            (RecordError::Version(0), "no step has been recorded")
        );
        for (word, value, error) in [
            (0, 2, "record version 3: must be 1"),
            (0, 3 << 24, "link status 3: no such code"),
            (0, 1 << 24, "a bit is set that belongs to no field of this record"),
            (0, 1 << 17, "a bit is set that belongs to no field of this record"),
            (3, 1, "a bit is set that belongs to no field of this record"),
            (17, 7, "arm state 7: no such code"),
            (17, 7 << 8, "arm state 7: no such code"),
            (17, 7 << 16, "arm state 7: no such code"),
            (17, 23 << 24, "cause 23: no such code"),
            (17, 1 << 16, "a bit is set that belongs to no field of this record"),
        ] {
            assert_eq!(changed(word, value), Err(error.into()), "word {word}, {value:#x}");
        }
    }
}
