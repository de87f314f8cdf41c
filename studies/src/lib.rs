//! What accuracy costs in time ([`cost`]), and the paper's tables and figures made again ([`paper`]).
//!
//! Both compare the flight code and the simulator with methods that nobody flies. What only these need is built with
//! this crate, and not with `sim-host`.
#![deny(unsafe_code)]
// Tests may take the C library's functions as a second opinion: see clippy.toml.
#![cfg_attr(test, allow(clippy::disallowed_methods))]
#![warn(missing_docs)]

pub mod cost;
pub mod paper;
