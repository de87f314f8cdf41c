//! What the firmware's tasks decide without touching a register: from the data-ready line to a sample ([`sampling`]), who
//! is on time ([`deadlines`]), and the counts for the log ([`counters`]).
//!
//! It is the same code on every board, and on a host, where it is tested.
#![no_std]
#![forbid(unsafe_code)]
#![warn(missing_docs)]

pub mod clock;
pub mod counters;
pub mod deadlines;
pub mod sampling;

/// Time from one inertial sample to the next, µs: the rate of [`flight_core::Params::default`].
pub const PERIOD_US: u32 = 1_000;

/// How long after a sample the next one counts as overdue, µs; after that, one step in each period.
pub const OVERDUE_US: u32 = PERIOD_US + PERIOD_US / 2;
