//! A 32-bit microsecond counter, extended to 64 bits.

/// The extension of a counter that is read at least once in each of its 71 minutes.
#[derive(Default)]
pub struct Clock {
    last: u32,
    total_us: u64,
}

impl Clock {
    /// The 64-bit time of the counter value `count`, which is not earlier than the last one's.
    pub fn extend(&mut self, count: u32) -> u64 {
        self.total_us += u64::from(count.wrapping_sub(self.last));
        self.last = count;
        self.total_us
    }
}
