//! A configuration as a record in flash.
//!
//! `sim-host config` writes the record to a file, a debug probe writes the file to the board's parameter sectors, and
//! the board reads it at start.
//!
//! | bytes | what |
//! |---|---|
//! | 4 | [`MAGIC`] |
//! | 2 | [`VERSION`], little-endian |
//! | 2 | length of the configuration, little-endian |
//! | … | [`Config`], encoded by [postcard](https://postcard.jamesmunns.com/wire-format) |
//! | 4 | CRC-32 (ISO-HDLC, as in Ethernet) of all before, little-endian |
//!
//! Whatever stands behind the record is ignored. Magic, version, length and CRC keep their places in every version, so
//! that a record of another version is named as such, and is not taken for a damaged one.
//!
//! The CRC finds every error of up to three bits in records of this size, and all but one in 2³² of others.
//! [`decode`] says that the record is the one that was encoded. It does not check ranges: the flight controller does,
//! when it is built ([`flight_core::FlightController::new`]).
#![no_std]
#![forbid(unsafe_code)]
#![warn(missing_docs)]

pub mod board;

use core::fmt;

use crc::{CRC_32_ISO_HDLC, Crc, Table};
use flight_core::Config;

/// The first bytes of a record: "Kestrel configuration".
pub const MAGIC: [u8; 4] = *b"KSTC";

/// Version of what [`Config`] consists of. A field that is added, removed or moved needs the next number: postcard
/// has no names, and would take one field for another.
pub const VERSION: u16 = 2;

/// The longest record, bytes.
pub const MAX_RECORD: usize = 1024;

/// Magic, version, length.
const HEADER: usize = 8;
/// CRC.
const TRAILER: usize = 4;

/// What erased flash reads.
const ERASED: u8 = 0xff;

/// Sixteen entries of table: a fourth of the speed of 256, and a sixteenth of their flash.
const CRC: Crc<u32, Table<1>> = Crc::<u32, Table<1>>::new(&CRC_32_ISO_HDLC);

/// The record does not fit into the buffer, or into [`MAX_RECORD`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EncodeError;

impl fmt::Display for EncodeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the configuration is longer than its record can be")
    }
}

impl core::error::Error for EncodeError {}

/// Why bytes are no record of this version.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DecodeError {
    /// Erased flash: nothing was ever stored.
    Empty,
    /// The bytes do not begin as a record does.
    Magic,
    /// The bytes end before the record does.
    Truncated,
    /// The record says that it is longer than one can be.
    Length,
    /// The checksum is another.
    Checksum,
    /// The record is whole, and of this version.
    Version(u16),
    /// The record is whole and of this version, and what it holds is no configuration.
    Content,
}

impl DecodeError {
    /// For people, in a few words.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Empty => "nothing is stored",
            Self::Magic => "not a record",
            Self::Truncated => "cut short",
            Self::Length => "longer than a record can be",
            Self::Checksum => "wrong checksum",
            Self::Version(_) => "of another version",
            Self::Content => "not a configuration",
        }
    }
}

impl fmt::Display for DecodeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Version(version) => write!(f, "of version {version}, and this is {VERSION}"),
            _ => f.write_str(self.name()),
        }
    }
}

impl core::error::Error for DecodeError {}

/// Writes the record of `config` to the beginning of `record`, and returns that part. [`MAX_RECORD`] bytes are room
/// enough.
///
/// # Errors
/// There is not room enough.
pub fn encode<'a>(config: &Config, record: &'a mut [u8]) -> Result<&'a [u8], EncodeError> {
    let room = record.len().min(MAX_RECORD).checked_sub(HEADER + TRAILER).ok_or(EncodeError)?;
    let content = record.get_mut(HEADER..HEADER + room).ok_or(EncodeError)?;
    let length = postcard::to_slice(config, content).map_err(|_| EncodeError)?.len();
    let (magic, rest) = record.split_at_mut(4);
    magic.copy_from_slice(&MAGIC);
    rest[..2].copy_from_slice(&VERSION.to_le_bytes());
    // `room` is below 2¹⁶.
    rest[2..4].copy_from_slice(&(length as u16).to_le_bytes());
    let end = HEADER + length;
    let checksum = CRC.checksum(&record[..end]);
    record[end..end + TRAILER].copy_from_slice(&checksum.to_le_bytes());
    Ok(&record[..end + TRAILER])
}

/// Reads the record at the beginning of `bytes`.
///
/// # Errors
/// There is none, or it is not whole, or not of this version.
pub fn decode(bytes: &[u8]) -> Result<Config, DecodeError> {
    let Some((header, rest)) = bytes.split_first_chunk::<HEADER>() else {
        return Err(DecodeError::Truncated);
    };
    let [a, b, c, d, version_low, version_high, length_low, length_high] = *header;
    if [a, b, c, d] != MAGIC {
        let erased = bytes.iter().all(|&byte| byte == ERASED);
        return Err(if erased { DecodeError::Empty } else { DecodeError::Magic });
    }
    let length = usize::from(u16::from_le_bytes([length_low, length_high]));
    if length > MAX_RECORD - HEADER - TRAILER {
        return Err(DecodeError::Length);
    }
    let Some((content, rest)) = rest.split_at_checked(length) else { return Err(DecodeError::Truncated) };
    let Some((checksum, _)) = rest.split_first_chunk::<TRAILER>() else {
        return Err(DecodeError::Truncated);
    };
    let mut digest = CRC.digest();
    digest.update(header);
    digest.update(content);
    if digest.finalize() != u32::from_le_bytes(*checksum) {
        return Err(DecodeError::Checksum);
    }
    let version = u16::from_le_bytes([version_low, version_high]);
    if version != VERSION {
        return Err(DecodeError::Version(version));
    }
    match postcard::take_from_bytes(content) {
        Ok((config, [])) => Ok(config),
        _ => Err(DecodeError::Content),
    }
}

#[cfg(test)]
extern crate std;

#[cfg(test)]
mod tests;
