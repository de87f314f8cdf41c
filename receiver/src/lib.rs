//! Decoders from the bytes of a radio-control receiver to frames of stick positions.
//!
//! | | SBUS | CRSF (TBS Crossfire, ExpressLRS) |
//! |---|---|---|
//! | line | 100,000 baud, 8E2, inverted | 420,000 baud, 8N1 |
//! | frame | 25 bytes of 120 µs, together 3 ms | up to 64 bytes of 24 µs; a frame with channels has 26, together 0.6 ms |
//! | sent every | 7 to 14 ms | 1 to 40 ms |
//! | begins with | 0x0F after a pause | address 0xC8, length |
//! | is checked by | parity; flags and footer | CRC-8/DVB-S2 |
//! | reports a lost link by | the failsafe flag, the frame-lost flag, or silence | silence, or link quality 0 |
//!
//! # Start of a frame
//! Each byte has the time at which it was received. A pause of at least [`GAP_US`] separates frames:
//! ```text
//!  SBUS, every 7 ms   ▐███ 3 ms ███▌        4 ms        ▐███ 3 ms ███▌
//!  byte to byte        0.12 ms              4.12 ms
//! ```
//! If the bytes are collected in a buffer that is read every D, a time can be late by up to D. Then the times of
//! two bytes of a frame differ by up to 0.12 ms + D, and those of two frames by at least 4.12 ms − D. A limit of
//! 2 ms separates the two cases for every D below 1.88 ms. It therefore works for an interrupt at each byte and
//! for a buffer that a 1 kHz task reads, and the size of the chunks makes no difference.
//!
//! SBUS has no checksum and depends on the pause: the decoder accepts a frame only after a pause. The CRSF decoder
//! finds frames by their checksum. There the pause, which is visible up to about 250 frames a second, only ends the
//! wait for the rest of an incomplete frame.
//!
//! # Link loss
//! [`Frame::is_live`] is true if the sticks are the pilot's present sticks. Only live frames may be used, and link loss
//! is the absence of live frames. Three cases therefore have the same result: silence, a receiver that sets its
//! failsafe flag, and a receiver that repeats its last frame and marks it as lost. A receiver that sends preset sticks
//! without a flag looks like a live link: set its failsafe to "no pulses" or "cut".
//!
//! # Parsers
//! [`uf-sbus`] and [`uf-crsf`] (Apache-2.0, by one author, `no_std`, no allocation, no `unsafe`) unpack the
//! frames. Other crates have defects: `sbus` never reports the failsafe flag (it compares a shifted bit with 1),
//! `sbus-rs` rejects the footers of SBUS2, and `crsf` 2.0 drops up to 64 bytes with every frame and indexes
//! payloads without a check of their length. This crate decodes only two frame types of `uf-crsf`.
//!
//! [`uf-sbus`]: https://docs.rs/uf-sbus
//! [`uf-crsf`]: https://docs.rs/uf-crsf
#![no_std]
#![forbid(unsafe_code)]
#![warn(missing_docs)]

mod crsf;
mod sbus;
pub mod search;

use flight_core::rc::ChannelMap;
use flight_core::sample::{LinkStatus, RcFrame};

/// Minimum pause between two frames, µs: see the crate's description.
pub const GAP_US: u64 = 2_000;

/// Number of complete frames after garbage until one is accepted: the garbage may hide the beginning of the first
/// frame, and the second frame has a pause before it. That is 17 ms for SBUS sent every 14 ms. CRSF that is too
/// fast for a visible pause recovers by its checksum: at 1,000 frames a second it lost at most three frames in
/// 20,000 trials.
pub const RECOVERY_FRAMES: usize = 2;

/// The receiver's protocol.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Protocol {
    /// SBUS: Futaba, FrSky and many others.
    Sbus,
    /// CRSF: TBS Crossfire and ExpressLRS.
    Crsf,
}

/// Settings of a serial port that receives 8 data bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Line {
    /// Baud rate, bits a second.
    pub baud: u32,
    /// Even parity if true, no parity if false.
    pub even_parity: bool,
    /// Number of stop bits, 1 or 2.
    pub stop_bits: u8,
    /// Whether the line idles low. The STM32F4's ports cannot receive that: the board needs an inverter before the pin.
    pub inverted: bool,
}

impl Protocol {
    /// Returns the name to display.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Sbus => "SBUS",
            Self::Crsf => "CRSF",
        }
    }

    /// Returns the settings of the port.
    ///
    /// SBUS: as in Betaflight, `rx/sbus.c`. CRSF: as in Betaflight, `rx/crsf_protocol.h`, and ExpressLRS. TBS
    /// specifies 416,666 baud (`tbs-crsf-spec`), which is 0.8 % less: each can receive the other.
    pub const fn line(self) -> Line {
        match self {
            Self::Sbus => Line { baud: 100_000, even_parity: true, stop_bits: 2, inverted: true },
            Self::Crsf => Line { baud: 420_000, even_parity: false, stop_bits: 1, inverted: false },
        }
    }
}

/// One frame of channel values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Frame {
    /// Channel values as sent: 11-bit ticks, 172 to 1811 between full deflections, centre 992. Extended end points and
    /// unused channels can be outside this range.
    pub channels: [u16; 16],
    /// Whether the receiver reports that its link is lost. SBUS: its failsafe flag. CRSF: an uplink quality of 0.
    pub failsafe: bool,
    /// SBUS: whether the receiver missed this frame and repeats the last one.
    pub frame_lost: bool,
    /// CRSF: share of the uplink's packets that arrived, %. `None` if there is no report of the last 0.5 s.
    pub link_quality: Option<u8>,
}

impl Frame {
    /// Returns whether the channels are the pilot's present sticks.
    pub fn is_live(&self) -> bool {
        !self.failsafe && !self.frame_lost
    }

    /// Converts to the flight controller's frame, with the pilot's assignment of the channels.
    pub fn to_rc(&self, channels: &ChannelMap) -> RcFrame {
        let status = if self.failsafe {
            LinkStatus::Failsafe
        } else if self.frame_lost {
            LinkStatus::FrameLost
        } else {
            LinkStatus::Good
        };
        channels.frame(&self.channels, status)
    }
}

/// Counts of a [`Receiver`] since its start. Each count saturates.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Valid channel frames.
    pub good: u32,
    /// Frames with a wrong checksum, flag or footer, and incomplete frames.
    pub bad: u32,
    /// Losses of synchronisation: bytes that are not a frame, after which the receiver searches for the next frame.
    pub resyncs: u32,
}

/// A receiver at a serial port.
#[derive(Debug)]
pub struct Receiver {
    decoder: Decoder,
    counts: Counts,
    last_byte_us: Option<u64>,
}

#[derive(Debug)]
enum Decoder {
    Sbus(sbus::Decoder),
    Crsf(crsf::Decoder),
}

impl Receiver {
    /// Returns a receiver without any bytes yet.
    pub fn new(protocol: Protocol) -> Self {
        let decoder = match protocol {
            Protocol::Sbus => Decoder::Sbus(sbus::Decoder::new()),
            Protocol::Crsf => Decoder::Crsf(crsf::Decoder::new()),
        };
        Self { decoder, counts: Counts::default(), last_byte_us: None }
    }

    /// Decodes a byte that was received at `time_us`, and returns the frame that it completes.
    pub fn push(&mut self, byte: u8, time_us: u64) -> Option<Frame> {
        self.check_pause(time_us);
        let frame = match &mut self.decoder {
            Decoder::Sbus(sbus) => sbus.push(byte, &mut self.counts),
            Decoder::Crsf(crsf) => crsf.push(byte, time_us, &mut self.counts),
        };
        if frame.is_some() {
            increment(&mut self.counts.good);
        }
        frame
    }

    /// Reports an error of the port at `time_us`: a byte with wrong parity, without its stop bit, or lost. The frame
    /// to which the byte belongs is dropped.
    ///
    /// SBUS depends on these reports: only the parity protects its channels.
    pub fn line_error(&mut self, time_us: u64) {
        self.check_pause(time_us);
        match &mut self.decoder {
            Decoder::Sbus(sbus) => sbus.line_error(&mut self.counts),
            Decoder::Crsf(crsf) => crsf.line_error(&mut self.counts),
        }
    }

    /// Returns the counts since the start.
    pub fn counts(&self) -> Counts {
        self.counts
    }

    /// Checks for a pause before the byte at `time_us`.
    fn check_pause(&mut self, time_us: u64) {
        // The first byte counts as a byte without a pause, because the time before it is unknown.
        if self.last_byte_us.is_some_and(|last_us| time_us.saturating_sub(last_us) >= GAP_US) {
            match &mut self.decoder {
                Decoder::Sbus(sbus) => sbus.pause(&mut self.counts),
                Decoder::Crsf(crsf) => crsf.pause(&mut self.counts),
            }
        }
        self.last_byte_us = Some(time_us);
    }
}

fn increment(counter: &mut u32) {
    *counter = counter.saturating_add(1);
}
