//! The link to the firmware, in lock-step: frames of `hil-link` over any wire.
//!
//! # Reactions to an answer
//! | the firmware sends | reaction |
//! |---|---|
//! | the answer with the number of the step | the step is done |
//! | `Bad`, or a damaged frame | the step has no answer: the motors keep their pulses, and the next step is sent |
//! | nothing, on a wire that may lose frames | the same |
//! | `Ready` | the firmware was reset: the motors stop, the firmware is configured again, and the flight goes on |
//! | an answer to an earlier step, or a repeated answer | it is ignored, and the wait goes on |
//! | nothing, on a wire that loses no frames; the end of the wire; another version | the flight ends |
//!
//! No frame is sent twice: a lost sample stays lost, as on a sensor bus. All events are counted. Each wait is bounded: by
//! the wire's [`OnTimeout`], by the number of resets, and by the number of bytes without an answer.

use std::fmt;
use std::io::{self, Read, Write};
use std::num::NonZeroU32;
use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use flight_core::Config;
use flight_core::geometry::Quaternion;
use flight_core::sample::Input;
use hil_link::{Decoder, Done, FrameError, MAX_FRAME, Order, Received, Step, ToBoard, ToHost, encode};

use crate::flight::{Autopilot, AutopilotOutput};

/// Resets of the firmware that a flight may have; one more ends it.
const MAX_RESETS: usize = 10;
/// Bytes without an answer that a flight may have in a row; one more ends it.
const MAX_NOISE_BYTES: usize = 100 * MAX_FRAME;
/// Read timeouts after which the configuration is sent again: a port that has just been opened may lose the first bytes.
const TIMEOUTS_PER_START: u32 = 10;

/// A wire that carries bytes to the firmware and from it.
///
/// A read waits for a short time. After a timeout it returns the error [`WouldBlock`](io::ErrorKind::WouldBlock) or
/// [`TimedOut`](io::ErrorKind::TimedOut). A read of 0 bytes means that the far end has closed the wire.
pub trait Wire: Read + Write {
    /// Decides what to do after a read timeout.
    fn on_timeout(&mut self) -> OnTimeout;
}

impl<W: Wire> Wire for &mut W {
    fn on_timeout(&mut self) -> OnTimeout {
        (**self).on_timeout()
    }
}

/// Reaction to a read timeout.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum OnTimeout {
    /// Read again.
    Wait,
    /// Treat the frame as lost and send the next.
    NextFrame,
    /// End the flight: the firmware is silent. The text says by which criterion.
    Silent(String),
}

/// Reason for which a link ends a flight.
#[derive(Debug)]
pub enum LinkError {
    /// The far end has closed the wire.
    Closed,
    /// The firmware sends nothing.
    Silent(String),
    /// The firmware sends bytes, but no valid answer.
    Noise,
    /// The firmware uses another version of the link.
    Version(u8),
    /// A valid frame with an unknown message type.
    Unknown,
    /// The firmware refuses the configuration.
    Refused,
    /// The firmware answers a step with another time, µs.
    WrongTime {
        /// Time of the step.
        asked_us: u64,
        /// Time in the answer.
        answered_us: u64,
    },
    /// The firmware was reset more than `MAX_RESETS` times.
    Resets,
    /// The flag `stop` was set, for example by Ctrl-C.
    Interrupted,
    /// Sending or receiving failed.
    Io(io::Error),
}

impl fmt::Display for LinkError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Closed => write!(f, "the far end has closed the link"),
            Self::Silent(why) => write!(f, "the firmware is silent: {why}"),
            Self::Noise => {
                write!(f, "{MAX_NOISE_BYTES} bytes without an answer: is this Kestrel's firmware?")
            }
            Self::Version(version) => {
                write!(
                    f,
                    "the firmware has {}: build both from the same sources",
                    FrameError::Version(*version)
                )
            }
            Self::Unknown => {
                write!(f, "the firmware sends an unknown message: build both from the same sources")
            }
            Self::Refused => write!(
                f,
                "the firmware refuses the configuration: it is already in a flight (reset it), or cannot fly this scene"
            ),
            Self::WrongTime { asked_us, answered_us } => {
                write!(f, "the firmware answers the step at {asked_us} µs with the time {answered_us} µs")
            }
            Self::Resets => write!(f, "the firmware was reset more than {MAX_RESETS} times"),
            Self::Interrupted => write!(f, "interrupted"),
            Self::Io(error) => write!(f, "the link failed: {error}"),
        }
    }
}

impl std::error::Error for LinkError {}

/// Faults of the frames to the firmware, for tests of the link. The configuration always arrives.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Faults {
    /// `Some(n)` flips one bit in every n-th frame with a step.
    pub flip_bit_every: Option<NonZeroU32>,
    /// Frames in this interval of the scene, µs, are not sent.
    pub dropped_us: Range<u64>,
}

impl Faults {
    /// Flips a bit of the `n`-th frame, counted from 1, if n is a multiple of `flip_bit_every`. It is another bit each
    /// time, and may lie in the zero at the end of the frame.
    fn flip(&self, n: u64, frame: &mut [u8]) {
        let Some(every) = self.flip_bit_every else { return };
        let every = u64::from(every.get());
        if n.is_multiple_of(every) {
            // 40,503 = 2¹⁶ / 1.618 (the golden ratio), which spreads the bits evenly over the frame.
            let bit = n / every * 40_503 % (8 * frame.len() as u64);
            frame[bit as usize / 8] ^= 1 << (bit % 8);
        }
    }
}

/// A reset of the firmware in flight.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reset {
    /// Time of the step at which the link noticed it, µs.
    pub time_us: u64,
    /// Whether the watchdog caused it.
    pub by_watchdog: bool,
}

/// Counters of a link over a flight.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Report {
    /// Frames with steps to the firmware, including those that a fault dropped.
    pub frames: u64,
    /// Steps without an answer.
    pub unanswered: u64,
    /// Frames to the firmware that it reports as damaged, lost or repeated.
    pub to_board: Received,
    /// Frames from the firmware that were damaged, lost or repeated. Late frames count as repeated.
    pub to_host: Received,
    /// Resets of the firmware.
    pub resets: Vec<Reset>,
    /// Deadlines that the firmware's tasks have missed: the largest count between two resets.
    pub missed_deadlines: u32,
    /// Answers with a number of instructions.
    pub counted: u64,
    /// Sum of the instructions of these answers.
    pub instructions: u64,
    /// Largest number of instructions of one answer.
    pub max_instructions: u32,
}

impl Report {
    /// Whether every frame arrived once and undamaged, and the firmware was not reset.
    pub fn is_clean(&self) -> bool {
        let none = Received::default();
        self.unanswered == 0 && self.resets.is_empty() && self.to_board == none && self.to_host == none
    }

    /// Returns the mean number of instructions from sample to motors; `None` if the firmware does not count them.
    pub fn mean_instructions(&self) -> Option<f64> {
        (self.counted > 0).then(|| self.instructions as f64 / self.counted as f64)
    }
}

/// The link to the firmware. The first step configures and starts the firmware.
pub struct Link<W> {
    wire: W,
    config: Config,
    faults: Faults,
    stop: Arc<AtomicBool>,
    decoder: Decoder,
    /// Received bytes, and the range of them that is not yet decoded.
    bytes: [u8; 512],
    unread: Range<usize>,
    /// Bytes received since the last answer.
    noise: usize,
    started: bool,
    /// Sequence number of the next frame.
    next: u32,
    /// Sequence number of the last frame that was answered, by `Done`, `Bad` or a damaged frame.
    answered: Option<u32>,
    /// The last valid answer, whose pulses the motors keep.
    last: AutopilotOutput,
    /// Counters that the firmware reports: since its last start, and the sum of those before.
    to_board: Received,
    to_board_before: Received,
    report: Report,
}

/// Result of waiting for a frame.
enum Incoming {
    Message(u32, ToHost),
    Damaged,
    /// The wire treats the frame as lost.
    Timeout,
}

/// Outputs of a firmware that has just started.
const AT_REST: AutopilotOutput = AutopilotOutput {
    driven: false,
    pulses_us: [1_000.0; 4],
    state: flight_core::ArmState::Disarmed,
    event: None,
    attitude: Quaternion::IDENTITY,
    rates_rad_s: None,
};

impl<W: Wire> Link<W> {
    /// Creates a link over `wire` to a firmware that will fly with `config`. Setting `stop` ends the flight.
    pub fn new(wire: W, config: Config, faults: Faults, stop: Arc<AtomicBool>) -> Self {
        Self {
            wire,
            config,
            faults,
            stop,
            decoder: Decoder::default(),
            bytes: [0; 512],
            unread: 0..0,
            noise: 0,
            started: false,
            next: 0,
            answered: None,
            last: AT_REST,
            to_board: Received::default(),
            to_board_before: Received::default(),
            report: Report::default(),
        }
    }

    /// Returns the counters of the flight.
    pub fn into_report(self) -> Report {
        Report { to_board: sum(self.to_board_before, self.to_board), ..self.report }
    }

    /// Tells the firmware that the flight is over. An error is ignored: the far end may be gone.
    pub fn end(&mut self) {
        let _ = self.send(self.next, &ToBoard::End, |_| ());
    }

    /// Sends a message, after `spoil` has changed the bytes of the frame.
    fn send(
        &mut self,
        number: u32,
        message: &ToBoard,
        spoil: impl FnOnce(&mut [u8]),
    ) -> Result<(), LinkError> {
        let mut frame = [0; MAX_FRAME];
        let length = encode(number, message, &mut frame)
            .map_err(|_| LinkError::Io(io::Error::other("a message longer than a frame")))?;
        spoil(&mut frame[..length]);
        // Send a second zero. If the flipped bit is in the zero that ends the frame, this one ends it, so that the
        // firmware answers.
        let mut bytes = [0; MAX_FRAME + 1];
        bytes[..length].copy_from_slice(&frame[..length]);
        self.wire.write_all(&bytes[..=length]).and_then(|()| self.wire.flush()).map_err(LinkError::Io)
    }

    /// Waits for the next frame.
    fn receive(&mut self) -> Result<Incoming, LinkError> {
        loop {
            for at in self.unread.by_ref() {
                match self.decoder.push(self.bytes[at]) {
                    None => {}
                    Some(Ok(packet)) => {
                        let message = packet.message().ok_or(LinkError::Unknown)?;
                        return Ok(Incoming::Message(packet.sequence, message));
                    }
                    Some(Err(FrameError::Version(version))) => return Err(LinkError::Version(version)),
                    Some(Err(_)) => return Ok(Incoming::Damaged),
                }
            }
            if self.stop.load(Ordering::Relaxed) {
                return Err(LinkError::Interrupted);
            }
            if self.noise > MAX_NOISE_BYTES {
                return Err(LinkError::Noise);
            }
            match self.wire.read(&mut self.bytes) {
                Ok(0) => return Err(LinkError::Closed),
                Ok(length) => {
                    self.unread = 0..length;
                    self.noise += length;
                }
                Err(error) => match error.kind() {
                    io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut => match self.wire.on_timeout() {
                        OnTimeout::Wait => {}
                        OnTimeout::NextFrame => return Ok(Incoming::Timeout),
                        OnTimeout::Silent(why) => return Err(LinkError::Silent(why)),
                    },
                    io::ErrorKind::Interrupted => {}
                    _ => return Err(LinkError::Io(error)),
                },
            }
        }
    }

    /// Waits for the firmware and configures it.
    fn start(&mut self) -> Result<(), LinkError> {
        // A board that started before this program has sent its `Ready` already, so a timeout also ends the wait.
        while !matches!(self.receive()?, Incoming::Message(_, ToHost::Ready(_)) | Incoming::Timeout) {}
        self.configure()
    }

    /// Sends the configuration until the firmware has started.
    fn configure(&mut self) -> Result<(), LinkError> {
        let start = ToBoard::Start(self.config);
        (self.next, self.answered) = (1, Some(0));
        self.send(0, &start, |_| ())?;
        let (mut resets, mut timeouts) = (0, 0);
        loop {
            match self.receive()? {
                Incoming::Message(_, ToHost::Started) => break,
                Incoming::Message(_, ToHost::Refused) => return Err(LinkError::Refused),
                // The firmware was reset again before it read the configuration.
                Incoming::Message(_, ToHost::Ready(_)) if resets == MAX_RESETS => {
                    return Err(LinkError::Resets);
                }
                Incoming::Message(_, ToHost::Ready(_)) => {
                    resets += 1;
                    self.send(0, &start, |_| ())?;
                }
                Incoming::Timeout => {
                    timeouts += 1;
                    if timeouts % TIMEOUTS_PER_START == 0 {
                        self.send(0, &start, |_| ())?;
                    }
                }
                // Frames of an earlier flight.
                Incoming::Message(_, ToHost::Done(_) | ToHost::Bad(_)) | Incoming::Damaged => {}
            }
        }
        self.noise = 0;
        self.started = true;
        Ok(())
    }

    /// Records a reset and configures the firmware again; the motors are stopped until then.
    fn restart(&mut self, time_us: u64, by_watchdog: bool) -> Result<AutopilotOutput, LinkError> {
        self.report.resets.push(Reset { time_us, by_watchdog });
        if self.report.resets.len() > MAX_RESETS {
            return Err(LinkError::Resets);
        }
        self.to_board_before = sum(self.to_board_before, std::mem::take(&mut self.to_board));
        self.last = AT_REST;
        self.configure()?;
        Ok(self.unanswered())
    }

    /// Counts a step without an answer; the motors keep their pulses.
    fn unanswered(&mut self) -> AutopilotOutput {
        self.report.unanswered += 1;
        AutopilotOutput { event: None, ..self.last }
    }

    /// Takes the answer to a step.
    fn accept(&mut self, number: u32, asked_us: u64, done: &Done) -> Result<AutopilotOutput, LinkError> {
        if done.time_us != asked_us {
            return Err(LinkError::WrongTime { asked_us, answered_us: done.time_us });
        }
        self.answered = Some(number);
        self.noise = 0;
        self.to_board = done.received;
        let report = &mut self.report;
        report.missed_deadlines = report.missed_deadlines.max(done.missed_deadlines);
        if done.instructions > 0 {
            report.counted += 1;
            report.instructions += u64::from(done.instructions);
            report.max_instructions = report.max_instructions.max(done.instructions);
        }
        let [w, x, y, z] = done.attitude;
        self.last = AutopilotOutput {
            driven: done.driven,
            pulses_us: done.pulses_us,
            state: done.state,
            event: done.event,
            attitude: Quaternion::new(w, x, y, z),
            rates_rad_s: None,
        };
        Ok(self.last)
    }
}

impl<W: Wire> Autopilot for Link<W> {
    type Error = LinkError;

    fn step(&mut self, input: &Input) -> Result<AutopilotOutput, LinkError> {
        if !self.started {
            self.start()?;
        }
        let Input { time_us, imu, mag, rc, battery, .. } = *input;
        let number = self.next;
        self.next = number.wrapping_add(1);
        self.report.frames += 1;
        if self.faults.dropped_us.contains(&time_us) {
            return Ok(self.unanswered());
        }
        let (faults, n) = (self.faults.clone(), self.report.frames);
        let step = Step { time_us, imu, mag, rc, battery };
        self.send(number, &ToBoard::Step(step), |frame| faults.flip(n, frame))?;
        loop {
            match self.receive()? {
                Incoming::Message(of, ToHost::Done(done)) => match Order::of(of, self.answered) {
                    Order::Lost(answers) if of == number => {
                        self.report.to_host.lost += answers;
                        return self.accept(number, time_us, &done);
                    }
                    Order::Next if of == number => return self.accept(number, time_us, &done),
                    _ => self.report.to_host.repeated += 1,
                },
                Incoming::Message(_, ToHost::Bad(received)) => {
                    let is_of_this_step = received.corrupt != self.to_board.corrupt;
                    self.to_board = received;
                    if is_of_this_step {
                        self.answered = Some(number);
                        self.noise = 0;
                        return Ok(self.unanswered());
                    }
                }
                Incoming::Message(_, ToHost::Ready(how)) => return self.restart(time_us, how.watchdog_reset),
                Incoming::Message(_, ToHost::Started | ToHost::Refused) => self.report.to_host.repeated += 1,
                Incoming::Damaged => {
                    self.report.to_host.corrupt += 1;
                    self.answered = Some(number);
                    return Ok(self.unanswered());
                }
                Incoming::Timeout => return Ok(self.unanswered()),
            }
        }
    }
}

/// Returns the sums of two sets of counters. They saturate, because the firmware may report any number.
fn sum(a: Received, b: Received) -> Received {
    Received {
        corrupt: a.corrupt.saturating_add(b.corrupt),
        lost: a.lost.saturating_add(b.lost),
        repeated: a.repeated.saturating_add(b.repeated),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sum_of_counters_saturates() {
        let all = |n| Received { corrupt: n, lost: n, repeated: n };
        assert_eq!(sum(all(u32::MAX), all(2)), all(u32::MAX));
        assert_eq!(sum(all(3), all(2)), all(5));
    }
}
