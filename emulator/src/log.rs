//! The firmware's log, read from the memory of the emulated chip as a debug probe reads it from a real chip.

use std::io::{self, Write as _};

use firmware_log::{Decoder, Memory, RttError, drain, rtt_control_block};
use input::InputError;
use rigless::emulator::Host;
use rigless::soc::Width;

use crate::firmware::Firmware;

/// The firmware's log.
pub struct Log {
    decoder: Decoder,
    control_block: u32,
    lines: Vec<String>,
    print: bool,
}

impl Log {
    /// Returns the empty log of an image; `print` prints its lines on standard error.
    ///
    /// # Errors
    /// The image has no log.
    pub fn new(firmware: &Firmware, print: bool) -> Result<Self, InputError> {
        let refused = |reason: String| InputError::new(reason).file(firmware.name());
        let decoder = Decoder::new(firmware.elf()).map_err(|error| refused(error.to_string()))?;
        let control_block = rtt_control_block(firmware.elf()).ok_or_else(|| refused("has no log".into()))?;
        Ok(Self { decoder, control_block, lines: Vec::new(), print })
    }

    /// Reads the new lines from the chip's memory.
    pub fn fetch(&mut self, host: &mut dyn Host) {
        let bytes = match drain(&mut Guest(host), self.control_block) {
            Ok(bytes) => bytes,
            // The firmware has not set up the ring yet.
            Err(RttError::NotThere) => return,
            Err(error) => {
                self.add(error.to_string());
                return;
            }
        };
        for line in self.decoder.push(&bytes) {
            self.add(line.to_string());
        }
    }

    fn add(&mut self, line: String) {
        // A persistent error occurs at each fetch: keep it once.
        if self.lines.last() == Some(&line) {
            return;
        }
        if self.print {
            // A closed standard error must not end the flight.
            let _ = writeln!(io::stderr(), "{line}");
        }
        self.lines.push(line);
    }

    /// Returns all lines.
    pub fn into_lines(self) -> Vec<String> {
        self.lines
    }
}

/// The memory of the emulated chip.
struct Guest<'a>(&'a mut dyn Host);

impl Memory for Guest<'_> {
    fn read(&mut self, address: u32, bytes: &mut [u8]) -> io::Result<()> {
        for (byte, at) in bytes.iter_mut().zip(u64::from(address)..) {
            *byte = self.0.read(at, Width::W8).map_err(io::Error::other)? as u8;
        }
        Ok(())
    }

    fn write_u32(&mut self, address: u32, value: u32) -> io::Result<()> {
        self.0.write(u64::from(address), Width::W32, u64::from(value)).map_err(io::Error::other)
    }
}
