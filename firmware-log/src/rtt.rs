//! SEGGER's real-time transfer (RTT): a ring in RAM that the firmware writes and a debugger reads while the firmware runs.
//! On the target it is implemented by the crate `defmt-rtt`.
//!
//! # Control block
//! The control block is at the symbol `_SEGGER_RTT`. All numbers have 32 bits, little-endian.
//!
//! | offset | content | written by |
//! |---|---|---|
//! | 0 | `SEGGER RTT`, and six zeros | start of the firmware |
//! | 16 | number of channels to the host, `n` | start |
//! | 20 | number of channels from the host | start |
//! | 24 | `n` channels of 24 bytes each; the first is defmt's | |
//!
//! | offset in a channel | content | written by |
//! |---|---|---|
//! | 0 | address of its name | start |
//! | 4 | address of the ring | start |
//! | 8 | size of the ring, bytes | start |
//! | 12 | write offset: position in the ring of the next write | firmware |
//! | 16 | read offset: position of the next read | host |
//! | 20 | mode for a full ring: 0 skip, 1 trim, 2 wait | host |
//!
//! The ring is empty if both offsets are equal, so it can hold one byte less than its size. Kestrel's firmware ignores the
//! mode and never waits: a line that does not fit is dropped as a whole.

use std::{fmt, io};

use object::{Object as _, ObjectSymbol as _};

const ID: &[u8; 16] = b"SEGGER RTT\0\0\0\0\0\0";
/// Length of the control block up to the end of its first channel, bytes.
const HEADER: usize = 24 + 24;
/// Offset of the first channel's read offset in the control block.
const READ: u32 = 24 + 16;
/// Maximum size of a ring, bytes: no microcontroller has more RAM.
const MAX_RING: u32 = 1 << 24;

/// A microcontroller's memory.
pub trait Memory {
    /// Reads the memory from `address` on into `bytes`.
    ///
    /// # Errors
    /// The memory does not exist or cannot be accessed.
    fn read(&mut self, address: u32, bytes: &mut [u8]) -> io::Result<()>;

    /// Writes a word at an address that is a multiple of four.
    ///
    /// # Errors
    /// The memory does not exist or cannot be accessed.
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

/// The reason why the ring cannot be read.
#[derive(Debug)]
pub enum RttError {
    /// The firmware has not started yet, or the address is not that of a control block.
    NotThere,
    /// A number in the control block is invalid.
    Damaged {
        /// Name of the number.
        what: &'static str,
        /// Value.
        value: u32,
    },
    /// The memory cannot be read or written.
    Memory {
        /// Address of the access.
        address: u32,
        /// Reason.
        error: io::Error,
    },
}

impl fmt::Display for RttError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotThere => write!(f, "no RTT control block: the firmware has not started"),
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

/// Returns the address of the control block in an image; `None` if the image has no control block, or is not an ELF file.
pub fn rtt_control_block(elf: &[u8]) -> Option<u32> {
    let elf = object::File::parse(elf).ok()?;
    let mut symbols = elf.symbols().filter(|symbol| symbol.name() == Ok("_SEGGER_RTT"));
    symbols.next()?.address().try_into().ok()
}

/// Reads and removes all bytes of the first channel's ring. The firmware may write at the same time.
///
/// # Errors
/// There is no control block at this address, it is damaged, or the memory cannot be accessed. The ring is unchanged then.
pub fn drain(memory: &mut impl Memory, control_block: u32) -> Result<Vec<u8>, RttError> {
    let mut header = [0; HEADER];
    read(memory, control_block, &mut header)?;
    if !header.starts_with(ID) {
        return Err(RttError::NotThere);
    }
    let [channels, _, _, ring, size, write, read_from, _] =
        std::array::from_fn(|n| u32::from_le_bytes(std::array::from_fn(|byte| header[16 + 4 * n + byte])));
    let check =
        |what, value, valid: bool| if valid { Ok(()) } else { Err(RttError::Damaged { what, value }) };
    check("number of channels", channels, (1..=16).contains(&channels))?;
    check("ring size", size, (2..=MAX_RING).contains(&size))?;
    check("ring address", ring, ring != 0 && ring.checked_add(size).is_some())?;
    check("write offset", write, write < size)?;
    check("read offset", read_from, read_from < size)?;
    let read_offset_at = control_block
        .checked_add(READ)
        .filter(|address| address.is_multiple_of(4))
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
    memory
        .write_u32(read_offset_at, write)
        .map_err(|error| RttError::Memory { address: read_offset_at, error })?;
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

    /// Returns RAM with a control block of one channel.
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
    fn drain_returns_written_bytes_once() {
        let mut straight = ram(16, 7, 3);
        assert_eq!(drain(&mut straight, BLOCK).unwrap(), [3, 4, 5, 6]);
        assert!(drain(&mut straight, BLOCK).unwrap().is_empty());
        assert_eq!(drain(&mut ram(16, 2, 13), BLOCK).unwrap(), [13, 14, 15, 0, 1]);
        assert_eq!(drain(&mut ram(16, 0, 14), BLOCK).unwrap(), [14, 15]);
        assert_eq!(drain(&mut ram(16, 15, 0), BLOCK).unwrap(), (0..15).collect::<Vec<u8>>());
    }

    #[test]
    fn error_names_the_damaged_field() {
        let error = |mut ram: Ram| drain(&mut ram, BLOCK).unwrap_err().to_string();
        assert!(error(Ram(vec![0; 0x200])).contains("has not started"));
        assert!(error(ram(16, 16, 0)).contains("write offset is 0x10"));
        assert!(error(ram(16, 0, 0xffff_ffff)).contains("read offset"));
        assert!(error(ram(0, 0, 0)).contains("ring size is 0x0"));
        assert!(error(ram(MAX_RING + 1, 0, 0)).contains("ring size"));
        assert!(error(ram(0x1000, 0xf00, 0)).contains("memory at 0x20000100: not RAM"));
        let with = |n: u32, value| {
            let mut ram = ram(16, 7, 3);
            ram.write_u32(BLOCK + 16 + 4 * n, value).unwrap();
            ram
        };
        assert!(error(with(0, 0)).contains("number of channels"));
        assert!(error(with(3, 0xffff_fff8)).contains("ring address"));
        // There is no memory at the address, or too little after it.
        let mut block_at_the_end = ram(16, 7, 3);
        for address in [0, RAM + 0x1f0, u32::MAX - 8] {
            assert!(matches!(drain(&mut block_at_the_end, address), Err(RttError::Memory { .. })));
        }
    }

    proptest! {
        #[test]
        fn any_control_block_gives_bytes_or_an_error(words: [u32; 8], fields: [u8; 4]) {
            let mut ram = ram(64, 0, 0);
            // Some fields have random numbers, others plausible ones.
            for (n, field) in fields.into_iter().enumerate() {
                let at = BLOCK + 16 + 4 * u32::from(field % 8);
                ram.write_u32(at, if n % 2 == 0 { words[n] } else { words[n] % 96 }).unwrap();
            }
            if let Ok(bytes) = drain(&mut ram, BLOCK) {
                prop_assert!(bytes.len() < 0x200);
                prop_assert!(drain(&mut ram, BLOCK).unwrap().is_empty());
            }
        }
    }
}
