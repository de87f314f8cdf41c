//! The parts of the firmware's tasks that touch no register: from the data-ready line to a sample ([`sampling`]), the
//! deadlines of the tasks ([`deadlines`]), and the counters for the log ([`counters`]).
//!
//! The code is the same on every board and on a host, where it is tested.
#![no_std]
#![forbid(unsafe_code)]
#![warn(missing_docs)]

pub mod clock;
pub mod counters;
pub mod deadlines;
pub mod sampling;

/// Time from one IMU sample to the next, µs: the rate of [`flight_core::Params::default`].
pub const PERIOD_US: u32 = 1_000;

/// Time after a sample at which the next one is overdue, µs. From then on the control loop runs one step in each
/// period.
pub const OVERDUE_US: u32 = PERIOD_US + PERIOD_US / 2;
