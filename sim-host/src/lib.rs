//! The simulator that Kestrel's flight code flies in: vehicle, sensors with their errors, and pilot. It also reads logs
//! and recordings: it runs the estimators over them and identifies sensor errors from them.
//!
//! # Example
//! One flight of a built-in scene:
//!
//! ```
//! use sim_host::flight::Flight;
//! use sim_host::scene::Scene;
//!
//! let scene = Scene::load("hover")?;
//! let outcome = Flight::new(&scene, 7).run(&mut ());
//! assert!(outcome.crash.is_none() && outcome.attitude_rmse_deg < 0.4);
//! # Ok::<(), input::InputError>(())
//! ```
//!
//! The examples `one_flight` and `own_effect` of this package show an observer and an effect of one's own.
#![deny(unsafe_code)]
// `println!` and `eprintln!` panic if they cannot write: output_file::print and print_note do not.
#![cfg_attr(not(test), deny(clippy::print_stdout, clippy::print_stderr))]
// Tests may compare with the C library's functions: see clippy.toml.
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
pub mod input_file;
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
