//! What the tests of several crates, and the fuzz targets, have in common: a transmitter, a vehicle on the ground, and any
//! bytes made a flight that keeps the flight controller's promises.

pub mod invariants;
pub mod script;
pub mod still_vehicle;
pub mod wire;
