//! Logs the sensors' samples for the bench: all raw samples, all calibrated magnetometer samples, and ten calibrated
//! IMU samples a second.
//!
//! A raw line takes 22 bytes on the wire: 1,000 lines a second are 22 kB/s. Lines that the probe does not read in time
//! are dropped as a whole; the times in the remaining lines show the gap.

use core::cell::Cell;

use cortex_m::interrupt::{Mutex, free};
use flight_core::Config;
use flight_core::calibration::{Calibration, SensorFields, SensorModel};
use flight_core::sample::{ImuSample, MagSample};

/// Time from one calibrated IMU sample in the log to the next, ms.
const CALIBRATED_MS: u64 = 100;

/// Logs a step's samples.
pub fn log(time_us: u64, imu: Option<ImuSample>, mag: Option<MagSample>) {
    let us = time_us as u32;
    if let Some(ImuSample { gyro: [p, q, r], accel: [x, y, z] }) = imu {
        defmt::println!("imu {=u32} {=i16} {=i16} {=i16} {=i16} {=i16} {=i16}", us, p, q, r, x, y, z);
    }
    if let Some(MagSample { counts: [x, y, z] }) = mag {
        defmt::println!("mag {=u32} {=i16} {=i16} {=i16}", us, x, y, z);
    }
    let due = (time_us / 1_000).is_multiple_of(CALIBRATED_MS);
    let imu = imu.filter(|_| due);
    if imu.is_none() && mag.is_none() {
        return;
    }
    let models = free(|cs| MODELS.borrow(cs).get());
    let Some([gyro_model, accel_model, mag_model]) = models else { return };
    if let Some(imu) = imu {
        let (w, f) = (gyro_model.apply(imu.gyro), accel_model.apply(imu.accel));
        defmt::println!("rad/s {=u32} {=f32} {=f32} {=f32}", us, w.x, w.y, w.z);
        defmt::println!("m/s2 {=u32} {=f32} {=f32} {=f32}", us, f.x, f.y, f.z);
    }
    if let Some(mag) = mag {
        let b = mag_model.apply(mag.counts);
        defmt::println!("uT {=u32} {=f32} {=f32} {=f32}", us, b.x, b.y, b.z);
    }
}

/// The sensors' models, set by [`begin`].
static MODELS: Mutex<Cell<Option<[SensorModel; 3]>>> = Mutex::new(Cell::new(None));

/// Uses the calibration in `config` for all later samples.
pub fn begin(config: &Config) {
    let models = models(config);
    free(|cs| MODELS.borrow(cs).set(models));
}

fn models(config: &Config) -> Option<[SensorModel; 3]> {
    let calibration = config.calibration.unwrap_or(Calibration::NONE);
    let p = &config.params;
    Some([
        SensorModel::new(SensorFields::GYRO, p.gyro, calibration.gyro).ok()?,
        SensorModel::new(SensorFields::ACCEL, p.accel, calibration.accel).ok()?,
        SensorModel::new(SensorFields::MAG, p.mag, calibration.mag).ok()?,
    ])
}
