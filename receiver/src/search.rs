//! The search for the receiver's protocol.
//!
//! The port listens for each protocol in turn, half a second each, until it receives three good frames of one. It then
//! keeps this protocol until the next start, so that a lost link finds the port with the right settings when it returns.

use flight_core::rc::ChannelMap;
use flight_core::sample::RcFrame;

use crate::{Line, Protocol, Receiver};

/// Time for which the port listens for one protocol, µs.
const LISTEN_US: u64 = 500_000;
/// Number of good frames after which the protocol is found. Noise, or a receiver at the wrong baud rate, looks like an
/// SBUS frame once in 210,000 bursts (`receiver::sbus`), and practically never three times within half a second.
const FOUND_FRAMES: u8 = 3;

/// An event at the port.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Received {
    /// A received byte.
    Byte(u8),
    /// A byte with wrong parity, without its stop bit, or after a lost byte.
    Damaged,
}

/// A receiver that searches for its protocol.
pub struct Search {
    receiver: Receiver,
    protocol: Protocol,
    listening_since_us: u64,
    frames: u8,
    channels: ChannelMap,
}

impl Search {
    /// The first protocol that is tried.
    pub const FIRST: Protocol = Protocol::Crsf;

    /// Returns a search that begins with [`Self::FIRST`].
    pub fn new(channels: ChannelMap) -> Self {
        let protocol = Self::FIRST;
        Self { receiver: Receiver::new(protocol), protocol, listening_since_us: 0, frames: 0, channels }
    }

    /// Returns the protocol, or `None` before it is found.
    pub fn found(&self) -> Option<Protocol> {
        (self.frames >= FOUND_FRAMES).then_some(self.protocol)
    }

    /// Returns the number of damaged frames since the search switched to this protocol.
    pub fn damaged(&self) -> u32 {
        self.receiver.counts().bad
    }

    /// Decodes an event at `time_us`, and returns the frame that it completes once the protocol is found.
    pub fn push(&mut self, received: Received, time_us: u64) -> Option<RcFrame> {
        let frame = match received {
            Received::Byte(byte) => self.receiver.push(byte, time_us)?,
            Received::Damaged => {
                self.receiver.line_error(time_us);
                return None;
            }
        };
        if self.found().is_none() {
            self.frames += 1;
            return None;
        }
        Some(frame.to_rc(&self.channels))
    }

    /// Switches to the other protocol if it is time to, and returns the new settings of the port.
    pub fn next_line(&mut self, now_us: u64) -> Option<Line> {
        if self.found().is_some() || now_us.saturating_sub(self.listening_since_us) < LISTEN_US {
            return None;
        }
        self.protocol = match self.protocol {
            Protocol::Crsf => Protocol::Sbus,
            Protocol::Sbus => Protocol::Crsf,
        };
        self.receiver = Receiver::new(self.protocol);
        self.listening_since_us = now_us;
        self.frames = 0;
        Some(self.protocol.line())
    }
}
