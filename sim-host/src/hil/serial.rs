//! A board at a serial port.
//!
//! The state of a board at the end of a cable is unknown, so both a frame and the board have a limit. After
//! [`FRAME_WAIT`] without an answer the frame counts as lost and the next is sent. After [`MAX_UNANSWERED`] lost frames
//! in a row the board counts as silent.

use std::io::{self, Read, Write};
use std::path::Path;
use std::time::Duration;

use serial2::SerialPort;

use super::link::{OnTimeout, Wire};
use input::InputError;

/// Rate of the port, bits per second; 8 data bits, no parity, one stop bit. A step and its answer have at most 120
/// bytes, or 1,200 bits, which take 1.3 ms.
pub const BAUD: u32 = 921_600;
/// Longest wait for the answer to a frame. A USB converter alone may delay a byte by 16 ms; QEMU on a busy
/// machine may take much longer.
const FRAME_WAIT: Duration = Duration::from_secs(2);
/// Number of frames in a row without an answer after which the flight ends.
const MAX_UNANSWERED: u32 = 10;

/// A serial port with a board.
pub struct Serial {
    port: SerialPort,
    unanswered: u32,
}

impl Serial {
    /// Opens the port with this name.
    ///
    /// # Errors
    /// The port does not exist, or cannot be configured.
    pub fn open(name: &Path) -> Result<Self, InputError> {
        let open = || {
            let mut port = SerialPort::open(name, BAUD)?;
            port.set_read_timeout(FRAME_WAIT)?;
            port.set_write_timeout(FRAME_WAIT * MAX_UNANSWERED)?;
            io::Result::Ok(Self { port, unanswered: 0 })
        };
        open().map_err(|error| {
            InputError::new(format!("cannot be opened: {error}")).field("--serial").value(name.display())
        })
    }
}

impl Read for Serial {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let length = self.port.read(buffer)?;
        self.unanswered = 0;
        Ok(length)
    }
}

impl Write for Serial {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.port.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.port.flush()
    }
}

impl Wire for Serial {
    fn on_timeout(&mut self) -> OnTimeout {
        self.unanswered += 1;
        if self.unanswered < MAX_UNANSWERED {
            OnTimeout::NextFrame
        } else {
            OnTimeout::Silent(format!("no answer to {MAX_UNANSWERED} frames in a row"))
        }
    }
}
