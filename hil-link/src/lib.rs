//! The link for hardware in the loop: `sim-host` simulates the vehicle and its world, the firmware flies.
//!
//! ```text
//!  sim-host                                  firmware
//!           ◄──────────────── Ready ────────           whether the watchdog caused the start
//!   Start ──────────────────────────────►              the configuration of the flight
//!           ◄─────────────── Started ───────
//!   Step n ─────────────────────────────►              time, counts, sticks, battery
//!           ◄──────────────── Done n ───────           pulses, state, attitude, instructions
//!   ...
//!   End ────────────────────────────────►
//! ```
//! The link runs in lock-step: `sim-host` sends the next message after the answer to the last one. The firmware's only
//! clock is [`Step::time_us`].
//!
//! # Frames
//! A message is encoded by [postcard](https://postcard.jamesmunns.com/wire-format) and put into a packet:
//!
//! | bytes | content |
//! |---|---|
//! | 1 | [`VERSION`] |
//! | 2 | length of the message, little-endian |
//! | 4 | sequence number, little-endian: counted from 0 by the sender; an answer repeats the number of its request |
//! | … | the message |
//! | 4 | CRC-32 (ISO-HDLC, as in Ethernet) of all bytes before it, little-endian |
//!
//! COBS encodes the packet, and a zero byte ends the frame. A decoder that loses synchronisation has it again at the
//! next zero. The CRC detects all errors of up to three bits in packets of this size; it misses one in 2³² of other
//! errors.
#![no_std]
#![forbid(unsafe_code)]
#![warn(missing_docs)]

mod message;
mod packet;

pub use message::{Done, Received, Started, Step, ToBoard, ToHost};
pub use packet::{Decoder, EncodeError, FrameError, MAX_FRAME, Packet, encode};

/// Version of messages and packets. Both sides must have the same version.
pub const VERSION: u8 = 1;

/// Relation of a received sequence number to the last one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// The next number.
    Next,
    /// The same number again, or an older one.
    Repeated,
    /// A later number: this many were lost before it.
    Lost(u32),
}

impl Order {
    /// Compares `sequence` with `last`, which is `None` before the first packet.
    pub fn of(sequence: u32, last: Option<u32>) -> Self {
        let expected = last.map_or(0, |last| last.wrapping_add(1));
        match sequence.wrapping_sub(expected) {
            0 => Self::Next,
            // Differences below 2³¹ mean that numbers were lost; larger ones mean an older number.
            ahead if ahead < 1 << 31 => Self::Lost(ahead),
            _ => Self::Repeated,
        }
    }
}

#[cfg(test)]
extern crate std;

#[cfg(test)]
mod tests;
