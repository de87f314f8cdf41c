//! One step as words: what the flight controller was given, and what it answered.
//!
//! The firmware keeps the last step in RAM at the symbol `FLIGHT_RECORD` (`firmware/src/recorder.rs`), where a debug
//! probe or an emulator reads it, also after a crash. Numbers travel as their bits: what is read is exactly what the
//! flight controller saw, and a host that steps its own flight controller with it gets the same bits.
//!
//! | word | bits 0 to 7 | 8 to 15 | 16 to 23 | 24 to 31 |
//! |---|---|---|---|---|
//! | 0 | [`VERSION`] | flags, low | flags, high | link status |
//! | 1, 2 | time, µs: low word, high word | | | |
//! | 3 to 5 | gyroscope x, y, z, accelerometer x, y, z: | two of them | in each word, | the first one low |
//! | 6, 7 | magnetometer x, y | z, zero | | |
//! | 8 to 10 | throttle, roll | pitch, yaw | arm switch, mode switch | |
//! | 11 | battery, V | | | |
//! | 12 | missed deadlines | | | |
//! | 13 to 16 | pulses of rotors 1 to 4, µs | | | |
//! | 17 | state | event: from | to | cause |
//! | 18 to 21 | attitude w, x, y, z | | | |
//!
//! Flags, from bit 8 of word 0: there is an inertial sample, a magnetometer sample, a receiver frame, a battery, an
//! event; the motors were driven; USB, maintenance, reset by the watchdog. What is not there, and what has no field,
//! is zero.
//!
//! A bench command is not in it: no board takes one.

use core::fmt;

use crate::arming::{ArmState, Cause, Event};
use crate::geometry::{Quaternion, vec3};
use crate::sample::{Battery, Health, ImuSample, Input, LinkStatus, MagSample, RcFrame};

/// Words of a record.
pub const WORDS: usize = 22;

/// Version of their layout. Zero is none: memory that was never written is no record.
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
    /// What came of it.
    pub outcome: Outcome,
}

/// What came of a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outcome {
    /// The flight controller gave a permit, and the pulses went out with it.
    pub driven: bool,
    /// The flight controller's pulses of rotors 1 to 4, µs.
    pub pulses_us: [f32; 4],
    /// The arm state after the step.
    pub state: ArmState,
    /// What happened to it, if anything did.
    pub event: Option<Event>,
    /// The attitude after the step.
    pub attitude: Quaternion<f32>,
}

/// Why words are no record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RecordError {
    /// The layout has another version. 0: nothing has been recorded yet.
    Version(u8),
    /// There is no arm state of this number.
    State(u8),
    /// There is no cause of this number.
    Cause(u8),
    /// There is no link status of this number.
    LinkStatus(u8),
    /// A bit is set that belongs to no field, or to one that is not there.
    Unused,
}

impl fmt::Display for RecordError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Version(0) => write!(f, "no step has been recorded"),
            Self::Version(version) => write!(f, "version {version} of the record, and this is {VERSION}"),
            Self::State(code) => write!(f, "no arm state has the number {code}"),
            Self::Cause(code) => write!(f, "no cause has the number {code}"),
            Self::LinkStatus(code) => write!(f, "no link status has the number {code}"),
            Self::Unused => write!(f, "a bit is set that belongs to no field"),
        }
    }
}

impl core::error::Error for RecordError {}

impl StepRecord {
    /// What a step was given, and what came of it.
    #[inline(always)]
    pub fn new(input: &Input, outcome: &Outcome) -> Self {
        let Input { time_us, imu, mag, rc, battery, bench: _, health } = *input;
        Self { time_us, imu, mag, rc, battery, health, outcome: *outcome }
    }

    /// What the flight controller was given.
    pub fn input(&self) -> Input {
        let Self { time_us, imu, mag, rc, battery, health, .. } = *self;
        Input { time_us, imu, mag, rc, battery, bench: None, health }
    }

    /// The record as words.
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

    /// The record of words: every record's own words give that record, bit for bit, and no other words give any.
    ///
    /// # Errors
    /// Another version, a number that stands for nothing, or a bit that no field has.
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
        let given = (
            any::<u64>(),
            prop::option::of(imu()),
            prop::option::of(mag),
            prop::option::of(rc()),
            prop::option::of(ANY.prop_map(|voltage_v| Battery { voltage_v })),
            health(),
        );
        let answered = (
            any::<bool>(),
            prop::array::uniform4(ANY),
            state(),
            prop::option::of(event()),
            prop::array::uniform4(ANY),
        );
        (given, answered).prop_map(
            |((time_us, imu, mag, rc, battery, health), (driven, pulses_us, state, event, [w, x, y, z]))| {
                let input = Input { time_us, imu, mag, rc, battery, bench: None, health };
                let attitude = Quaternion { w, v: vec3(x, y, z) };
                StepRecord::new(&input, &Outcome { driven, pulses_us, state, event, attitude })
            },
        )
    }

    /// The record with its numbers as bits, so that NaNs compare.
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
        fn words_give_the_record_back_bit_for_bit(record in record()) {
            let words = record.to_words();
            let back = StepRecord::from_words(&words);
            prop_assert_eq!(back.as_ref().map(bits), Ok(bits(&record)));
            let again = StepRecord::new(&record.input(), &record.outcome);
            prop_assert_eq!(bits(&again), bits(&record));
        }

        /// Whatever memory holds: a record has its own words and no others.
        #[test]
        fn any_words_are_a_records_own_or_refused(
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
    fn codes_are_places_in_the_lists() {
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
    fn version_1_of_the_layout_is_what_it_was() {
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
    fn what_is_no_record_is_refused_by_name() {
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
            (0, 2, "version 3 of the record, and this is 1"),
            (0, 3 << 24, "no link status has the number 3"),
            (0, 1 << 24, "a bit is set that belongs to no field"),
            (0, 1 << 17, "a bit is set that belongs to no field"),
            (3, 1, "a bit is set that belongs to no field"),
            (17, 7, "no arm state has the number 7"),
            (17, 7 << 8, "no arm state has the number 7"),
            (17, 7 << 16, "no arm state has the number 7"),
            (17, 23 << 24, "no cause has the number 23"),
            (17, 1 << 16, "a bit is set that belongs to no field"),
        ] {
            assert_eq!(changed(word, value), Err(error.into()), "word {word}, {value:#x}");
        }
    }
}
