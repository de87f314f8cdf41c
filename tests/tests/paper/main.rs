//! Tests of the paper's equations that span crates: noise from the simulator's sensors through the flight code. Tests
//! of a single crate are in that crate; `docs/paper.md` lists them, equation by equation.
//!
//! Every figure here is compared with a closed form, and the bound is derived beside it. A bound on random
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
