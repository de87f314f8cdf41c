//! Who is on time: the check-ins of the tasks that a flight needs, and the deadlines that were missed.
//!
//! | | on the check-ins: without it the watchdog is not fed | counts for arming | logged |
//! |---|---|---|---|
//! | `control_loop`, `tick`, `battery` | yes | yes | yes |
//! | the data-ready line | no | yes | yes |
//! | `magnetometer`, `health` | no | no | yes |
//!
//! A flight goes on without a magnetometer and without a log. One that is late must not end it; and one that hangs must not
//! make arming impossible for ever: it is shown in the log, and in the health line's count.

use core::sync::atomic::{AtomicU32, Ordering};

use flight_core::watchdog::{CheckIns, Deadline, LateTasks};

use crate::clock::Clock;
use crate::counters::COUNTERS;
use crate::{OVERDUE_US, PERIOD_US};

/// The periodic tasks.
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
    /// No task: the inertial sensor's data-ready line.
    DataReady,
}

impl Task {
    /// Whether a flight needs it, so that nobody arms while it is late.
    const fn is_needed(self) -> bool {
        match self {
            Self::Control | Self::Tick | Self::Battery | Self::DataReady => true,
            Self::Magnetometer | Self::Health => false,
        }
    }

    /// For people.
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

/// The roll, in the order of [`Task`]: the age of the last check-in at which the task is late, µs. That is its longest
/// period, and as much again for those that are started by another task.
const ALLOWED_AGE_US: [u64; 3] = [
    // A lost sample, and the period of those that stay lost.
    (OVERDUE_US + PERIOD_US) as u64,
    2 * PERIOD_US as u64,
    2 * (BATTERY_TICKS * PERIOD_US) as u64,
];

/// Ticks (1 ms) from one run to the next.
pub const MAGNETOMETER_TICKS: u32 = 5;
/// Likewise; also those from one look at the check-ins to the next, which happens at the turn of `battery`.
pub const BATTERY_TICKS: u32 = 20;
/// Likewise.
pub const HEALTH_TICKS: u32 = 1_000;

/// How long after start a task may take to its first run, µs.
const GRACE_US: u64 = 100_000;

/// Deadlines missed since start, of those that count for arming. An atomic, so that a step may read it without a lock;
/// [`DeadlineMonitor`] writes it.
static MISSED: AtomicU32 = AtomicU32::new(0);

/// Deadlines missed since start, of those that count for arming.
pub fn missed() -> u32 {
    MISSED.load(Ordering::Relaxed)
}

/// The roll, and who was told of.
pub struct DeadlineMonitor {
    check_ins: CheckIns<{ ALLOWED_AGE_US.len() }>,
    clock: Clock,
    /// Bit n: a miss of task n has been told since the last health line.
    reported: u32,
}

impl DeadlineMonitor {
    /// Nobody has checked in yet; it is `now_us`.
    pub fn new(now_us: u32) -> Self {
        let mut clock = Clock::new();
        Self { check_ins: CheckIns::new(ALLOWED_AGE_US, clock.at(now_us), GRACE_US), clock, reported: 0 }
    }

    /// `task` ends a run at `now_us`. Returns whether a person should be told that it was late.
    pub fn check_in(&mut self, task: Task, deadline: Deadline, now_us: u32) -> bool {
        let now_us = self.clock.at(now_us);
        self.check_ins.check_in(task as usize, deadline, now_us);
        deadline == Deadline::Missed && self.miss(task)
    }

    /// `task` was to begin a run, and has not finished the one before. Returns as [`Self::check_in`].
    pub fn miss(&mut self, task: Task) -> bool {
        if task.is_needed() {
            MISSED.fetch_add(1, Ordering::Relaxed);
        } else {
            COUNTERS.delayed.add();
        }
        let bit = 1 << task as u32;
        let tell = self.reported & bit == 0;
        self.reported |= bit;
        tell
    }

    /// A health line has been written: misses are told again.
    pub fn begin_report(&mut self) {
        self.reported = 0;
    }

    /// Whether everybody is on time, and if not, who is late.
    ///
    /// # Errors
    /// Somebody is late.
    pub fn may_feed(&mut self, now_us: u32) -> Result<(), LateTasks> {
        let now_us = self.clock.at(now_us);
        self.check_ins.may_feed(now_us)
    }
}
