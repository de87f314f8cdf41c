//! Packets in frames.

use core::fmt;

use crc::{CRC_32_ISO_HDLC, Crc, Table};
use serde::{Deserialize, Serialize};

use crate::VERSION;

/// Sixteen entries of table: a fourth of the speed of 256, and a sixteenth of their flash.
const CRC: Crc<u32, Table<1>> = Crc::<u32, Table<1>>::new(&CRC_32_ISO_HDLC);

/// Version, length, sequence number.
const HEADER: usize = 7;
/// CRC.
const TRAILER: usize = 4;

/// The longest packet, bytes: a configuration is the longest message.
const MAX_PACKET: usize = 768;
/// The longest frame, its ending zero included: COBS adds a byte for each 254, and one.
pub const MAX_FRAME: usize = MAX_PACKET + MAX_PACKET / 254 + 2;

/// The message does not fit into a packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EncodeError;

/// Writes the frame of a message into `frame`, and returns its length.
///
/// # Errors
/// The message is longer than a packet can be.
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

/// Why bytes up to a zero are no packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameError {
    /// More bytes than a frame has.
    TooLong,
    /// No COBS.
    Encoding,
    /// Fewer or more bytes than the length says.
    Length,
    /// The CRC is another.
    Crc,
    /// The packet is whole, and of this version.
    Version(u8),
}

impl fmt::Display for FrameError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TooLong => write!(f, "longer than a frame can be"),
            Self::Encoding => write!(f, "not a frame's encoding"),
            Self::Length => write!(f, "not as long as it says"),
            Self::Crc => write!(f, "wrong checksum"),
            Self::Version(version) => write!(f, "version {version} of the link, and this is {VERSION}"),
        }
    }
}

impl core::error::Error for FrameError {}

/// A packet that has arrived whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Packet<'a> {
    /// Its sequence number.
    pub sequence: u32,
    body: &'a [u8],
}

impl<'a> Packet<'a> {
    /// The message in it; `None` if it is none of this type.
    pub fn message<T: Deserialize<'a>>(&self) -> Option<T> {
        let (message, rest) = postcard::take_from_bytes(self.body).ok()?;
        rest.is_empty().then_some(message)
    }
}

/// Takes bytes, and finds the packets in them.
#[derive(Clone, Debug)]
pub struct Decoder {
    frame: [u8; MAX_FRAME],
    length: usize,
    /// The present frame is too long, and is given up.
    spilled: bool,
}

impl Default for Decoder {
    fn default() -> Self {
        Self { frame: [0; MAX_FRAME], length: 0, spilled: false }
    }
}

impl Decoder {
    /// Takes a byte. At the end of a frame: its packet, or why it has none. Zeros in succession end nothing.
    pub fn push(&mut self, byte: u8) -> Option<Result<Packet<'_>, FrameError>> {
        if byte != 0 {
            match self.frame.get_mut(self.length) {
                Some(place) => {
                    *place = byte;
                    self.length += 1;
                }
                None => self.spilled = true,
            }
            return None;
        }
        let length = core::mem::take(&mut self.length);
        if core::mem::take(&mut self.spilled) {
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
