//! The world that Kestrel's flight code flies in: vehicle, sensors with their errors, pilot; and the
//! recorded world: logs, and the estimators run over them.
#![deny(unsafe_code)]
// Tests may take the C library's functions as a second opinion: see clippy.toml.
#![cfg_attr(test, allow(clippy::disallowed_methods))]
#![warn(missing_docs)]

pub mod attitude_error;
pub mod campaign;
pub mod chart;
pub mod chips;
pub mod command;
pub mod dynamics;
pub mod earth_field;
pub mod effects;
pub mod estimate;
pub mod flight;
pub mod hil;
pub mod identify;
pub mod image;
pub mod interrupt;
pub mod log;
pub mod output_file;
pub mod pilot;
pub mod plan;
pub mod report;
pub mod scene;
pub mod sense;
pub mod sensors;
pub mod state;
