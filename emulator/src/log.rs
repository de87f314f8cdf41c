//! The firmware's log, fetched from the memory of the emulated chip as a debug probe fetches it from a real one.

use std::io::{self, Write as _};

use firmware_log::{Decoder, Memory, RttError, drain, rtt_control_block};
use input::InputError;
use rigless::emulator::Host;
use rigless::soc::Width;

use crate::firmware::Firmware;

/// The log so far.
pub struct Log {
    decoder: Decoder,
    control_block: u32,
    lines: Vec<String>,
    print: bool,
}

impl Log {
    /// The log of an image that has not started yet.
    ///
    /// # Errors
    /// The image has none.
    pub fn new(firmware: &Firmware, print: bool) -> Result<Self, InputError> {
        let refused = |why: String| InputError::new(why).file(firmware.name());
        let decoder = Decoder::new(firmware.elf()).map_err(|error| refused(error.to_string()))?;
        let control_block = rtt_control_block(firmware.elf()).ok_or_else(|| refused("has no log".into()))?;
        Ok(Self { decoder, control_block, lines: Vec::new(), print })
    }

    /// Takes what is new.
    pub fn fetch(&mut self, host: &mut dyn Host) {
        let bytes = match drain(&mut Guest(host), self.control_block) {
            Ok(bytes) => bytes,
            // Between a reset and the firmware's first line.
            Err(RttError::NotThere) => return,
            Err(error) => {
                self.take(error.to_string());
                return;
            }
        };
        for line in self.decoder.push(&bytes) {
            self.take(line.to_string());
        }
    }

    fn take(&mut self, line: String) {
        // An error that stands comes back at every look.
        if self.lines.last() == Some(&line) {
            return;
        }
        if self.print {
            // A reader that has gone away is no reason to end the flight.
            let _ = writeln!(io::stderr(), "{line}");
        }
        self.lines.push(line);
    }

    /// The lines.
    pub fn into_lines(self) -> Vec<String> {
        self.lines
    }
}

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
