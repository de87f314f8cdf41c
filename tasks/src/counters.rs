//! Counters for the log's health line, counted since the last line.
//!
//! Each counter is an atomic of its own, so that every task can count without a lock. Two related counts may therefore
//! appear in different lines, which is acceptable for a log.

use core::sync::atomic::{AtomicU32, Ordering};

/// A count, or a maximum.
#[derive(Default)]
pub struct Counter(AtomicU32);

impl Counter {
    const fn new() -> Self {
        Self(AtomicU32::new(0))
    }

    /// Adds one.
    pub fn add(&self) {
        self.add_n(1);
    }

    /// Adds `more`.
    pub fn add_n(&self, more: u32) {
        self.0.fetch_add(more, Ordering::Relaxed);
    }

    /// Keeps `value` if it is the largest since the last [`Self::take`].
    pub fn record_max(&self, value: u32) {
        self.0.fetch_max(value, Ordering::Relaxed);
    }

    /// Replaces the value.
    pub fn set(&self, value: u32) {
        self.0.store(value, Ordering::Relaxed);
    }

    /// Returns the value and resets it to zero.
    pub fn take(&self) -> u32 {
        self.0.swap(0, Ordering::Relaxed)
    }
}

/// All counters.
pub struct Counters {
    /// Number of steps without an IMU sample because none could be read.
    pub lost: Counter,
    /// Number of bursts that were started without an edge of the data-ready line.
    pub polled: Counter,
    /// Number of samples that became ready while the previous one was being read or processed.
    pub late: Counter,
    /// Bursts that returned the previous sample again.
    pub repeated: Counter,
    /// Samples that the IMU marked as invalid.
    pub invalid: Counter,
    /// Bursts that failed on the bus.
    pub unreadable: Counter,
    /// Longest time from the wake-up of `control_loop` to its end, µs.
    pub longest_us: Counter,
    /// Number of steps whose pulses were not sent, because the previous ones were still being sent.
    pub outputs_dropped: Counter,
    /// Number of restarts of the outputs after a pulse or frame that hung or was cut short.
    pub outputs_recovered: Counter,
    /// Magnetometer samples.
    pub mag: Counter,
    /// Failed accesses to the magnetometer, and samples out of its range.
    pub mag_errors: Counter,
    /// Valid receiver frames.
    pub rc: Counter,
    /// Damaged receiver frames.
    pub rc_bad: Counter,
    /// Number of runs of `magnetometer` and `health` that were due before the previous run had finished.
    pub delayed: Counter,
    /// Battery voltage as last measured, mV.
    pub battery_mv: Counter,
}

/// The counters of this image.
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
