//! Error against computing time ([`cost`]), and the paper's tables and figures reproduced ([`paper`]).
//!
//! Both compare the flight code and the simulator with methods that the firmware does not use. Dependencies that only
//! these studies need are built with this crate, not with `sim-host`.
#![deny(unsafe_code)]
// Tests may compare with the C library's functions: see clippy.toml.
#![cfg_attr(test, allow(clippy::disallowed_methods))]
#![warn(missing_docs)]

pub mod cost;
pub mod paper;
