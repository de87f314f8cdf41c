//! SEGGER's real-time transfer, the target's side of which is the crate `defmt-rtt`: a ring in RAM that the firmware
//! writes and a debugger reads, while both run.
//!
//! # The control block
//! It is at the symbol `_SEGGER_RTT`; all numbers are 32 bits, little-endian.
//!
//! | at | what | written by |
//! |---|---|---|
//! | 0 | `SEGGER RTT`, and six zeros | start of the firmware |
//! | 16 | number of channels to the host, `n` | start |
//! | 20 | number of channels from the host | start |
//! | 24 | `n` channels of 24 bytes each, the first of which is defmt's | |
//!
//! | at | of a channel | written by |
//! |---|---|---|
//! | 0 | address of its name | start |
//! | 4 | address of the ring | start |
//! | 8 | bytes of the ring | start |
//! | 12 | place in the ring that is written next | firmware |
//! | 16 | place that is read next | host |
//! | 20 | what to do if the ring is full: 0 skip, 1 trim, 2 wait | host |
//!
//! The ring is empty when both places are the same, so it holds one byte less than it has. Kestrel's firmware never
//! waits, whatever the last number says: a line for which there is no room is dropped as a whole.

use std::{fmt, io};

use object::{Object as _, ObjectSymbol as _};

const ID: &[u8; 16] = b"SEGGER RTT\0\0\0\0\0\0";
/// Bytes of the control block up to the end of its first channel.
const HEADER: usize = 24 + 24;
/// Place of the first channel's `read` in the control block.
const READ: u32 = 24 + 16;
/// More than this, bytes, no ring has: the largest microcontroller has less RAM.
const MAX_RING: u32 = 1 << 24;

/// A microcontroller's memory.
pub trait Memory {
    /// Fills `bytes` from `address` on.
    ///
    /// # Errors
    /// There is no such memory, or it cannot be reached.
    fn read(&mut self, address: u32, bytes: &mut [u8]) -> io::Result<()>;

    /// Writes a word at a multiple of four.
    ///
    /// # Errors
    /// There is no such memory, or it cannot be reached.
    fn write_u32(&mut self, address: u32, value: u32) -> io::Result<()>;
}

impl<M: Memory + ?Sized> Memory for &mut M {
    fn read(&mut self, address: u32, bytes: &mut [u8]) -> io::Result<()> {
        (**self).read(address, bytes)
    }

    fn write_u32(&mut self, address: u32, value: u32) -> io::Result<()> {
        (**self).write_u32(address, value)
    }
}

/// Why the ring cannot be read.
#[derive(Debug)]
pub enum RttError {
    /// The firmware has not started yet, or the address is not that of a control block.
    NotThere,
    /// A number in it that cannot be.
    Damaged {
        /// Which one.
        what: &'static str,
        /// The number.
        value: u32,
    },
    /// The memory cannot be read or written.
    Memory {
        /// Where.
        address: u32,
        /// Why.
        error: io::Error,
    },
}

impl fmt::Display for RttError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotThere => write!(f, "there is no RTT control block: the firmware has not started"),
            Self::Damaged { what, value } => {
                write!(f, "the RTT control block is damaged: its {what} is {value:#x}")
            }
            Self::Memory { address, error } => write!(f, "memory at {address:#010x}: {error}"),
        }
    }
}

impl std::error::Error for RttError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Self::Memory { error, .. } => Some(error),
            _ => None,
        }
    }
}

/// The address of the control block in an image; `None` if there is none, or if it is no ELF image.
pub fn rtt_control_block(elf: &[u8]) -> Option<u32> {
    let elf = object::File::parse(elf).ok()?;
    let mut symbols = elf.symbols().filter(|symbol| symbol.name() == Ok("_SEGGER_RTT"));
    symbols.next()?.address().try_into().ok()
}

/// Takes all bytes out of the first channel's ring. The firmware may write while this runs.
///
/// # Errors
/// There is no control block at this address, it makes no sense, or the memory fails. Nothing was taken then.
pub fn drain(memory: &mut impl Memory, control_block: u32) -> Result<Vec<u8>, RttError> {
    let mut header = [0; HEADER];
    read(memory, control_block, &mut header)?;
    if !header.starts_with(ID) {
        return Err(RttError::NotThere);
    }
    let [channels, _, _, ring, size, write, read_from, _] =
        std::array::from_fn(|n| u32::from_le_bytes(std::array::from_fn(|byte| header[16 + 4 * n + byte])));
    let sane = |what, value, is: bool| if is { Ok(()) } else { Err(RttError::Damaged { what, value }) };
    sane("number of channels", channels, (1..=16).contains(&channels))?;
    sane("ring's size", size, (2..=MAX_RING).contains(&size))?;
    sane("ring's address", ring, ring != 0 && ring.checked_add(size).is_some())?;
    sane("place to write", write, write < size)?;
    sane("place to read", read_from, read_from < size)?;
    let place = control_block
        .checked_add(READ)
        .filter(|place| place.is_multiple_of(4))
        .ok_or(RttError::Damaged { what: "own address", value: control_block })?;
    if write == read_from {
        return Ok(Vec::new());
    }

    let (first, wrapped) = if read_from < write { (write - read_from, 0) } else { (size - read_from, write) };
    let mut bytes = vec![0; (first + wrapped) as usize];
    let (head, tail) = bytes.split_at_mut(first as usize);
    read(memory, ring + read_from, head)?;
    if wrapped > 0 {
        read(memory, ring, tail)?;
    }
    memory.write_u32(place, write).map_err(|error| RttError::Memory { address: place, error })?;
    Ok(bytes)
}

fn read(memory: &mut impl Memory, address: u32, bytes: &mut [u8]) -> Result<(), RttError> {
    memory.read(address, bytes).map_err(|error| RttError::Memory { address, error })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const RAM: u32 = 0x2000_0000;
    const BLOCK: u32 = RAM + 0x40;
    const RING: u32 = RAM + 0x100;

    struct Ram(Vec<u8>);

    impl Ram {
        fn range(&self, address: u32, length: usize) -> io::Result<std::ops::Range<usize>> {
            let start = address.checked_sub(RAM).map(|start| start as usize);
            start
                .and_then(|start| Some(start..start.checked_add(length)?))
                .filter(|range| range.end <= self.0.len())
                .ok_or_else(|| io::Error::other("not RAM"))
        }
    }

    impl Memory for Ram {
        fn read(&mut self, address: u32, bytes: &mut [u8]) -> io::Result<()> {
            bytes.copy_from_slice(&self.0[self.range(address, bytes.len())?]);
            Ok(())
        }

        fn write_u32(&mut self, address: u32, value: u32) -> io::Result<()> {
            let range = self.range(address, 4)?;
            self.0[range].copy_from_slice(&value.to_le_bytes());
            Ok(())
        }
    }

    /// RAM with a control block of one channel.
    fn ram(size: u32, write: u32, read: u32) -> Ram {
        let mut ram = Ram(vec![0; 0x200]);
        let at = (BLOCK - RAM) as usize;
        ram.0[at..at + 16].copy_from_slice(ID);
        for (n, value) in [1, 0, 0, RING, size, write, read, 1].into_iter().enumerate() {
            ram.write_u32(BLOCK + 16 + 4 * n as u32, value).unwrap();
        }
        for n in 0..0x100 {
            ram.0[(RING - RAM) as usize + n] = n as u8;
        }
        ram
    }

    #[test]
    fn what_was_written_is_taken_once() {
        let mut straight = ram(16, 7, 3);
        assert_eq!(drain(&mut straight, BLOCK).unwrap(), [3, 4, 5, 6]);
        assert!(drain(&mut straight, BLOCK).unwrap().is_empty());
        assert_eq!(drain(&mut ram(16, 2, 13), BLOCK).unwrap(), [13, 14, 15, 0, 1]);
        assert_eq!(drain(&mut ram(16, 0, 14), BLOCK).unwrap(), [14, 15]);
        assert_eq!(drain(&mut ram(16, 15, 0), BLOCK).unwrap(), (0..15).collect::<Vec<u8>>());
    }

    #[test]
    fn a_damaged_control_block_is_named() {
        let said = |mut ram: Ram| drain(&mut ram, BLOCK).unwrap_err().to_string();
        assert!(said(Ram(vec![0; 0x200])).contains("has not started"));
        assert!(said(ram(16, 16, 0)).contains("place to write is 0x10"));
        assert!(said(ram(16, 0, 0xffff_ffff)).contains("place to read"));
        assert!(said(ram(0, 0, 0)).contains("ring's size is 0x0"));
        assert!(said(ram(MAX_RING + 1, 0, 0)).contains("ring's size"));
        assert!(said(ram(0x1000, 0xf00, 0)).contains("memory at 0x20000100: not RAM"));
        let with = |n: u32, value| {
            let mut ram = ram(16, 7, 3);
            ram.write_u32(BLOCK + 16 + 4 * n, value).unwrap();
            ram
        };
        assert!(said(with(0, 0)).contains("number of channels"));
        assert!(said(with(3, 0xffff_fff8)).contains("ring's address"));
        // Nothing behind the address, or too little.
        let mut block_at_the_end = ram(16, 7, 3);
        for address in [0, RAM + 0x1f0, u32::MAX - 8] {
            assert!(matches!(drain(&mut block_at_the_end, address), Err(RttError::Memory { .. })));
        }
    }

    proptest! {
        #[test]
        fn any_control_block_gives_bytes_or_an_error(words: [u32; 8], places: [u8; 4]) {
            let mut ram = ram(64, 0, 0);
            // Any number in some of its places, a plausible one in the others.
            for (n, place) in places.into_iter().enumerate() {
                let at = BLOCK + 16 + 4 * u32::from(place % 8);
                ram.write_u32(at, if n % 2 == 0 { words[n] } else { words[n] % 96 }).unwrap();
            }
            if let Ok(bytes) = drain(&mut ram, BLOCK) {
                prop_assert!(bytes.len() < 0x200);
                prop_assert!(drain(&mut ram, BLOCK).unwrap().is_empty());
            }
        }
    }
}
