//! Counts of the flight task's last second, for the health line.

use crate::board::PERIOD_US;

/// Steps from one report to the next: a second.
const STEPS_PER_REPORT: u32 = 1_000_000 / PERIOD_US;

/// Counts since the last report.
#[derive(Default)]
pub struct Tally {
    steps: u32,
    missing: u32,
    busiest_us: u32,
}

/// What a second came to.
#[derive(Clone, Copy, defmt::Format)]
pub struct Report {
    /// Steps that ran without an inertial sample.
    pub missing: u32,
    /// The longest time that the flight task took, from waking to done, µs.
    pub busiest_us: u32,
}

impl Tally {
    /// Counts a step; every thousandth returns the report.
    pub fn count(&mut self, sampled: bool, busy_us: u32) -> Option<Report> {
        self.steps += 1;
        self.missing += u32::from(!sampled);
        self.busiest_us = self.busiest_us.max(busy_us);
        if self.steps < STEPS_PER_REPORT {
            return None;
        }
        let Self { missing, busiest_us, .. } = core::mem::take(self);
        Some(Report { missing, busiest_us })
    }
}
