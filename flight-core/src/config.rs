//! All parameters of the flight controller, with defaults and ranges.

pub use crate::range::ConfigError;

use crate::STANDARD_GRAVITY;
use crate::bench::BenchParams;
use crate::calibration::{Calibration, Sensitivity};
use crate::control::ControlParams;
use crate::esc::EscParams;
use crate::estimator::EstimatorParams;
use crate::geometry::Mat3;
use crate::imu_check::StuckCheck;
use crate::mixer::Airframe;
use crate::rc::{ArmBy, ChannelMap};

/// The configuration of a [`crate::FlightController`].
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Config {
    /// Parameters of the type of vehicle.
    pub params: Params,
    /// Calibration of the sensors of this vehicle. Without one (`None`) the datasheet values apply, and arming is
    /// refused.
    pub calibration: Option<Calibration>,
}

/// Parameters of a type of vehicle: sample rates, sensors, filters, airframe and gains.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Params {
    /// Sample rate of gyroscope and accelerometer, and so of the whole chain, Hz: 10 to 32,000.
    pub imu_rate_hz: f32,
    /// Sample rate of the magnetometer, Hz: 1 to `imu_rate_hz`.
    pub mag_rate_hz: f32,
    /// Sensitivity and mounting of the gyroscope, rad/s per count.
    pub gyro: Sensitivity,
    /// Sensitivity and mounting of the accelerometer, m/s² per count.
    pub accel: Sensitivity,
    /// Sensitivity and mounting of the magnetometer, µT per count.
    pub mag: Sensitivity,
    /// Cutoff of the Butterworth prefilter on all nine axes, Hz; `None` for no prefilter.
    pub prefilter_cutoff_hz: Option<f32>,
    /// Attitude estimator.
    pub estimator: EstimatorParams,
    /// Rotors, geometry and inertia of the vehicle.
    pub airframe: Airframe,
    /// Gains and limits of the controller.
    pub control: ControlParams,
    /// Pulses of the ESCs.
    pub esc: EscParams,
    /// Assignment of the receiver's channels.
    pub channels: ChannelMap,
    /// How the pilot arms and disarms.
    pub arm_by: ArmBy,
    /// Which sensors of the IMU have enough noise for the stuck-sensor check.
    pub stuck_check: StuckCheck,
    /// Minimum battery voltage for arming, V: 0 to 100.
    pub min_arm_voltage_v: f32,
    /// Battery voltage below which a flight must end, V: 0 to `min_arm_voltage_v`.
    pub critical_voltage_v: f32,
    /// Descent without a pilot.
    pub descent: DescentParams,
    /// Limits of bench mode.
    pub bench: BenchParams,
}

/// Parameters of the descent, which lands without a link to the pilot or with a nearly empty battery.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct DescentParams {
    /// Throttle, 0 to 1: slightly less than in hover.
    pub throttle: f32,
    /// Duration of a descent without a link, after which the motors stop, s: 0.1 to 600.
    pub seconds: f32,
}

impl DescentParams {
    /// OS4 hovers at a throttle of 0.650 kg · 9.807 m/s² / (4 · 3.13e-5 N s² · 319² rad²/s²) = 0.500. At 95 % of that,
    /// 5 % of the weight acts against the drag. 0.32 N divided by 0.25 kg/s gives a sink rate of 1.3 m/s. A descent
    /// from 38 m takes 30 s.
    pub const OS4: Self = Self { throttle: 0.475, seconds: 30.0 };
}

/// The range of ±2,000 °/s has 16 bits, so the sensitivity is 16.4 LSB/(°/s) (ICM-42688-P datasheet DS-000347, table
/// 1).
const ICM_42688_GYRO_RAD_S: f32 = (core::f64::consts::PI / 180.0 / 16.4) as f32;
/// The range of ±16 g has 16 bits, so the sensitivity is 2,048 LSB/g (ICM-42688-P datasheet DS-000347, table 2).
const ICM_42688_ACCEL_M_S2: f32 = STANDARD_GRAVITY / 2048.0;
/// The range is ±8 G in 16 bits, and the sensitivity is 3,000 LSB/G (QMC5883L datasheet, table 2); 1 G is 100 µT.
const QMC5883L_MAG_UT: f32 = 100.0 / 3000.0;

impl Default for Params {
    /// OS4 with an ICM-42688-P at 1 kHz and a QMC5883L at 100 Hz, both mounted along the body axes.
    fn default() -> Self {
        let along_body = |per_count| Sensitivity { per_count, mounting: Mat3::IDENTITY };
        Self {
            imu_rate_hz: 1000.0,
            mag_rate_hz: 100.0,
            gyro: along_body(ICM_42688_GYRO_RAD_S),
            accel: along_body(ICM_42688_ACCEL_M_S2),
            mag: along_body(QMC5883L_MAG_UT),
            prefilter_cutoff_hz: Some(30.0),
            estimator: EstimatorParams::FLIGHT,
            airframe: Airframe::OS4,
            control: ControlParams::OS4,
            esc: EscParams::STANDARD,
            channels: ChannelMap::AETR,
            arm_by: ArmBy::Sticks,
            stuck_check: StuckCheck { gyro: true, accel: true },
            // The battery has 3 cells, with limits of 3.5 V and 3.0 V a cell.
            min_arm_voltage_v: 10.5,
            critical_voltage_v: 9.0,
            descent: DescentParams::OS4,
            bench: BenchParams::STANDARD,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn defaults_are_valid_and_match_the_datasheets() {
        let config = Config { params: Params::default(), calibration: None };
        assert!(crate::FlightController::new(&config).is_ok());
        // Full scales of the datasheets: 2,000 °/s at 32,800 counts, 16 g at 32,768, 8 G at 24,000.
        let Params { gyro, accel, mag, .. } = config.params;
        assert!((gyro.per_count * 32_800.0 - 2_000.0_f32.to_radians()).abs() < 1e-5);
        assert!((accel.per_count * 32_768.0 - 16.0 * 9.80665).abs() < 1e-5);
        assert!((mag.per_count * 24_000.0 - 800.0).abs() < 1e-4);
    }
}
