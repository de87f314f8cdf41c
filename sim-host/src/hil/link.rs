//! The link to the firmware, in lock-step: frames of `hil-link` over any wire.
//!
//! # What becomes of a question
//! | what comes back | the step |
//! |---|---|
//! | the answer with its number | is done |
//! | `Bad`, or a damaged frame | had no answer: the motors keep their pulses, and the next step is asked |
//! | nothing, on a wire that loses frames | the same |
//! | `Ready` | found the firmware reset: the motors stand still, it is started anew, and the flight goes on |
//! | an answer to an earlier question, or one again | is waited for further |
//! | nothing, on a wire that loses none; the end of the wire; another version | ends the flight |
//!
//! Nothing is sent again: a sample that is lost is lost, as on a bus. Everything is counted, and bounded: by the
//! wire's [`OnTimeout`], by the number of resets, and by the number of bytes that bring no answer.

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

use crate::flight::{Answer, Autopilot};

/// More resets than this end a flight.
const MAX_RESETS: usize = 10;
/// More bytes than this without an answer end it too.
const MAX_NOISE_BYTES: usize = 100 * MAX_FRAME;
/// The configuration is sent again after so many reads in vain: a port that has just been opened may take its time.
const READS_PER_START: u32 = 10;

/// Bytes to the firmware and from it. A read waits for a little while; in vain, it says
/// [`WouldBlock`](io::ErrorKind::WouldBlock) or [`TimedOut`](io::ErrorKind::TimedOut). A read of no bytes is the
/// end of the wire.
pub trait Wire: Read + Write {
    /// A read has been in vain: what now?
    fn on_timeout(&mut self) -> OnTimeout;
}

impl<W: Wire> Wire for &mut W {
    fn on_timeout(&mut self) -> OnTimeout {
        (**self).on_timeout()
    }
}

/// How much longer to wait for an answer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum OnTimeout {
    /// Read again.
    Wait,
    /// The frame is lost: on to the next.
    NextFrame,
    /// The firmware is silent, and this is how that is known.
    Silent(String),
}

/// Why a link ends a flight.
#[derive(Debug)]
pub enum LinkError {
    /// The far end is gone.
    Closed,
    /// Nothing comes.
    Silent(String),
    /// Bytes come, and no answer.
    Noise,
    /// The firmware speaks another version.
    Version(u8),
    /// A whole frame with a message that there is none of.
    Unknown,
    /// The firmware does not take the configuration.
    Refused,
    /// It answers a step with another time, µs.
    WrongTime {
        /// The step's.
        asked_us: u64,
        /// The answer's.
        answered_us: u64,
    },
    /// It is reset again and again.
    Resets,
    /// Somebody wants the flight to end.
    Interrupted,
    /// The system does not send, or not receive.
    Io(io::Error),
}

impl fmt::Display for LinkError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Closed => write!(f, "the far end of the link is gone"),
            Self::Silent(why) => write!(f, "the firmware is silent: {why}"),
            Self::Noise => {
                write!(f, "{MAX_NOISE_BYTES} bytes have come without an answer: is it this firmware?")
            }
            Self::Version(version) => {
                write!(
                    f,
                    "the firmware speaks {}: build both from the same sources",
                    FrameError::Version(*version)
                )
            }
            Self::Unknown => {
                write!(
                    f,
                    "the firmware sends what this program does not know: build both from the same sources"
                )
            }
            Self::Refused => write!(
                f,
                "the firmware refuses the configuration: it is in a flight already (reset it), or cannot fly this one"
            ),
            Self::WrongTime { asked_us, answered_us } => {
                write!(f, "the firmware answers the step of {asked_us} µs with {answered_us} µs")
            }
            Self::Resets => write!(f, "the firmware has been reset more than {MAX_RESETS} times"),
            Self::Interrupted => write!(f, "interrupted"),
            Self::Io(error) => write!(f, "the link fails: {error}"),
        }
    }
}

impl std::error::Error for LinkError {}

/// What is done to the frames to the firmware, as a test. The configuration always arrives.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Faults {
    /// One bit is flipped in every so many-th step's frame.
    pub flip_bit_every: Option<NonZeroU32>,
    /// Frames of this stretch of the scene, µs, never arrive.
    pub held_back_us: Range<u64>,
}

impl Faults {
    /// Flips a bit of the `n`-th frame, counted from 1, if it is its turn: another bit each time, the frame's end
    /// included.
    fn flip(&self, n: u64, frame: &mut [u8]) {
        let Some(every) = self.flip_bit_every else { return };
        let every = u64::from(every.get());
        if n.is_multiple_of(every) {
            // 40,503 is 2¹⁶ over the golden ratio, which spreads the bits over the frame.
            let bit = n / every * 40_503 % (8 * frame.len() as u64);
            frame[bit as usize / 8] ^= 1 << (bit % 8);
        }
    }
}

/// A reset of the firmware in flight.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reset {
    /// Time of the step that found it, µs.
    pub time_us: u64,
    /// Its watchdog did it.
    pub by_watchdog: bool,
}

/// What came over a link.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Report {
    /// Frames of steps to the firmware, those that never arrived included.
    pub frames: u64,
    /// Steps without an answer.
    pub unanswered: u64,
    /// What the firmware says of the frames to it.
    pub to_board: Received,
    /// What became of the frames from it; repeated are also those that came late.
    pub to_host: Received,
    /// When it was reset.
    pub resets: Vec<Reset>,
    /// Deadlines that its tasks have missed, at most between two resets.
    pub missed_deadlines: u32,
    /// Answers that counted their instructions, those together, and the most of one.
    pub counted: u64,
    /// See `counted`.
    pub instructions: u64,
    /// See `counted`.
    pub most_instructions: u32,
}

impl Report {
    /// Whether every frame arrived, once and whole, and the firmware was not reset.
    pub fn is_clean(&self) -> bool {
        let none = Received::default();
        self.unanswered == 0 && self.resets.is_empty() && self.to_board == none && self.to_host == none
    }

    /// Mean of the instructions from sample to motors; `None` where nobody counts them.
    pub fn mean_instructions(&self) -> Option<f64> {
        (self.counted > 0).then(|| self.instructions as f64 / self.counted as f64)
    }
}

/// The link. It starts the firmware with the first step.
pub struct Link<W> {
    wire: W,
    config: Config,
    faults: Faults,
    stop: Arc<AtomicBool>,
    decoder: Decoder,
    /// Bytes that have come, and those of them that are still to be looked at.
    bytes: [u8; 512],
    unread: Range<usize>,
    /// Bytes since the last answer.
    noise: usize,
    started: bool,
    /// Number of the next frame.
    next: u32,
    /// Number of the last question that was answered, well or badly.
    answered: Option<u32>,
    last: Answer,
    /// What the firmware has said of the frames to it since its last start, and before that.
    to_board: Received,
    to_board_before: Received,
    report: Report,
}

/// What came.
enum Incoming {
    Message(u32, ToHost),
    Damaged,
    /// The wire has given the frame up.
    Nothing,
}

/// A firmware that has just started.
const AT_REST: Answer = Answer {
    driven: false,
    pulses_us: [1_000.0; 4],
    state: flight_core::ArmState::Disarmed,
    event: None,
    attitude: Quaternion::IDENTITY,
    rates_rad_s: None,
};

impl<W: Wire> Link<W> {
    /// A link over `wire` to a firmware that is to be this flight controller. Setting `stop` ends it.
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

    /// What came over it.
    pub fn into_report(self) -> Report {
        Report { to_board: sum(self.to_board_before, self.to_board), ..self.report }
    }

    /// Tells the firmware that the flight is over. Who is gone need not be told.
    pub fn end(&mut self) {
        let _ = self.send(self.next, &ToBoard::End, |_| ());
    }

    /// Sends a message, after `spoil` has had its way with the frame.
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
        // A second zero: should the frame's own be the damaged byte, this one ends it, and somebody answers.
        let mut bytes = [0; MAX_FRAME + 1];
        bytes[..length].copy_from_slice(&frame[..length]);
        self.wire.write_all(&bytes[..=length]).and_then(|()| self.wire.flush()).map_err(LinkError::Io)
    }

    /// The next thing that comes.
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
                        OnTimeout::NextFrame => return Ok(Incoming::Nothing),
                        OnTimeout::Silent(why) => return Err(LinkError::Silent(why)),
                    },
                    io::ErrorKind::Interrupted => {}
                    _ => return Err(LinkError::Io(error)),
                },
            }
        }
    }

    /// Waits for the firmware, and tells it what to be.
    fn start(&mut self) -> Result<(), LinkError> {
        // A board that has been waiting for long has said so when nobody listened.
        while !matches!(self.receive()?, Incoming::Message(_, ToHost::Ready(_)) | Incoming::Nothing) {}
        self.configure()
    }

    fn configure(&mut self) -> Result<(), LinkError> {
        let start = ToBoard::Start(self.config);
        (self.next, self.answered) = (1, Some(0));
        self.send(0, &start, |_| ())?;
        let (mut resets, mut vain) = (0, 0);
        loop {
            match self.receive()? {
                Incoming::Message(_, ToHost::Started) => break,
                Incoming::Message(_, ToHost::Refused) => return Err(LinkError::Refused),
                // It was reset again before it came to reading that.
                Incoming::Message(_, ToHost::Ready(_)) if resets == MAX_RESETS => {
                    return Err(LinkError::Resets);
                }
                Incoming::Message(_, ToHost::Ready(_)) => {
                    resets += 1;
                    self.send(0, &start, |_| ())?;
                }
                Incoming::Nothing => {
                    vain += 1;
                    if vain % READS_PER_START == 0 {
                        self.send(0, &start, |_| ())?;
                    }
                }
                // What is left of an earlier flight.
                Incoming::Message(_, ToHost::Done(_) | ToHost::Bad(_)) | Incoming::Damaged => {}
            }
        }
        self.noise = 0;
        self.started = true;
        Ok(())
    }

    /// The firmware has been reset: its outputs are dead until it has started.
    fn restart(&mut self, time_us: u64, by_watchdog: bool) -> Result<Answer, LinkError> {
        self.report.resets.push(Reset { time_us, by_watchdog });
        if self.report.resets.len() > MAX_RESETS {
            return Err(LinkError::Resets);
        }
        self.to_board_before = sum(self.to_board_before, std::mem::take(&mut self.to_board));
        self.last = AT_REST;
        self.configure()?;
        Ok(self.unanswered())
    }

    /// The motors keep their pulses.
    fn unanswered(&mut self) -> Answer {
        self.report.unanswered += 1;
        Answer { event: None, ..self.last }
    }

    fn accept(&mut self, number: u32, asked_us: u64, done: &Done) -> Result<Answer, LinkError> {
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
            report.most_instructions = report.most_instructions.max(done.instructions);
        }
        let [w, x, y, z] = done.attitude;
        self.last = Answer {
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

    fn step(&mut self, input: &Input) -> Result<Answer, LinkError> {
        if !self.started {
            self.start()?;
        }
        let Input { time_us, imu, mag, rc, battery, .. } = *input;
        let number = self.next;
        self.next = number.wrapping_add(1);
        self.report.frames += 1;
        if self.faults.held_back_us.contains(&time_us) {
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
                    let of_this = received.corrupt != self.to_board.corrupt;
                    self.to_board = received;
                    if of_this {
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
                Incoming::Nothing => return Ok(self.unanswered()),
            }
        }
    }
}

/// What the firmware says of itself may be any number: a full counter stays full.
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
    fn counters_of_a_firmware_that_says_anything_stay_full() {
        let all = |n| Received { corrupt: n, lost: n, repeated: n };
        assert_eq!(sum(all(u32::MAX), all(2)), all(u32::MAX));
        assert_eq!(sum(all(3), all(2)), all(5));
    }
}
