//! The link of hardware in the loop: `sim-host` plays the world, the firmware flies.
//!
//! ```text
//!  sim-host                                  firmware
//!           ◄──────────────── Ready ────────           who it is, and why it started
//!   Start ──────────────────────────────►              the configuration of the flight
//!           ◄─────────────── Started ───────
//!   Step n ─────────────────────────────►              time, counts, sticks, supply
//!           ◄──────────────── Done n ───────           pulses, state, attitude, what it took
//!   ...
//!   End ────────────────────────────────►
//! ```
//! In lock-step: no message without the answer to the one before. All time on the firmware's side is that of
//! [`Step::time_us`].
//!
//! # Frames
//! A message is encoded by [postcard](https://postcard.jamesmunns.com/wire-format) and put into a packet,
//!
//! | bytes | what |
//! |---|---|
//! | 1 | [`VERSION`] |
//! | 2 | length of the message, little-endian |
//! | 4 | sequence number, little-endian: of the sender's own, counted from 0; an answer has that of its question |
//! | … | the message |
//! | 4 | CRC-32 (ISO-HDLC, as in Ethernet) of all before, little-endian |
//!
//! which is then encoded by COBS and ended by a zero byte. Whoever gets out of step is in step again at the next
//! zero. The CRC finds every error of up to three bits in packets of this size, and all but one in 2³² of others.
#![no_std]
#![forbid(unsafe_code)]
#![warn(missing_docs)]

mod message;
mod packet;

pub use message::{Done, Received, Started, Step, ToBoard, ToHost};
pub use packet::{Decoder, EncodeError, FrameError, MAX_FRAME, Packet, encode};

/// Version of messages and packets. Another version is another language.
pub const VERSION: u8 = 1;

/// What a received sequence number means, if `last` was the one before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// The next one.
    Next,
    /// The same again, or an older one.
    Repeated,
    /// This many were lost before it.
    Lost(u32),
}

impl Order {
    /// The order of `sequence` after `last`; before the first packet there is no last.
    pub fn of(sequence: u32, last: Option<u32>) -> Self {
        let expected = last.map_or(0, |last| last.wrapping_add(1));
        match sequence.wrapping_sub(expected) {
            0 => Self::Next,
            // Half of the numbers lie ahead, the other half behind.
            ahead if ahead < 1 << 31 => Self::Lost(ahead),
            _ => Self::Repeated,
        }
    }
}

#[cfg(test)]
extern crate std;

#[cfg(test)]
mod tests;
