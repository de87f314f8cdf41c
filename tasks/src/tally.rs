//! Counts since the last health line, one for each thing that a person may want to know of.
//!
//! Every task counts without asking: each count is an atomic of its own. Two that belong together may come in two
//! different lines, which is all right for people.

use core::sync::atomic::{AtomicU32, Ordering};

/// A count, or the largest of some values.
#[derive(Default)]
pub struct Count(AtomicU32);

impl Count {
    const fn new() -> Self {
        Self(AtomicU32::new(0))
    }

    /// One more.
    pub fn add(&self) {
        self.add_all(1);
    }

    /// So many more.
    pub fn add_all(&self, more: u32) {
        self.0.fetch_add(more, Ordering::Relaxed);
    }

    /// `value`, if it is the largest so far.
    pub fn most(&self, value: u32) {
        self.0.fetch_max(value, Ordering::Relaxed);
    }

    /// `value`, whatever came before.
    pub fn set(&self, value: u32) {
        self.0.store(value, Ordering::Relaxed);
    }

    /// The value, which begins anew.
    pub fn take(&self) -> u32 {
        self.0.swap(0, Ordering::Relaxed)
    }
}

/// All of them.
pub struct Tally {
    /// Steps without an inertial sample, because none could be read.
    pub lost: Count,
    /// Reads without an edge of the data-ready line.
    pub polled: Count,
    /// Those that came while the one before was still being read or worked on.
    pub late: Count,
    /// Reads that brought the same sample again.
    pub repeated: Count,
    /// Those that the sensor itself marked as no measurement.
    pub invalid: Count,
    /// Reads that failed on the bus.
    pub unreadable: Count,
    /// Longest time from what woke `flight` to its end, µs.
    pub longest_us: Count,
    /// Steps whose pulses were not sent, because the last ones were on their way.
    pub outputs_dropped: Count,
    /// Pulses that hung or were cut, so that the outputs were set up anew.
    pub outputs_recovered: Count,
    /// Magnetometer samples.
    pub mag: Count,
    /// Accesses to the magnetometer that failed.
    pub mag_errors: Count,
    /// Receiver frames.
    pub rc: Count,
    /// Receiver frames that were damaged.
    pub rc_bad: Count,
    /// Runs of `compass` and `health` that were due while the one before was not done.
    pub delayed: Count,
    /// Battery, mV, as last measured.
    pub battery_mv: Count,
}

/// The counts.
pub static TALLY: Tally = Tally {
    lost: Count::new(),
    polled: Count::new(),
    late: Count::new(),
    repeated: Count::new(),
    invalid: Count::new(),
    unreadable: Count::new(),
    longest_us: Count::new(),
    outputs_dropped: Count::new(),
    outputs_recovered: Count::new(),
    mag: Count::new(),
    mag_errors: Count::new(),
    rc: Count::new(),
    rc_bad: Count::new(),
    delayed: Count::new(),
    battery_mv: Count::new(),
};
