//! Shared code of the tests of several crates and of the fuzz targets: a transmitter, a vehicle on the ground, and
//! scripts that turn any bytes into a flight whose invariants are checked. Also the project's pages, and the examples in the
//! help of a program.

pub mod help;
pub mod invariants;
pub mod pages;
pub mod script;
pub mod still_vehicle;
pub mod wire;
