//! Five seconds of fixed input for the same steps on the host and on QEMU.
//!
//! This is not a flight: the loop is open, and the sensors do not react to the motors. The input exercises all stages of the
//! chain with numbers that differ from step to step and are the same on every machine. It uses only integer arithmetic,
//! and each slot is a function of its index.
//!
//! ```text
//!  0 s      at rest: the gyroscope is zeroed
//!  0.75 s   throttle low, yaw full right: checked from 1.76 s, armed at 2.26 s
//!  2.5 s    throttle up, then roll, pitch and yaw commands; the vehicle turns at up to ±180 °/s about each axis
//!  3.0 s    every 61st sample is missing, 5 in a row at 3.5 s, 60 in a row at 3.7 s
//!  4.3 s    150 samples in a row are missing: after 0.1 s the sensor counts as lost, and the motors stop
//!  4.45 s   samples return: the estimator restarts, disarmed
//! ```
//!
//! A slot is a millisecond. If its sample arrives, the slot's step is at its start. If not, the deadline of 1.5 periods runs
//! the step without a sample in the middle of the slot. So each slot has exactly one step.
#![no_std]
#![forbid(unsafe_code)]
#![warn(missing_docs)]

use core::ffi::CStr;

use flight_core::calibration::{Calibration, SensorCalibration, SensorFields, SensorModel};
use flight_core::estimator::{Estimator, EstimatorParams};
use flight_core::geometry::Quaternion;
use flight_core::rc::{CENTRE_TICKS, HIGH_TICKS, LOW_TICKS};
use flight_core::sample::{Battery, Health, ImuSample, LinkStatus, MagSample, RcFrame};
use flight_core::{Config, ConfigError, Input, Params};

/// Number of slots, and of steps.
pub const STEPS: u32 = 5_000;
/// Sample period, µs.
pub const PERIOD_US: u32 = 1_000;
/// Number of words with which a step is compared: see [`words`].
pub const WORDS_PER_STEP: usize = 10;

/// Name of the file in the working directory to which the firmware on QEMU writes the words of all steps, little-endian.
pub const WORDS_FILE: &CStr = c"words.bin";

/// Interval of receiver frames, slots: 50 Hz.
const RC_SLOTS: u32 = 20;
/// Interval of magnetometer samples, slots: 100 Hz.
const MAG_SLOTS: u32 = 10;
/// Interval of battery readings, slots: 10 Hz.
const BATTERY_SLOTS: u32 = 100;

/// Returns the configuration of the flight controller on both sides.
pub fn config() -> Config {
    Config { params: Params::default(), calibration: Some(Calibration::NONE) }
}

/// Returns whether the slot's IMU sample arrives.
pub fn sample_arrives(slot: u32) -> bool {
    let lost = match slot {
        3_500..3_505 | 3_700..3_760 | 4_300..4_450 => true,
        3_000..STEPS => slot % 61 == 60,
        _ => false,
    };
    !lost
}

/// Returns the input of the slot's step.
pub fn input(slot: u32) -> Input {
    let start_us = u64::from(slot) * u64::from(PERIOD_US);
    let arrives = sample_arrives(slot);
    let due = |period: u32| slot.is_multiple_of(period);
    Input {
        time_us: if arrives { start_us } else { start_us + u64::from(PERIOD_US / 2) },
        imu: arrives.then(|| imu(slot)),
        mag: due(MAG_SLOTS).then(|| mag(slot)),
        rc: due(RC_SLOTS).then(|| sticks(slot)),
        battery: due(BATTERY_SLOTS).then_some(Battery { voltage_v: 11.5 + (slot & 7) as f32 * 0.0625 }),
        bench: None,
        health: Health::default(),
    }
}

/// Converts a step to words for a comparison bit for bit: the low half of its time, whether the motors were driven, the
/// four pulses at the outputs, and the attitude (w, x, y, z).
pub fn words(
    time_us: u64,
    driven: bool,
    pulses_us: [f32; 4],
    attitude: Quaternion<f32>,
) -> [u32; WORDS_PER_STEP] {
    let [p1, p2, p3, p4] = pulses_us.map(f32::to_bits);
    let [w, x, y, z] = attitude.to_array().map(f32::to_bits);
    [time_us as u32, u32::from(driven), p1, p2, p3, p4, w, x, y, z]
}

/// Returns a digest (FNV-1a, 32 bits) of an estimator's attitudes over the input's motions, with all sensors in each slot.
/// The flight controller runs only one estimator; with this digest all estimators can be compared.
///
/// # Errors
/// A parameter is out of range.
pub fn attitudes_digest(params: &EstimatorParams) -> Result<u32, ConfigError> {
    const DT_S: f32 = PERIOD_US as f32 * 1.0e-6;
    let sensors = config().params;
    let gyro = SensorModel::new(SensorFields::GYRO, sensors.gyro, SensorCalibration::NONE)?;
    let accel = SensorModel::new(SensorFields::ACCEL, sensors.accel, SensorCalibration::NONE)?;
    let field = SensorModel::new(SensorFields::MAG, sensors.mag, SensorCalibration::NONE)?;
    let mut estimator = Estimator::new(params)?;
    let mut digest = 0x811c_9dc5_u32;
    for slot in FLIGHT..STEPS {
        let ImuSample { gyro: rates, accel: force } = imu(slot);
        let mag = field.apply(mag(slot).counts);
        estimator.update(gyro.apply(rates), accel.apply(force), Some(mag), DT_S);
        for byte in estimator.attitude().to_array().map(|x| x.to_bits().to_le_bytes()).as_flattened() {
            digest = (digest ^ u32::from(*byte)).wrapping_mul(0x0100_0193);
        }
    }
    Ok(digest)
}

/// First slot in which the vehicle turns.
pub const FLIGHT: u32 = 2_500;

/// Returns the slot's IMU sample, whether it arrives or not.
pub fn imu(slot: u32) -> ImuSample {
    // These are counts of the chip: 16.4 per °/s, 2,048 per g.
    let (turn, shake) = if slot < FLIGHT { (0, 8) } else { (3_000, 60) };
    let t = slot.saturating_sub(FLIGHT);
    let noise = |channel| jitter(slot, channel, shake);
    ImuSample {
        gyro: [
            triangle(t, 700, turn) + noise(0) + 21,
            triangle(t + 150, 900, turn) + noise(1) - 13,
            triangle(t + 300, 1_300, turn / 2) + noise(2) + 5,
        ],
        accel: [
            triangle(t, 500, turn / 10) + noise(3),
            triangle(t + 100, 600, turn / 10) + noise(4),
            noise(5) - 2_048,
        ],
    }
}

/// Returns the slot's magnetometer sample, whether it is delivered or not.
pub fn mag(slot: u32) -> MagSample {
    // At 30 counts per µT, the field is about 25 µT forward and 41 µT down, with a small rotation.
    let noise = |channel| jitter(slot, channel, 9);
    let t = slot.saturating_sub(FLIGHT);
    MagSample { counts: [750 + noise(6), triangle(t, 2_100, 300) + noise(7), 1_230 + noise(8)] }
}

/// Returns the slot's stick positions, whether a frame is delivered or not.
pub fn sticks(slot: u32) -> RcFrame {
    const C: u16 = CENTRE_TICKS;
    let t = slot.saturating_sub(FLIGHT);
    // After the start, the throttle stays above a quarter, so that the sticks never command arming or disarming.
    let throttle = (LOW_TICKS + 450).saturating_add_signed(triangle(t, 1_600, 300)) + (t / 10) as u16;
    let channels = match slot {
        ..750 => [LOW_TICKS, C, C, C],
        750..1_900 => [LOW_TICKS, C, C, HIGH_TICKS],
        1_900..FLIGHT => [LOW_TICKS, C, C, C],
        _ => {
            let stick = |phase: u32, period: u32, sweep: i16| {
                C.saturating_add_signed(triangle(t + phase, period, sweep))
            };
            // Yaw is in its deadband for half of each second, so that the heading loop runs, too.
            let yaw = if t % 1_000 < 500 { C } else { stick(0, 800, 500) };
            [throttle, stick(0, 1_100, 700), stick(400, 900, 700), yaw]
        }
    };
    RcFrame { channels, arm_switch: LOW_TICKS, mode_switch: LOW_TICKS, status: LinkStatus::Good }
}

/// Returns a triangle wave from 0 through `peak`, `−peak` and back to 0, with this period in slots (a multiple of 4).
fn triangle(t: u32, period: u32, peak: i16) -> i16 {
    let quarter = (period / 4) as i32;
    let phase = (t % period) as i32;
    let saw = if phase < quarter {
        phase
    } else if phase < 3 * quarter {
        2 * quarter - phase
    } else {
        phase - 4 * quarter
    };
    (i32::from(peak) * saw / quarter) as i16
}

/// Returns a number from −`size` to `size` that depends only on slot and channel (the finalizer of MurmurHash3, which is in
/// the public domain).
fn jitter(slot: u32, channel: u32, size: i16) -> i16 {
    let mut h = slot.wrapping_mul(16).wrapping_add(channel);
    h = (h ^ (h >> 16)).wrapping_mul(0x85eb_ca6b);
    h = (h ^ (h >> 13)).wrapping_mul(0xc2b2_ae35);
    h ^= h >> 16;
    let span = 2 * i32::from(size) + 1;
    (((h >> 8) as i32) % span) as i16 - size
}
