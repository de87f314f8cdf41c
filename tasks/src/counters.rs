//! Counts since the last health line, one for each thing that a person may want to know of.
//!
//! Every task counts without asking: each count is an atomic of its own. Two that belong together may come in two
//! different lines, which is all right for people.

use core::sync::atomic::{AtomicU32, Ordering};

/// A count, or the largest of some values.
#[derive(Default)]
pub struct Counter(AtomicU32);

impl Counter {
    const fn new() -> Self {
        Self(AtomicU32::new(0))
    }

    /// One more.
    pub fn add(&self) {
        self.add_n(1);
    }

    /// So many more.
    pub fn add_n(&self, more: u32) {
        self.0.fetch_add(more, Ordering::Relaxed);
    }

    /// `value`, if it is the largest so far.
    pub fn record_max(&self, value: u32) {
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
pub struct Counters {
    /// Steps without an inertial sample, because none could be read.
    pub lost: Counter,
    /// Reads without an edge of the data-ready line.
    pub polled: Counter,
    /// Those that came while the one before was still being read or worked on.
    pub late: Counter,
    /// Reads that brought the same sample again.
    pub repeated: Counter,
    /// Those that the sensor itself marked as no measurement.
    pub invalid: Counter,
    /// Reads that failed on the bus.
    pub unreadable: Counter,
    /// Longest time from what woke `flight` to its end, µs.
    pub longest_us: Counter,
    /// Steps whose pulses were not sent, because the last ones were on their way.
    pub outputs_dropped: Counter,
    /// Pulses that hung or were cut, so that the outputs were set up anew.
    pub outputs_recovered: Counter,
    /// Magnetometer samples.
    pub mag: Counter,
    /// Accesses to the magnetometer that failed.
    pub mag_errors: Counter,
    /// Receiver frames.
    pub rc: Counter,
    /// Receiver frames that were damaged.
    pub rc_bad: Counter,
    /// Runs of `magnetometer` and `health` that were due while the one before was not done.
    pub delayed: Counter,
    /// Battery, mV, as last measured.
    pub battery_mv: Counter,
}

/// The counts.
pub static COUNTERS: Counters = Counters {
    lost: Counter::new(),
    polled: Counter::new(),
    late: Counter::new(),
    repeated: Counter::new(),
    invalid: Counter::new(),
    unreadable: Counter::new(),
    longest_us: Counter::new(),
    outputs_dropped: Counter::new(),
    outputs_recovered: Counter::new(),
    mag: Counter::new(),
    mag_errors: Counter::new(),
    rc: Counter::new(),
    rc_bad: Counter::new(),
    delayed: Counter::new(),
    battery_mv: Counter::new(),
};
