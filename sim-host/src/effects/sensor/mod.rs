//! Errors of three-axis sensors, one file each.
//!
//! What applies to gyroscope, accelerometer and magnetometer alike is written once, in the sensor's SI unit;
//! the tables of a scene differ in the units of their keys.

mod disturbance;
mod hard_iron;
mod motor_current;
mod soft_iron;
#[cfg(test)]
pub(crate) mod testing;
mod white_noise;

pub use disturbance::Disturbance;
pub use hard_iron::HardIron;
pub use motor_current::MotorCurrent;
pub use soft_iron::SoftIron;
pub use white_noise::{AccelWhiteNoise, GyroWhiteNoise, MagWhiteNoise, WhiteNoise};

/// rad in a degree.
pub(crate) const DEG: f64 = std::f64::consts::PI / 180.0;
