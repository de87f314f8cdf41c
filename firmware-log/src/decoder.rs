//! Decoder from defmt frames to lines of text.

use std::fmt;

use defmt_decoder::{DecodeError, Encoding, Table};

/// Maximum length of a frame, bytes: the ring is much smaller. More bytes without the end of a frame are damaged.
const MAX_FRAME: usize = 1 << 16;

/// Severity of a line. The firmware's build selects the minimum level that it logs (`DEFMT_LOG`).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[expect(missing_docs, reason = "the names say it")]
pub enum Level {
    Trace,
    Debug,
    Info,
    Warn,
    Error,
}

impl Level {
    /// Returns the name, as in defmt's macros.
    pub fn name(self) -> &'static str {
        match self {
            Self::Trace => "trace",
            Self::Debug => "debug",
            Self::Info => "info",
            Self::Warn => "warn",
            Self::Error => "error",
        }
    }

    /// Converts by name, because `defmt_decoder` does not export the type of its levels.
    fn of(frame: &defmt_decoder::Frame<'_>) -> Option<Self> {
        match frame.level()?.as_str() {
            "trace" => Some(Self::Trace),
            "debug" => Some(Self::Debug),
            "info" => Some(Self::Info),
            "warn" => Some(Self::Warn),
            "error" => Some(Self::Error),
            _ => None,
        }
    }
}

/// A line of the log. Its display is `time level message`, the time in seconds.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Line {
    /// Time of the firmware, µs: since its start, or the time of the flight if that is its clock. Its 32 bits are extended:
    /// see [`Decoder::push`]. `None` for a damaged frame, and if the firmware logs no time in microseconds.
    pub time_us: Option<u64>,
    /// Level; `None` for a damaged frame, and for text that is printed without a level.
    pub level: Option<Level>,
    /// Text.
    pub message: String,
}

impl fmt::Display for Line {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.time_us {
            Some(us) => write!(f, "{:5}.{:06} ", us / 1_000_000, us % 1_000_000)?,
            None => write!(f, "{:12} ", "")?,
        }
        write!(f, "{:5} {}", self.level.map_or("", Level::name), self.message)
    }
}

/// The reason why the log of an image cannot be decoded.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Error {
    /// The image is not an ELF file, or its table of messages cannot be read, with the reason.
    Unreadable(String),
    /// The image does not log by defmt, or its symbols were stripped.
    NoLog,
    /// The image uses defmt's raw encoding (feature `encoding-raw`), whose frames have no end mark.
    Encoding,
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unreadable(reason) => write!(f, "the table of log messages cannot be read: {reason}"),
            Self::NoLog => write!(f, "the image has no table of log messages"),
            Self::Encoding => {
                write!(f, "the image must log by defmt's rzcobs encoding, not by the raw encoding")
            }
        }
    }
}

impl std::error::Error for Error {}

/// Decoder for the log of an image.
pub struct Decoder {
    table: Table,
    /// Bytes of an incomplete frame.
    unread: Vec<u8>,
    clock: Clock,
    damaged: u64,
}

impl fmt::Debug for Decoder {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Decoder")
            .field("unread", &self.unread.len())
            .field("damaged", &self.damaged)
            .finish_non_exhaustive()
    }
}

impl Decoder {
    /// Returns a decoder for the log of this image.
    ///
    /// # Errors
    /// The image has no log that can be decoded: see [`Error`].
    pub fn new(elf: &[u8]) -> Result<Self, Error> {
        let table = Table::parse(elf).map_err(|error| Error::Unreadable(format!("{error:#}")))?;
        let table = table.filter(|table| !table.is_empty()).ok_or(Error::NoLog)?;
        match table.encoding() {
            Encoding::Rzcobs => {}
            _ => return Err(Error::Encoding),
        }
        Ok(Self { table, unread: Vec::new(), clock: Clock::default(), damaged: 0 })
    }

    /// Decodes the next bytes, and returns the lines that they complete. A frame that cannot be decoded gives a line with
    /// this message.
    ///
    /// The firmware's time has 32 bits, so it wraps after 71.6 minutes. If a time is earlier than the last one by more
    /// than half of this, the counter has wrapped. If it is earlier by less, it is not changed, because the firmware
    /// was reset, or the line of an interrupt came first. If the first time is in the last second before the wrap, it
    /// is a time before zero and is returned as zero: with the time of a flight as its clock, the firmware starts
    /// shortly before zero.
    pub fn push(&mut self, bytes: &[u8]) -> Vec<Line> {
        self.unread.extend_from_slice(bytes);
        let end = match self.unread.iter().rposition(|&byte| byte == 0) {
            Some(last) => last + 1,
            None if self.unread.len() > MAX_FRAME => self.unread.len(),
            None => return Vec::new(),
        };
        let frames: Vec<u8> = self.unread.drain(..end).collect();
        frames
            .split(|&byte| byte == 0)
            .filter(|frame| !frame.is_empty())
            .map(|frame| self.line(frame))
            .collect()
    }

    /// Returns the number of frames that could not be decoded.
    pub fn damaged(&self) -> u64 {
        self.damaged
    }

    /// Decodes a frame, given without the zero at its end, to a line.
    fn line(&mut self, frame: &[u8]) -> Line {
        let mut stream = self.table.new_stream_decoder();
        stream.received(frame);
        stream.received(&[0]);
        match stream.decode() {
            Ok(frame) => {
                let time = frame.display_timestamp().and_then(|time| microseconds(&time.to_string()));
                Line {
                    time_us: time.map(|us| self.clock.extend(us)),
                    level: Level::of(&frame),
                    message: frame.display_message().to_string(),
                }
            }
            Err(DecodeError::Malformed | DecodeError::UnexpectedEof) => {
                self.damaged += 1;
                let message = format!("damaged frame of {} bytes", frame.len());
                Line { time_us: None, level: None, message }
            }
        }
    }
}

/// Parses a time in the form `seconds.microseconds`, in which defmt displays `{=u32:us}`; returns `None` for another form.
fn microseconds(text: &str) -> Option<u64> {
    let (seconds, fraction) = text.split_once('.')?;
    let digits = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    if !digits(seconds) || !digits(fraction) || fraction.len() != 6 {
        return None;
    }
    seconds.parse::<u64>().ok()?.checked_mul(1_000_000)?.checked_add(fraction.parse().ok()?)
}

/// Extension of a 32-bit time in microseconds to 64 bits.
#[derive(Clone, Copy, Debug, Default)]
struct Clock {
    last: Option<u64>,
    wraps: i64,
}

impl Clock {
    /// Period after which the time wraps, µs.
    const PERIOD: u64 = 1 << 32;

    /// Extends a time, µs.
    fn extend(&mut self, us: u64) -> u64 {
        if us >= Self::PERIOD {
            return us;
        }
        match self.last {
            None if us >= Self::PERIOD - 1_000_000 => self.wraps = -1,
            Some(last) if us + Self::PERIOD / 2 < last => self.wraps += 1,
            _ => {}
        }
        self.last = Some(us);
        // A time before zero is returned as zero.
        (us as i64).saturating_add(self.wraps.saturating_mul(Self::PERIOD as i64)).max(0) as u64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_stamp_needs_seconds_with_six_decimals() {
        assert_eq!(microseconds("0.000000"), Some(0));
        assert_eq!(microseconds("4294.967295"), Some(u64::from(u32::MAX)));
        for other in ["", "12", "12.345", "0:00:01.000000", "-1.000000", "1.0000000", "1.+00001"] {
            assert_eq!(microseconds(other), None, "{other}");
        }
        assert_eq!(microseconds("99999999999999999999.000000"), None);
        assert_eq!(microseconds("18446744073709551.615999"), None);
    }

    #[test]
    fn clock_extends_32_bits_and_accepts_resets() {
        let mut clock = Clock::default();
        assert_eq!(clock.extend(5_000_000), 5_000_000);
        assert_eq!(clock.extend(4_999_990), 4_999_990);
        assert_eq!(clock.extend(10), 10);
        assert_eq!(clock.extend(0xffff_ff00), 0xffff_ff00);
        assert_eq!(clock.extend(0x10), (1 << 32) + 0x10);

        let mut before_zero = Clock::default();
        assert_eq!(before_zero.extend(0xffff_fe0c), 0);
        assert_eq!(before_zero.extend(0xffff_fe20), 0);
        assert_eq!(before_zero.extend(999_500), 999_500);
        assert_eq!(before_zero.extend(0xffff_ff00), 0xffff_ff00);
        assert_eq!(before_zero.extend(7), (1 << 32) + 7);
        // A time of more than 32 bits does not wrap.
        assert_eq!(Clock::default().extend(1 << 33), 1 << 33);
    }
}
