//! The flight-control algorithms of Kestrel, without any hardware access.
//!
//! The same code runs on the board inside RTIC tasks, under QEMU, and on the host, where `sim-host` simulates the
//! vehicle. It reads no clock and allocates no memory. Every number is an `f32`, evaluated in one fixed order, so
//! that all three environments produce the same bits.
//!
//! # The chain
//! The modules below follow the order of the data:
//!
//! ```text
//!  Input ──► sample ──► calibration ──► prefilter ──► estimator ──► control ──► mixer ──► esc ──► Output
//!  counts               SI, body axes   30 Hz         attitude      torques     Ω²        µs      + permit
//!               rc ─────────────────────────────────────┴──► arming ──► MotorPermit ───────────────┘
//! ```
//!
//! [`FlightController::step`] runs the whole chain. It is the only function that the firmware and the simulator call
//! in each control step.
//!
//! # Example
//! One step of a flight controller, with a sample of a vehicle that lies level and at rest:
//!
//! ```
//! use flight_core::sample::{Health, ImuSample};
//! use flight_core::{ArmState, Config, FlightController, Input, Params};
//!
//! let config = Config { params: Params::default(), calibration: None };
//! let mut controller = FlightController::new(&config)?;
//! let output = controller.step(&Input {
//!     time_us: 1_000,
//!     // Counts: ±16 g over 16 bits, so that 2,048 counts are 1 g. At rest, specific force points up; z points down.
//!     imu: Some(ImuSample { gyro: [1, -1, 0], accel: [3, -2, -2_048] }),
//!     mag: None,
//!     rc: None,
//!     battery: None,
//!     bench: None,
//!     health: Health::default(),
//! });
//! assert_eq!(output.state, ArmState::Disarmed);
//! assert!(output.permit.is_none(), "without a permit no motor may be driven");
//! # Ok::<(), flight_core::ConfigError>(())
//! ```
//!
//! The package `examples/no-std` is a whole program without the standard library.
//!
//! # Conventions
//! World axes are north-east-down, body axes forward-right-down. Quaternions are Hamilton quaternions, scalar first,
//! and rotate body vectors into world axes. Euler angles are yaw, pitch, roll (ZYX). The accelerometer measures
//! specific force: level and at rest it reads (0, 0, −9.80665) m/s². Quantities are in SI units and radians; a name
//! states any other unit.
//!
//! # Invalid input
//! No NaN and no infinity leaves this crate or stays in its state. This holds for any counts, sticks, battery
//! voltages and times, in any order, under every configuration that [`FlightController::new`] accepts.
//! `FlightController::new` rejects every other configuration with an error that names the parameter and its range.
//! One number is stored unchecked: the battery voltage, which is only compared with limits.
//!
//! `tests/any_input` checks this with random configurations and flights; the fuzz targets `flight_step` and
//! `hil_frames` check it with fuzzer input (`docs/fuzzing.md`).
#![no_std]
#![deny(unsafe_code)]
// Tests may compare against the C library's functions: see clippy.toml.
#![cfg_attr(test, allow(clippy::disallowed_methods))]
#![warn(missing_docs)]

#[cfg(test)]
extern crate std;

#[allow(unsafe_code)] // one instruction of inline assembly: the square root of the FPU
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
