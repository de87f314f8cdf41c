//! Drivers of the sensors, on embedded-hal's traits: what each chip must be told, and what its bytes mean.
//!
//! | module | chip | bus | gives |
//! |---|---|---|---|
//! | [`icm42688p`] | TDK ICM-42688-P, gyroscope and accelerometer | SPI | `ImuSample`, 1,000 a second |
//! | [`qmc5883l`] | QST QMC5883L, magnetometer | I2C | `MagSample`, 100 a second |
//!
//! A driver leaves a chip as `flight_core::Params::default` expects it, or says why it could not. From then
//! on it hands out what the chip measured, or a named error, and never anything else: no zeros, no sample
//! twice.
//!
//! Where the time comes from and who waits for the bus is the board's business. `sim-host` has both chips,
//! register by register, for these drivers to be tested against.
#![no_std]
#![forbid(unsafe_code)]
#![warn(missing_docs)]

pub mod icm42688p;
pub mod qmc5883l;
