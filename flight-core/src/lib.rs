//! Everything of Kestrel that flies and touches no hardware.
//!
//! The same code runs on the board inside RTIC tasks, under QEMU, and on the host where `sim-host` plays
//! the world. It reads no clock, allocates nothing, and every number in it is an `f32`, evaluated in one
//! fixed order, so that the three give the same bits.
//!
//! # The chain
//! The modules stand in the order of the data:
//!
//! ```text
//!  Input ──► sample ──► calibration ──► prefilter ──► estimator ──► control ──► mixer ──► esc ──► Output
//!  counts               SI, body axes   30 Hz         attitude      torques     Ω²        µs      + permit
//!               rc ─────────────────────────────────────┴──► arming ──► MotorPermit ───────────────┘
//! ```
//!
//! [`FlightController::step`] joins them, and is the only thing that the firmware and the simulator call.
//!
//! # Conventions
//! World north-east-down, body forward-right-down. Quaternions are Hamilton, scalar first, body to world.
//! Euler angles are yaw, pitch, roll (ZYX). The accelerometer measures specific force: level and at rest it
//! reads (0, 0, −9.80665) m/s². SI units and radians inside; any other unit stands in the name.
//!
//! # Any input
//! No NaN and no infinity leaves this crate, and none stays in its state, whatever comes in: any counts, sticks, supply
//! and times, in any order, under any configuration that [`FlightController::new`] takes; what it does not take it
//! names, with the range. The one number that is kept as it came is the battery's voltage, which is only compared.
//! `tests/any_input` checks it with configurations and flights at random, and the fuzz targets `flight_step` and
//! `hil_frames` with those that a fuzzer finds (`docs/fuzzing.md`).
#![no_std]
#![deny(unsafe_code)]
// Tests may take the C library's functions as a second opinion: see clippy.toml.
#![cfg_attr(test, allow(clippy::disallowed_methods))]
#![warn(missing_docs)]

#[cfg(test)]
extern crate std;

#[allow(unsafe_code)] // one instruction of inline assembly: the core's own square root
pub mod arithmetic;
pub mod arming;
pub mod battery;
pub mod bench;
pub mod calibration;
pub mod config;
pub mod control;
pub mod esc;
pub mod estimator;
pub mod flight_controller;
pub mod geometry;
pub mod imu_check;
pub mod mixer;
pub mod prefilter;
mod range;
pub mod rc;
pub mod record;
pub mod sample;
pub mod tilt_limit;
pub mod watchdog;

pub use arming::{ArmState, MotorPermit};
pub use calibration::Calibration;
pub use config::{Config, ConfigError, Params};
pub use flight_controller::FlightController;
pub use sample::{Input, Output};

/// Standard gravity, m/s² (CGPM 1901).
pub const STANDARD_GRAVITY: f32 = 9.80665;
