//! The paper's equations where they span crates: noise from the simulator's sensors through the code that
//! flies. What one crate can test by itself stands there; `docs/paper.md` says where, equation by equation.
//!
//! Every figure here is checked against a closed form, with the bound derived beside it. A bound on random
//! numbers is five standard errors, and the seeds are fixed.

mod allan;
mod complementary;
mod in_flight;
mod magnetometer;
mod prefilter;
mod rotors;
mod spread;
mod still;
mod strapdown;
