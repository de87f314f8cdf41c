//! The search for what the receiver speaks.
//!
//! Which protocol the receiver speaks is found out: the port listens for one, then for the other, half a second
//! each, until several frames in a row were good. From then on it stays with that one until the next start: a
//! link that is lost must find the port listening when it comes back.

use flight_core::rc::ChannelMap;
use flight_core::sample::RcFrame;

use crate::{Line, Protocol, Receiver};

/// How long the port listens for one protocol, µs.
const LISTEN_US: u64 = 500_000;
/// Good frames after which the protocol is taken as found. Noise, or a receiver at the wrong speed, looks like an
/// SBUS frame once in 210,000 bursts (`receiver`), and not three times within half a second.
const FOUND_FRAMES: u8 = 3;

/// What came in at the port.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Received {
    /// A byte.
    Byte(u8),
    /// A byte with wrong parity, without its stop bit, or after one that was lost.
    Damaged,
}

/// A receiver whose protocol is found out.
pub struct Search {
    receiver: Receiver,
    protocol: Protocol,
    listening_since_us: u64,
    frames: u8,
    channels: ChannelMap,
}

impl Search {
    /// What is tried first.
    pub const FIRST: Protocol = Protocol::Crsf;

    /// Listens for [`Self::FIRST`].
    pub fn new(channels: ChannelMap) -> Self {
        let protocol = Self::FIRST;
        Self { receiver: Receiver::new(protocol), protocol, listening_since_us: 0, frames: 0, channels }
    }

    /// The protocol, once it is found.
    pub fn found(&self) -> Option<Protocol> {
        (self.frames >= FOUND_FRAMES).then_some(self.protocol)
    }

    /// Damaged frames since this protocol is listened for.
    pub fn damaged(&self) -> u32 {
        self.receiver.counts().bad
    }

    /// Takes what came in at `time_us`, and returns the frame that it completes.
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

    /// How the port must be set up from now on, if that is to change.
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
