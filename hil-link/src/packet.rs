//! Encoding and decoding of packets and frames.

use core::fmt;

use crc::{CRC_32_ISO_HDLC, Crc, Table};
use serde::{Deserialize, Serialize};

use crate::VERSION;

/// The CRC with a table of 16 entries. It has a fourth of the speed of a table with 256 entries, and needs a sixteenth
/// of its flash.
const CRC: Crc<u32, Table<1>> = Crc::<u32, Table<1>>::new(&CRC_32_ISO_HDLC);

/// Length of version (1), length (2) and sequence number (4), bytes.
const HEADER: usize = 7;
/// Length of the CRC, bytes.
const TRAILER: usize = 4;

/// Maximum length of a packet, bytes: the longest message is a configuration.
const MAX_PACKET: usize = 768;
/// Maximum length of a frame, bytes: COBS adds one byte and one more for each 254 bytes; a zero ends the frame.
pub const MAX_FRAME: usize = MAX_PACKET + MAX_PACKET / 254 + 2;

/// The message does not fit into a packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EncodeError;

/// Encodes a message into `frame`, and returns the frame's length, bytes.
///
/// # Errors
/// The message does not fit into a packet.
pub fn encode(
    sequence: u32,
    message: &impl Serialize,
    frame: &mut [u8; MAX_FRAME],
) -> Result<usize, EncodeError> {
    let mut packet = [0; MAX_PACKET];
    let (header, rest) = packet.split_at_mut(HEADER);
    let room = rest.len() - TRAILER;
    let length = postcard::to_slice(message, &mut rest[..room]).map_err(|_| EncodeError)?.len();
    let (version, rest) = header.split_at_mut(1);
    version[0] = VERSION;
    // `room` is far below 2¹⁶.
    rest[..2].copy_from_slice(&(length as u16).to_le_bytes());
    rest[2..].copy_from_slice(&sequence.to_le_bytes());
    let end = HEADER + length;
    let crc = CRC.checksum(&packet[..end]);
    packet[end..end + TRAILER].copy_from_slice(&crc.to_le_bytes());
    let length = cobs::encode(&packet[..end + TRAILER], &mut frame[..MAX_FRAME - 1]);
    frame[length] = 0;
    Ok(length + 1)
}

/// The reason why the bytes up to a zero are not a packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameError {
    /// Longer than [`MAX_FRAME`].
    TooLong,
    /// Invalid COBS encoding.
    Encoding,
    /// The number of bytes differs from the length field.
    Length,
    /// The CRC is wrong.
    Crc,
    /// The packet is valid, but has this other version.
    Version(u8),
}

impl fmt::Display for FrameError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TooLong => write!(f, "longer than the maximum of {MAX_FRAME} bytes"),
            Self::Encoding => write!(f, "invalid COBS encoding"),
            Self::Length => write!(f, "length differs from the length field"),
            Self::Crc => write!(f, "wrong checksum"),
            Self::Version(version) => write!(f, "link version {version}, must be {VERSION}"),
        }
    }
}

impl core::error::Error for FrameError {}

/// A valid packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Packet<'a> {
    /// Sequence number.
    pub sequence: u32,
    body: &'a [u8],
}

impl<'a> Packet<'a> {
    /// Decodes the message; returns `None` if it is not of this type.
    pub fn message<T: Deserialize<'a>>(&self) -> Option<T> {
        let (message, rest) = postcard::take_from_bytes(self.body).ok()?;
        rest.is_empty().then_some(message)
    }
}

/// Decoder from bytes to packets.
#[derive(Clone, Debug)]
pub struct Decoder {
    frame: [u8; MAX_FRAME],
    length: usize,
    /// Whether the present frame is too long, and will be rejected.
    overflow: bool,
}

impl Default for Decoder {
    fn default() -> Self {
        Self { frame: [0; MAX_FRAME], length: 0, overflow: false }
    }
}

impl Decoder {
    /// Decodes a byte. At the end of a frame, returns its packet or the error. Ignores repeated zeros.
    pub fn push(&mut self, byte: u8) -> Option<Result<Packet<'_>, FrameError>> {
        if byte != 0 {
            match self.frame.get_mut(self.length) {
                Some(place) => {
                    *place = byte;
                    self.length += 1;
                }
                None => self.overflow = true,
            }
            return None;
        }
        let length = core::mem::take(&mut self.length);
        if core::mem::take(&mut self.overflow) {
            return Some(Err(FrameError::TooLong));
        }
        (length > 0).then(|| unpack(&mut self.frame[..length]))
    }
}

fn unpack(frame: &mut [u8]) -> Result<Packet<'_>, FrameError> {
    let length = cobs::decode_in_place(frame).map_err(|_| FrameError::Encoding)?;
    let packet: &[u8] = &frame[..length];
    let Some((rest, crc)) = packet.split_last_chunk::<TRAILER>() else { return Err(FrameError::Length) };
    if CRC.checksum(rest) != u32::from_le_bytes(*crc) {
        return Err(FrameError::Crc);
    }
    let [version, low, high, a, b, c, d, body @ ..] = rest else { return Err(FrameError::Length) };
    if *version != VERSION {
        return Err(FrameError::Version(*version));
    }
    if usize::from(u16::from_le_bytes([*low, *high])) != body.len() {
        return Err(FrameError::Length);
    }
    Ok(Packet { sequence: u32::from_le_bytes([*a, *b, *c, *d]), body })
}
