//! Frames of defmt to lines of text.

use std::fmt;

use defmt_decoder::{DecodeError, Encoding, Table};

/// More bytes without the end of a frame are none: the ring is far smaller.
const MAX_FRAME: usize = 1 << 16;

/// How urgent a line is. The firmware's build chooses from which level on it logs (`DEFMT_LOG`).
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
    /// Its name, as the log macros have it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Trace => "trace",
            Self::Debug => "debug",
            Self::Info => "info",
            Self::Warn => "warn",
            Self::Error => "error",
        }
    }

    /// The decoder's type is of a crate that it does not re-export.
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
    /// The firmware's time, µs: since its start, or of the flight if that is where its time comes from. Its 32 bits
    /// are extended: see [`Decoder::push`]. `None` for a damaged frame, and if the firmware logs no time in
    /// microseconds.
    pub time_us: Option<u64>,
    /// `None` for a damaged frame, and for what is printed without a level.
    pub level: Option<Level>,
    /// The text.
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

/// Why there is no decoder for an image.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Error {
    /// It is not an ELF image, or its table of messages cannot be read: the reason.
    Unreadable(String),
    /// It logs nothing by defmt, or its symbols were stripped.
    NoLog,
    /// Its frames are not marked where they end (defmt's feature `encoding-raw`).
    Encoding,
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unreadable(why) => write!(f, "the table of log messages cannot be read: {why}"),
            Self::NoLog => write!(f, "the image has no table of log messages"),
            Self::Encoding => write!(f, "the image logs by defmt's raw encoding; only rzcobs is decoded"),
        }
    }
}

impl std::error::Error for Error {}

/// Decodes the log of one image.
pub struct Decoder {
    table: Table,
    /// The beginning of a frame that has not ended yet.
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
    /// A decoder for what this image logs.
    ///
    /// # Errors
    /// It is not an image with a log: [`Error`].
    pub fn new(elf: &[u8]) -> Result<Self, Error> {
        let table = Table::parse(elf).map_err(|why| Error::Unreadable(format!("{why:#}")))?;
        let table = table.filter(|table| !table.is_empty()).ok_or(Error::NoLog)?;
        match table.encoding() {
            Encoding::Rzcobs => {}
            _ => return Err(Error::Encoding),
        }
        Ok(Self { table, unread: Vec::new(), clock: Clock::default(), damaged: 0 })
    }

    /// Takes the next bytes, and returns the lines that they complete. A frame that cannot be decoded is a line that
    /// says so.
    ///
    /// The firmware's time has 32 bits, 71.6 minutes. A time that lies more than half of that before the last one is
    /// taken for the next round. One that lies less far before it is left as it is: the firmware was reset, or a line
    /// was overtaken by that of an interrupt. If the first time is in the last second of the 71.6 minutes, it is before
    /// zero, and given as zero: where time comes from a flight, the firmware starts shortly before that.
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

    /// Frames that could not be decoded so far.
    pub fn damaged(&self) -> u64 {
        self.damaged
    }

    /// The line of a frame, without the zero at its end.
    fn line(&mut self, frame: &[u8]) -> Line {
        let mut stream = self.table.new_stream_decoder();
        stream.received(frame);
        stream.received(&[0]);
        match stream.decode() {
            Ok(frame) => {
                let time = frame.display_timestamp().and_then(|time| microseconds(&time.to_string()));
                Line {
                    time_us: time.map(|us| self.clock.at(us)),
                    level: Level::of(&frame),
                    message: frame.display_message().to_string(),
                }
            }
            Err(DecodeError::Malformed | DecodeError::UnexpectedEof) => {
                self.damaged += 1;
                let message = format!("a damaged frame, {} bytes", frame.len());
                Line { time_us: None, level: None, message }
            }
        }
    }
}

/// The time in `seconds.microseconds`, as defmt shows a `{=u32:us}`; `None` for any other form.
fn microseconds(text: &str) -> Option<u64> {
    let (seconds, fraction) = text.split_once('.')?;
    let digits = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    if !digits(seconds) || !digits(fraction) || fraction.len() != 6 {
        return None;
    }
    seconds.parse::<u64>().ok()?.checked_mul(1_000_000)?.checked_add(fraction.parse().ok()?)
}

/// The extension of 32 bits of microseconds.
#[derive(Clone, Copy, Debug, Default)]
struct Clock {
    last: Option<u64>,
    rounds: i64,
}

impl Clock {
    const ROUND: u64 = 1 << 32;

    fn at(&mut self, us: u64) -> u64 {
        if us >= Self::ROUND {
            return us;
        }
        match self.last {
            None if us >= Self::ROUND - 1_000_000 => self.rounds = -1,
            Some(last) if us + Self::ROUND / 2 < last => self.rounds += 1,
            _ => {}
        }
        self.last = Some(us);
        // What is before zero is given as zero.
        (us as i64).saturating_add(self.rounds.saturating_mul(Self::ROUND as i64)).max(0) as u64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_seconds_with_six_decimals_are_a_time() {
        assert_eq!(microseconds("0.000000"), Some(0));
        assert_eq!(microseconds("4294.967295"), Some(u64::from(u32::MAX)));
        for other in ["", "12", "12.345", "0:00:01.000000", "-1.000000", "1.0000000", "1.+00001"] {
            assert_eq!(microseconds(other), None, "{other}");
        }
        assert_eq!(microseconds("99999999999999999999.000000"), None);
        assert_eq!(microseconds("18446744073709551.615999"), None);
    }

    #[test]
    fn the_clock_wraps_and_a_reset_begins_anew() {
        let mut clock = Clock::default();
        assert_eq!(clock.at(5_000_000), 5_000_000);
        assert_eq!(clock.at(4_999_990), 4_999_990);
        assert_eq!(clock.at(10), 10);
        assert_eq!(clock.at(0xffff_ff00), 0xffff_ff00);
        assert_eq!(clock.at(0x10), (1 << 32) + 0x10);

        let mut before_zero = Clock::default();
        assert_eq!(before_zero.at(0xffff_fe0c), 0);
        assert_eq!(before_zero.at(0xffff_fe20), 0);
        assert_eq!(before_zero.at(999_500), 999_500);
        assert_eq!(before_zero.at(0xffff_ff00), 0xffff_ff00);
        assert_eq!(before_zero.at(7), (1 << 32) + 7);
        // What has more than 32 bits is no count that wraps.
        assert_eq!(Clock::default().at(1 << 33), 1 << 33);
    }
}
