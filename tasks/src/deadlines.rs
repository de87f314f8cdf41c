//! Deadlines of the tasks: check-ins of the tasks that a flight needs, and missed deadlines.
//!
//! | task or line | checks in: if it is late, the watchdog is not fed | a miss refuses arming | a miss is logged |
//! |---|---|---|---|
//! | `control_loop`, `tick`, `battery` | yes | yes | yes |
//! | the data-ready line | no | yes | yes |
//! | `magnetometer`, `health` | no | no | yes |
//!
//! A flight continues without a magnetometer and without a log. A late run of these tasks must not end the flight, and
//! a hang must not block arming permanently. Both only appear in the log, and in the health line's count.

use core::sync::atomic::{AtomicU32, Ordering};

use flight_core::watchdog::{CheckIns, Deadline, LateTasks};

use crate::clock::Clock;
use crate::counters::COUNTERS;
use crate::{OVERDUE_US, PERIOD_US};

/// A periodic task, or the data-ready line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Task {
    /// `control_loop`.
    Control,
    /// `tick`.
    Tick,
    /// `battery`.
    Battery,
    /// `magnetometer`.
    Magnetometer,
    /// `health`.
    Health,
    /// No task: the IMU's data-ready line.
    DataReady,
}

impl Task {
    /// Returns whether a missed deadline of this task refuses arming: those that a flight needs.
    const fn counts_for_arming(self) -> bool {
        match self {
            Self::Control | Self::Tick | Self::Battery | Self::DataReady => true,
            Self::Magnetometer | Self::Health => false,
        }
    }

    /// Returns the name for the log.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Control => "control_loop",
            Self::Tick => "tick",
            Self::Battery => "battery",
            Self::Magnetometer => "magnetometer",
            Self::Health => "health",
            Self::DataReady => "data ready",
        }
    }
}

/// A task is late if its last check-in is older than this, µs, in the order of [`Task`]: the task's longest period, plus
/// one more period for tasks that another task starts.
const ALLOWED_AGE_US: [u64; 3] = [
    // If a sample is lost, a step without a sample runs OVERDUE_US after the last one. Further such steps follow every
    // PERIOD_US.
    (OVERDUE_US + PERIOD_US) as u64,
    2 * PERIOD_US as u64,
    2 * (BATTERY_TICKS * PERIOD_US) as u64,
];

/// Period of the task `magnetometer`, in ticks of 1 ms.
pub const MAGNETOMETER_TICKS: u32 = 5;
/// Period of the task `battery`, in ticks. `battery` also checks the check-ins and feeds the watchdog.
pub const BATTERY_TICKS: u32 = 20;
/// Period of the task `health`, in ticks.
pub const HEALTH_TICKS: u32 = 1_000;

/// Time that a task may take from start to its first check-in, µs.
const GRACE_US: u64 = 100_000;

/// Deadlines missed since start that count for arming. An atomic, so that a step can read it without a lock;
/// [`DeadlineMonitor`] writes it.
static MISSED: AtomicU32 = AtomicU32::new(0);

/// Returns the number of deadlines missed since start that count for arming.
pub fn missed() -> u32 {
    MISSED.load(Ordering::Relaxed)
}

/// Check-ins of the tasks, and the misses that the log already has.
pub struct DeadlineMonitor {
    check_ins: CheckIns<{ ALLOWED_AGE_US.len() }>,
    clock: Clock,
    /// Bit n: a miss of task n has been logged since the last health line.
    reported: u32,
}

impl DeadlineMonitor {
    /// Returns the monitor before the first check-in, started at `now_us`.
    pub fn new(now_us: u32) -> Self {
        let mut clock = Clock::new();
        Self { check_ins: CheckIns::new(ALLOWED_AGE_US, clock.at(now_us), GRACE_US), clock, reported: 0 }
    }

    /// Records that `task` has finished a run at `now_us`. Returns whether to log a miss.
    pub fn check_in(&mut self, task: Task, deadline: Deadline, now_us: u32) -> bool {
        let now_us = self.clock.at(now_us);
        self.check_ins.check_in(task as usize, deadline, now_us);
        deadline == Deadline::Missed && self.miss(task)
    }

    /// Records that `task` was due before its previous run had finished. Returns whether to log it: true for the first
    /// miss of the task since the last health line.
    pub fn miss(&mut self, task: Task) -> bool {
        if task.counts_for_arming() {
            MISSED.fetch_add(1, Ordering::Relaxed);
        } else {
            COUNTERS.delayed.add();
        }
        let bit = 1 << task as u32;
        let first = self.reported & bit == 0;
        self.reported |= bit;
        first
    }

    /// Starts a new health line: the next miss of each task is logged again.
    pub fn begin_report(&mut self) {
        self.reported = 0;
    }

    /// Checks that every task is on time, so that the watchdog may be fed.
    ///
    /// # Errors
    /// The late tasks.
    pub fn may_feed(&mut self, now_us: u32) -> Result<(), LateTasks> {
        let now_us = self.clock.at(now_us);
        self.check_ins.may_feed(now_us)
    }
}
