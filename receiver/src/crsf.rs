//! CRSF: frames with a length and a checksum.
//!
//! ```text
//!  0xC8 │ length │ type │ payload │ CRC-8/DVB-S2 of type and payload
//!                 └──── length counts these ────┘
//! ```
//! Type 0x16 holds 16 channels of 11 bits, type 0x14 the statistics of the link; the rest is not for us, nor is
//! what has another address. Among random bytes, channels begin at 1 of 1.1·10⁸ places (address 1/256, a length
//! of 24 to 62, type 1/256, checksum 1/256).

use core::slice;

use uf_crsf::packets::{CrsfPacket, LinkStatistics, PacketAddress, RcChannelsPacked};
use uf_crsf::{CrsfParser, CrsfStreamError, RawCrsfPacket};

use crate::{Counts, Frame, count};

/// Reports of the link's quality older than this say nothing any more, µs: two of the slowest receivers'
/// intervals (4 Hz, says Betaflight's `rx/crsf.c`; ExpressLRS reports every 100 ms).
const QUALITY_MAX_AGE_US: u64 = 500_000;

#[derive(Debug)]
pub struct Decoder {
    parser: CrsfParser,
    place: Place,
    /// Uplink quality, %, and when it was reported.
    quality: Option<(u8, u64)>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Place {
    /// Between two frames.
    Between,
    Inside,
    /// Looking for a frame.
    Lost,
}

impl Decoder {
    pub fn new() -> Self {
        Self { parser: CrsfParser::new(), place: Place::Lost, quality: None }
    }

    pub fn push(&mut self, byte: u8, time_us: u64, counts: &mut Counts) -> Option<Frame> {
        let mut input = slice::from_ref(&byte);
        let mut newest = None;
        if self.place == Place::Between {
            self.place = Place::Inside;
        }
        // The bytes of a rejected frame are searched again for frames, so that one byte may bring several
        // results; of several frames the last is the newest.
        while let Some(result) = self.parser.next_raw_packet(&mut input) {
            match result {
                Ok(packet) => {
                    self.place = Place::Between;
                    if packet.dst_addr() == PacketAddress::FlightController as u8 {
                        newest = read(&packet, &mut self.quality, time_us).or(newest);
                    }
                }
                Err(error) => {
                    if matches!(error, CrsfStreamError::InvalidCrc { .. }) {
                        count(&mut counts.bad);
                    }
                    self.lose(counts);
                }
            }
        }
        newest
    }

    pub fn pause(&mut self, counts: &mut Counts) {
        if self.place == Place::Inside {
            count(&mut counts.bad);
        }
        self.parser.reset();
        self.place = Place::Between;
    }

    pub fn line_error(&mut self, counts: &mut Counts) {
        if self.place != Place::Lost {
            count(&mut counts.bad);
        }
        self.parser.reset();
        self.lose(counts);
    }

    fn lose(&mut self, counts: &mut Counts) {
        if self.place != Place::Lost {
            count(&mut counts.resyncs);
            self.place = Place::Lost;
        }
    }
}

/// The frame of channels, or `None` for any other packet. Statistics go to `quality`.
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
