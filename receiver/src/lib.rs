//! From the bytes of a radio-control receiver to frames of stick positions.
//!
//! | | SBUS | CRSF (TBS Crossfire, ExpressLRS) |
//! |---|---|---|
//! | line | 100,000 baud, 8E2, inverted | 420,000 baud, 8N1 |
//! | frame | 25 bytes of 120 µs: 3 ms | up to 64 bytes of 24 µs; channels are 26: 0.6 ms |
//! | sent every | 7 to 14 ms | 1 to 40 ms |
//! | begins with | 0x0F after a pause | address 0xC8, length |
//! | is checked by | parity; flags and footer | CRC-8/DVB-S2 |
//! | a lost link shows as | the failsafe flag, the frame-lost flag, or silence | silence, or link quality 0 |
//!
//! # Where a frame begins
//! Bytes come with the time at which they were received, and a pause of [`GAP_US`] separates frames:
//! ```text
//!  SBUS, every 7 ms   ▐███ 3 ms ███▌        4 ms        ▐███ 3 ms ███▌
//!  byte to byte        0.12 ms              4.12 ms
//! ```
//! A time may be late by as much as D, if the bytes are collected in a buffer and fetched every D. Then up to
//! 0.12 ms + D lie between two bytes of a frame, and at least 4.12 ms − D between two frames. 2 ms separate the
//! two for every D below 1.88 ms: for an interrupt at each byte as well as for a buffer that a 1 kHz task
//! empties, so that how the bytes are cut into chunks makes no difference.
//!
//! SBUS has no checksum, and depends on the pause: a frame is only looked for behind one. CRSF finds its frames
//! by their checksum; the pause, which is there to see up to about 250 frames a second, makes an end of the wait
//! for the rest of a frame that never comes.
//!
//! # When the link is lost
//! A frame [`Frame::is_live`] if its sticks are the pilot's. Only live frames may be used, and the absence of
//! live frames is the loss of the link: so silence, a receiver that sets its failsafe flag, and one that
//! repeats its last frame as lost, all end in the same way. What cannot be told from a live link is a receiver
//! that goes on sending made-up sticks without a flag: its failsafe must be set to "no pulses" or "cut".
//!
//! # The decoders
//! [`uf-sbus`] and [`uf-crsf`] (Apache-2.0, by one author, `no_std`, no allocation, no `unsafe`) unpack the
//! frames. Of the others, `sbus` never reports the failsafe flag (it compares a shifted bit with 1),
//! `sbus-rs` rejects the footers of SBUS2, and `crsf` 2.0 drops up to 64 bytes with every frame and indexes
//! payloads without looking at their length. Of `uf-crsf` only the two frame types used here are decoded.
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

/// A pause of this length separates two frames, µs: see the crate's description.
pub const GAP_US: u64 = 2_000;

/// After any garbage, the second whole frame at the latest is accepted: the first may have lost its beginning
/// to the garbage, the second has a pause before it. That is 17 ms for SBUS sent every 14 ms. CRSF too fast for
/// the pause to be seen recovers by its checksum: at 1,000 frames a second it never lost more than three in
/// 20,000 trials.
pub const RECOVERY_FRAMES: usize = 2;

/// What the receiver speaks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Protocol {
    /// Futaba, FrSky and many others.
    Sbus,
    /// TBS Crossfire and ExpressLRS.
    Crsf,
}

/// Settings of a serial port that receives 8 data bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Line {
    /// Bits a second.
    pub baud: u32,
    /// Even parity; otherwise none.
    pub even_parity: bool,
    /// 1 or 2.
    pub stop_bits: u8,
    /// The line idles low. The STM32F4's ports cannot receive that: a board needs an inverter before the pin.
    pub inverted: bool,
}

impl Protocol {
    /// For people.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Sbus => "SBUS",
            Self::Crsf => "CRSF",
        }
    }

    /// How to set up the port.
    ///
    /// SBUS: Betaflight, `rx/sbus.c`. CRSF: Betaflight, `rx/crsf_protocol.h`, and ExpressLRS; TBS names
    /// 416,666 baud (`tbs-crsf-spec`), which is 0.8 % less, and both read each other.
    pub const fn line(self) -> Line {
        match self {
            Self::Sbus => Line { baud: 100_000, even_parity: true, stop_bits: 2, inverted: true },
            Self::Crsf => Line { baud: 420_000, even_parity: false, stop_bits: 1, inverted: false },
        }
    }
}

/// One frame of channels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Frame {
    /// The channels as they were sent: 11-bit ticks, 172 to 1811 for full deflections, centre 992. Extended end
    /// points, and unused channels, lie outside.
    pub channels: [u16; 16],
    /// The receiver has lost its link for good. SBUS: its flag. CRSF: it reports an uplink quality of 0.
    pub failsafe: bool,
    /// SBUS: the receiver missed this frame and repeats the last one.
    pub frame_lost: bool,
    /// CRSF: share of the uplink's packets that arrived, %. `None` if it was not reported of late.
    pub link_quality: Option<u8>,
}

impl Frame {
    /// Whether the channels are what the pilot does now.
    pub fn is_live(&self) -> bool {
        !self.failsafe && !self.frame_lost
    }

    /// The frame for the flight controller, with the channels where the pilot has them.
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

/// What a [`Receiver`] has seen so far. A full counter stays full.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Frames of channels.
    pub good: u32,
    /// Frames with a wrong checksum, flag or footer, and frames that broke off.
    pub bad: u32,
    /// How often the receiver found bytes where a frame should have begun, and had to look for the next one.
    pub resyncs: u32,
}

/// One receiver at one serial port.
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
    /// A receiver that has heard nothing yet.
    pub fn new(protocol: Protocol) -> Self {
        let decoder = match protocol {
            Protocol::Sbus => Decoder::Sbus(sbus::Decoder::new()),
            Protocol::Crsf => Decoder::Crsf(crsf::Decoder::new()),
        };
        Self { decoder, counts: Counts::default(), last_byte_us: None }
    }

    /// Takes a byte, received at `time_us`, and returns the frame that it completes.
    pub fn push(&mut self, byte: u8, time_us: u64) -> Option<Frame> {
        self.listen(time_us);
        let frame = match &mut self.decoder {
            Decoder::Sbus(sbus) => sbus.push(byte, &mut self.counts),
            Decoder::Crsf(crsf) => crsf.push(byte, time_us, &mut self.counts),
        };
        if frame.is_some() {
            count(&mut self.counts.good);
        }
        frame
    }

    /// The port received a byte with wrong parity or without its stop bit, or lost one, at `time_us`. The frame
    /// that it belongs to is given up.
    ///
    /// SBUS needs to be told: apart from the parity nothing protects its channels.
    pub fn line_error(&mut self, time_us: u64) {
        self.listen(time_us);
        match &mut self.decoder {
            Decoder::Sbus(sbus) => sbus.line_error(&mut self.counts),
            Decoder::Crsf(crsf) => crsf.line_error(&mut self.counts),
        }
    }

    /// What was seen so far.
    pub fn counts(&self) -> Counts {
        self.counts
    }

    /// Looks for a pause before the byte at `time_us`.
    fn listen(&mut self, time_us: u64) {
        // What came before the first byte is not known, so it has no pause before it.
        if self.last_byte_us.is_some_and(|last_us| time_us.saturating_sub(last_us) >= GAP_US) {
            match &mut self.decoder {
                Decoder::Sbus(sbus) => sbus.pause(&mut self.counts),
                Decoder::Crsf(crsf) => crsf.pause(&mut self.counts),
            }
        }
        self.last_byte_us = Some(time_us);
    }
}

fn count(counter: &mut u32) {
    *counter = counter.saturating_add(1);
}
