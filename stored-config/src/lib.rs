//! The encoding of a configuration as a record in flash.
//!
//! `sim-host config` writes the record to a file, a debug probe writes the file to the board's parameter sectors, and
//! the board reads it at start.
//!
//! | bytes | content |
//! |---|---|
//! | 4 | [`MAGIC`] |
//! | 2 | [`VERSION`], little-endian |
//! | 2 | length of the configuration, little-endian |
//! | … | [`Config`], encoded by [postcard](https://postcard.jamesmunns.com/wire-format) |
//! | 4 | CRC-32 (ISO-HDLC, as in Ethernet) of all bytes before it, little-endian |
//!
//! Bytes after the record are ignored. Magic, version, length and CRC have the same positions in every version, so that
//! the error for a record of another version is not that for a damaged record.
//!
//! The CRC detects all errors of up to three bits in records of this size; it misses one in 2³² of other errors.
//! [`decode`] checks that the record is the encoded one. It does not check ranges: the flight controller checks them when
//! it is built ([`flight_core::FlightController::new`]).
#![no_std]
#![forbid(unsafe_code)]
#![warn(missing_docs)]

pub mod board;

use core::fmt;

use crc::{CRC_32_ISO_HDLC, Crc, Table};
use flight_core::Config;

/// First bytes of a record: "Kestrel configuration".
pub const MAGIC: [u8; 4] = *b"KSTC";

/// Version of the fields of [`Config`]. Increment it when a field is added, removed or moved: postcard stores no names
/// and would decode one field as another.
pub const VERSION: u16 = 3;

/// Maximum length of a record, bytes.
pub const MAX_RECORD: usize = 1024;

/// Length of magic (4), version (2) and length (2), bytes.
const HEADER: usize = 8;
/// Length of the CRC, bytes.
const TRAILER: usize = 4;

/// Value of erased flash.
const ERASED: u8 = 0xff;

/// The CRC with a table of 16 entries. It has a fourth of the speed of a table with 256 entries, and needs a sixteenth
/// of its flash.
const CRC: Crc<u32, Table<1>> = Crc::<u32, Table<1>>::new(&CRC_32_ISO_HDLC);

/// The record does not fit into the buffer, or into [`MAX_RECORD`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EncodeError;

impl fmt::Display for EncodeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the configuration does not fit into a record")
    }
}

impl core::error::Error for EncodeError {}

/// The reason why bytes are not a record of this version.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DecodeError {
    /// Erased flash: no record is stored.
    Empty,
    /// The bytes do not begin with [`MAGIC`].
    Magic,
    /// The bytes end before the end of the record.
    Truncated,
    /// The length field is above the maximum.
    Length,
    /// The checksum is wrong.
    Checksum,
    /// The record is valid, but has this other version.
    Version(u16),
    /// The record has the right version and checksum, but its content is not a configuration.
    Content,
}

impl DecodeError {
    /// Returns a short text for logs.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Empty => "nothing is stored",
            Self::Magic => "not a record",
            Self::Truncated => "truncated",
            Self::Length => "length above the maximum",
            Self::Checksum => "wrong checksum",
            Self::Version(_) => "another version",
            Self::Content => "not a configuration",
        }
    }
}

impl fmt::Display for DecodeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Version(version) => write!(f, "version {version}, must be {VERSION}"),
            _ => f.write_str(self.name()),
        }
    }
}

impl core::error::Error for DecodeError {}

/// Writes the record of `config` to the beginning of `record`, and returns the written part. A buffer of [`MAX_RECORD`]
/// bytes is large enough.
///
/// # Errors
/// The buffer is too small.
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

/// Decodes the record at the beginning of `bytes`.
///
/// # Errors
/// The record is missing, damaged, or has another version.
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
