//! A 32-bit microsecond counter, extended to 64 bits.

/// The extension of a counter that is looked at at least once in each half of its 71 minutes.
#[derive(Clone, Copy, Default)]
pub struct Clock {
    last: u32,
    total_us: u64,
}

impl Clock {
    /// At zero.
    pub const fn new() -> Self {
        Self { last: 0, total_us: 0 }
    }

    /// The 64-bit time of the counter value `count`. It may be older than one that was asked for before: a task
    /// may be interrupted between reading the counter and asking.
    pub fn at(&mut self, count: u32) -> u64 {
        let since_last = count.wrapping_sub(self.last) as i32;
        let at_us = self.total_us.saturating_add_signed(i64::from(since_last));
        if since_last > 0 {
            self.last = count;
            self.total_us = at_us;
        }
        at_us
    }
}
