//! A 32-bit microsecond counter, extended to 64 bits.

/// The extended counter. It must be read at least once in 35 minutes, which is half of the counter's 71 minutes.
#[derive(Clone, Copy, Default)]
pub struct Clock {
    last: u32,
    total_us: u64,
}

impl Clock {
    /// Returns a clock at zero.
    pub const fn new() -> Self {
        Self { last: 0, total_us: 0 }
    }

    /// Returns the 64-bit time, µs, of the counter value `count`. `count` may be older than the last one, because an
    /// interrupt may come between reading the counter and this call.
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
