//! Two named pipes in QEMU's working directory, by semihosting.

use core::ffi::CStr;

use cortex_m_semihosting::{nr, syscall};

const DOWN: &CStr = c"hil-down.fifo";
const UP: &CStr = c"hil-up.fifo";

/// The two pipes and the receive buffer.
pub struct Transport {
    down: usize,
    up: usize,
    /// Received bytes; those from `next` to `end` have not been processed yet.
    bytes: [u8; 256],
    next: usize,
    end: usize,
}

impl Transport {
    /// Opens both pipes, and waits for the other end of each.
    pub fn open() -> Self {
        Self {
            down: open(DOWN, nr::open::R_BINARY),
            up: open(UP, nr::open::W_TRUNC_BINARY),
            bytes: [0; 256],
            next: 0,
            end: 0,
        }
    }

    /// Receives bytes and passes them to `take` until it returns a value.
    pub fn receive<T>(&mut self, mut take: impl FnMut(u8) -> Option<T>) -> T {
        loop {
            while self.next < self.end {
                let byte = self.bytes[self.next];
                self.next += 1;
                if let Some(found) = take(byte) {
                    return found;
                }
            }
            // SAFETY: the length is that of the buffer.
            let left = unsafe { syscall!(READ, self.down, self.bytes.as_mut_ptr(), self.bytes.len()) };
            // A pipe returns the available bytes, never more than the requested number.
            (self.next, self.end) = (0, self.bytes.len().saturating_sub(left));
            assert_ne!(self.end, 0, "the host has closed {DOWN:?}");
        }
    }

    /// Sends all bytes.
    pub fn send(&mut self, bytes: &[u8]) {
        // SAFETY: the length is that of the bytes.
        let left = unsafe { syscall!(WRITE, self.up, bytes.as_ptr(), bytes.len()) };
        assert_eq!(left, 0, "the host has not accepted all bytes");
    }
}

fn open(name: &CStr, mode: usize) -> usize {
    // SAFETY: the name is terminated, and its length is given.
    let handle = unsafe { syscall!(OPEN, name.as_ptr(), mode, name.count_bytes()) };
    assert_ne!(handle, usize::MAX, "the host cannot open {name:?}");
    handle
}
