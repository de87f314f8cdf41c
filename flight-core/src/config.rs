//! Everything that can be set, with its defaults and its ranges.

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

/// What a [`crate::FlightController`] is built from.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Config {
    /// What does not change from one vehicle of a type to the next.
    pub params: Params,
    /// What was measured on this vehicle's own sensors; `None` takes them as their datasheets say.
    pub calibration: Option<Calibration>,
}

/// Rates, sensors, filters, airframe and gains.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Params {
    /// Rate of gyroscope and accelerometer, and so of the whole chain, Hz.
    pub imu_rate_hz: f32,
    /// Rate of the magnetometer, Hz.
    pub mag_rate_hz: f32,
    /// Counts of the gyroscope to rad/s.
    pub gyro: Sensitivity,
    /// Counts of the accelerometer to m/s².
    pub accel: Sensitivity,
    /// Counts of the magnetometer to µT.
    pub mag: Sensitivity,
    /// Cutoff of the Butterworth prefilter on all nine axes, Hz; `None` leaves it out.
    pub prefilter_cutoff_hz: Option<f32>,
    /// The complementary filter.
    pub estimator: EstimatorParams,
    /// The vehicle.
    pub airframe: Airframe,
    /// Gains and limits.
    pub control: ControlParams,
    /// Pulses.
    pub esc: EscParams,
    /// The receiver's channels.
    pub channels: ChannelMap,
    /// How the pilot arms.
    pub arm_by: ArmBy,
    /// What is expected of the inertial sensor's noise.
    pub stuck_check: StuckCheck,
    /// Below this voltage a flight may not start, V.
    pub min_arm_voltage_v: f32,
    /// Below this voltage a flight must end, V.
    pub critical_voltage_v: f32,
    /// When the pilot is gone.
    pub descent: DescentParams,
    /// When a motor is turned on the bench.
    pub bench: BenchParams,
}

/// How to come down without a pilot, or on a battery that is nearly empty.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct DescentParams {
    /// Throttle, 0 to 1: a little less than it takes to hover.
    pub throttle: f32,
    /// After this long without a link the motors stop, s.
    pub seconds: f32,
}

impl DescentParams {
    /// OS4 hovers at 0.650 kg · 9.807 m/s² / (4 · 3.13e-5 N s² · 319² rad²/s²) = 0.500. At 95 % of that it sinks
    /// with 5 % of its weight against the air's drag: 0.32 N over 0.25 kg/s is 1.3 m/s. From 38 m that takes
    /// half a minute.
    pub const OS4: Self = Self { throttle: 0.475, seconds: 30.0 };
}

/// ±2,000 °/s over 16 bits: 16.4 LSB/(°/s) (ICM-42688-P datasheet DS-000347, table 1).
const ICM_42688_GYRO_RAD_S: f32 = (core::f64::consts::PI / 180.0 / 16.4) as f32;
/// ±16 g over 16 bits: 2,048 LSB/g (ICM-42688-P datasheet DS-000347, table 2).
const ICM_42688_ACCEL_M_S2: f32 = STANDARD_GRAVITY / 2048.0;
/// ±8 G over 16 bits: 3,000 LSB/G (QMC5883L datasheet, table 2); 1 G is 100 µT.
const QMC5883L_MAG_UT: f32 = 100.0 / 3000.0;

impl Default for Params {
    /// An ICM-42688-P at 1 kHz and a QMC5883L at 100 Hz, mounted along the body's axes, on OS4.
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
            // 3 cells at 3.5 V, and at 3.0 V.
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
    fn the_defaults_are_within_their_ranges() {
        let config = Config { params: Params::default(), calibration: None };
        assert!(crate::FlightController::new(&config).is_ok());
        // The datasheets' full scales: 2,000 °/s at 32,800 counts, 16 g at 32,768, 8 G at 24,000.
        let Params { gyro, accel, mag, .. } = config.params;
        assert!((gyro.per_count * 32_800.0 - 2_000.0_f32.to_radians()).abs() < 1e-5);
        assert!((accel.per_count * 32_768.0 - 16.0 * 9.80665).abs() < 1e-5);
        assert!((mag.per_count * 24_000.0 - 800.0).abs() < 1e-4);
    }
}
