//! Flies the flash image, unmodified and byte for byte what `cargo flash-fw` programs, on a register-level model of
//! the board, in a scene's world.
//!
//! ```text
//!  scene ──► World (sim-host) ── counts, volts, frames ──► chips ── SPI, I2C, ADC, UART ──► STM32F405 ◄── ELF image
//!              ▲                                                                              │
//!              └── rotors ◄── ESCs ◄──────────── edges at the motor pads ◄────────────────────┘
//! ```
//! | module | what |
//! |---|---|
//! | [`chip`] | the microcontroller: `rigless`'s models of its peripherals, and what they lack |
//! | [`board`] | the wiring table of a board, and the chips at its pins |
//! | [`imu`], [`magnetometer`], [`receiver`] | the chips, with what can go wrong with them |
//! | [`pads`] | what an ESC makes of the edges at its pad |
//! | [`flight`] | the flight: the world on the one side, the board on the other |
//! | [`faults`] | what goes wrong in a flight |
//! | [`firmware`] | the image, checked |
//! | [`vectors`], [`rules`], [`gaps`], [`timing`], [`log`] | what is watched meanwhile |
//!
//! # What this shows, and what it does not
//! The registers are modelled after ST's reference manual by people who had no part in this firmware; what the manual
//! forbids is reported. Time is counted in instructions, [`timing::INSTRUCTIONS_PER_SECOND`]: there are no wait states,
//! no caches and no contention on the bus, and so no cycle is exact. It is not a board.
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
