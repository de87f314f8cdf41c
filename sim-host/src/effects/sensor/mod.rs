//! Errors of three-axis sensors. One file for each error.
//!
//! An error that applies to several of gyroscope, accelerometer and magnetometer is written once, in the sensor's SI
//! unit. Only the units of the scene's keys differ.

mod bandwidth;
mod bias_instability;
mod bias_step;
mod constant_bias;
mod disturbance;
mod g_sensitivity;
mod hard_iron;
mod lever_arm;
mod misalignment;
mod motor_current;
mod quantization;
mod rate_ramp;
mod rate_random_walk;
mod saturation;
mod scale_factor;
mod soft_iron;
mod temperature;
#[cfg(test)]
pub(crate) mod testing;
mod turn_on_bias;
mod vibration;
mod white_noise;

pub use bandwidth::Bandwidth;
pub use bias_instability::{AccelBiasInstability, GyroBiasInstability};
pub use bias_step::GyroBiasStep;
pub use constant_bias::{AccelConstantBias, GyroConstantBias};
pub use disturbance::Disturbance;
pub use g_sensitivity::GSensitivity;
pub use hard_iron::HardIron;
pub use lever_arm::LeverArm;
pub use misalignment::Misalignment;
pub use motor_current::MotorCurrent;
pub use quantization::{AccelQuantization, GyroQuantization};
pub use rate_ramp::{AccelRateRamp, GyroRateRamp};
pub use rate_random_walk::{AccelRateRandomWalk, GyroRateRandomWalk};
pub use saturation::{AccelSaturation, GyroSaturation};
pub use scale_factor::ScaleFactor;
pub use soft_iron::SoftIron;
pub use temperature::{AccelTemperature, GyroTemperature};
pub use turn_on_bias::{AccelTurnOnBias, GyroTurnOnBias};
pub use vibration::{AccelVibration, GyroVibration};
pub use white_noise::{AccelWhiteNoise, GyroWhiteNoise, MagWhiteNoise, WhiteNoise};

/// One degree in rad.
pub(crate) const DEG: f64 = std::f64::consts::PI / 180.0;
