//! Flies the flash image on a register-level model of the board, in the world of a scene. The image is byte for byte the
//! one that `cargo flash-fw` programs.
//!
//! ```text
//!  scene ──► World (sim-host) ── counts, volts, frames ──► chips ── SPI, I2C, ADC, UART ──► STM32F405 ◄── ELF image
//!              ▲                                                                              │
//!              └── rotors ◄── ESCs ◄──────────── edges at the motor pads ◄────────────────────┘
//! ```
//! | module | content |
//! |---|---|
//! | [`chip`] | the microcontroller: the peripheral models of `rigless`, and additions to them |
//! | [`board`] | the wiring table of a board, and the chips at its pins |
//! | [`imu`], [`magnetometer`], [`rc_receiver`] | the chips, and their faults |
//! | [`pads`] | the ESCs: they decode the edges at the motor pads |
//! | [`flight`] | the flight: connects the simulated world to the board |
//! | [`faults`] | the faults of a flight |
//! | [`firmware`] | the image and its checks |
//! | [`vectors`], [`rules`], [`gaps`], [`timing`], [`log`] | observation of the firmware during the flight |
//!
//! # What this shows, and what it does not show
//! The authors of `rigless`, who had no part in this firmware, modelled the registers after ST's reference manual. The
//! models report accesses that the manual forbids. Time is counted in instructions
//! ([`timing::INSTRUCTIONS_PER_SECOND`]), without wait states, caches or contention on the bus, so the cycle count is not
//! exact. The emulator does not replace a test on a board.
#![forbid(unsafe_code)]
#![warn(missing_docs)]

pub mod board;
pub mod chip;
pub mod faults;
pub mod firmware;
pub mod flight;
pub mod gaps;
pub mod imu;
pub mod log;
pub mod magnetometer;
pub mod pads;
pub mod rc_receiver;
pub mod replay;
pub mod rules;
pub mod timing;
pub mod vectors;
