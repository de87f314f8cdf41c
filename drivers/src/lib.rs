//! Drivers of the sensors, on embedded-hal's traits.
//!
//! | module | chip | bus | output |
//! |---|---|---|---|
//! | [`icm42688p`] | TDK ICM-42688-P, gyroscope and accelerometer | SPI | `ImuSample`, 1,000 a second |
//! | [`qmc5883l`] | QST QMC5883L, magnetometer | I2C | `MagSample`, 100 a second |
//!
//! A driver configures its chip as `flight_core::Params::default` expects, or returns a set-up error. After that it
//! returns either a new measurement or a named error: never zeros, and never a sample twice.
//!
//! The board provides the times and decides which code waits for the bus. `sim-host` has register-level models of both
//! chips, and the drivers are tested against them.
#![no_std]
#![forbid(unsafe_code)]
#![warn(missing_docs)]

pub mod icm42688p;
pub mod qmc5883l;
