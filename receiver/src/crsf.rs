//! Decoder for CRSF, a protocol whose frames have a length and a checksum.
//!
//! ```text
//!  0xC8 │ length │ type │ payload │ CRC-8/DVB-S2 of type and payload
//!                 └── counted by length ────────┘
//! ```
//! Type 0x16 holds 16 channels of 11 bits, type 0x14 holds the statistics of the link. Other types and other
//! addresses are ignored. In random bytes, a false channel frame begins at 1 of 1.1·10⁸ positions (address 1/256,
//! a length of 24 to 62 is 39/256, type 1/256, checksum 1/256).

use core::slice;

use uf_crsf::packets::{CrsfPacket, LinkStatistics, PacketAddress, RcChannelsPacked};
use uf_crsf::{CrsfParser, CrsfStreamError, RawCrsfPacket};

use crate::{Counts, Frame, increment};

/// Maximum age of a report of the link quality, µs: two intervals of the slowest receivers (4 Hz according to
/// Betaflight's `rx/crsf.c`; ExpressLRS reports every 100 ms).
const QUALITY_MAX_AGE_US: u64 = 500_000;

#[derive(Debug)]
pub struct Decoder {
    parser: CrsfParser,
    sync: Sync,
    /// Uplink quality, %, and the time of its report, µs.
    quality: Option<(u8, u64)>,
}

/// Position in the stream of frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Sync {
    BetweenFrames,
    InFrame,
    /// Searching for the start of a frame.
    Lost,
}

impl Decoder {
    pub fn new() -> Self {
        Self { parser: CrsfParser::new(), sync: Sync::Lost, quality: None }
    }

    pub fn push(&mut self, byte: u8, time_us: u64, counts: &mut Counts) -> Option<Frame> {
        let mut input = slice::from_ref(&byte);
        let mut newest = None;
        if self.sync == Sync::BetweenFrames {
            self.sync = Sync::InFrame;
        }
        // The parser searches the bytes of a rejected frame for other frames, so one byte can give several results.
        // Of several frames the last is the newest.
        while let Some(result) = self.parser.next_raw_packet(&mut input) {
            match result {
                Ok(packet) => {
                    self.sync = Sync::BetweenFrames;
                    if packet.dst_addr() == PacketAddress::FlightController as u8 {
                        newest = read(&packet, &mut self.quality, time_us).or(newest);
                    }
                }
                Err(error) => {
                    if matches!(error, CrsfStreamError::InvalidCrc { .. }) {
                        increment(&mut counts.bad);
                    }
                    self.lose_sync(counts);
                }
            }
        }
        newest
    }

    pub fn pause(&mut self, counts: &mut Counts) {
        if self.sync == Sync::InFrame {
            increment(&mut counts.bad);
        }
        self.parser.reset();
        self.sync = Sync::BetweenFrames;
    }

    pub fn line_error(&mut self, counts: &mut Counts) {
        if self.sync != Sync::Lost {
            increment(&mut counts.bad);
        }
        self.parser.reset();
        self.lose_sync(counts);
    }

    fn lose_sync(&mut self, counts: &mut Counts) {
        if self.sync != Sync::Lost {
            increment(&mut counts.resyncs);
            self.sync = Sync::Lost;
        }
    }
}

/// Returns the frame of a channel packet, or `None` for any other packet. Stores link statistics in `quality`.
fn read(packet: &RawCrsfPacket, quality: &mut Option<(u8, u64)>, time_us: u64) -> Option<Frame> {
    let packet_type = packet.raw_packet_type();
    if packet_type == RcChannelsPacked::PACKET_TYPE as u8 {
        let RcChannelsPacked(channels) = RcChannelsPacked::from_bytes(packet.payload()).ok()?;
        let fresh = quality.filter(|(_, at_us)| time_us.saturating_sub(*at_us) <= QUALITY_MAX_AGE_US);
        let link_quality = fresh.map(|(percent, _)| percent);
        Some(Frame { channels, failsafe: link_quality == Some(0), frame_lost: false, link_quality })
    } else {
        if packet_type == LinkStatistics::PACKET_TYPE as u8
            && let Ok(statistics) = LinkStatistics::from_bytes(packet.payload())
        {
            *quality = Some((statistics.uplink_link_quality, time_us));
        }
        None
    }
}
