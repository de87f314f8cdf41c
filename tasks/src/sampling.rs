//! From the data-ready line to a sample: wake-up of the control loop, and the sample or error that it gets.
//!
//! ```text
//!      0 µs    data ready       the board's interrupt stores the time and starts the burst       [`ready`]
//!     13 µs    burst done       the end of the burst raises the vector of `control_loop`         [`Sampler::next_sample`]
//!  1,000 µs    data ready       ...
//!  1,500 µs    no edge came     the board's timer starts the burst                               [`poll`]
//! ```
//! The data-ready line may break, or stay high or low. The board's own clock then reads the IMU 1,000 times a second.
//! Each of these reads is counted as polled and as a missed deadline, so arming is refused.
//!
//! # Owner of the bus
//! The bus has one owner at a time:
//!
//! | owner | taken by | released by |
//! |---|---|---|
//! | none | | |
//! | a burst | [`ready`], [`poll`] | [`Sampler::next_sample`]: to none, or to the set-up |
//! | the set-up | [`Sampler::next_sample`], when the IMU needs a set-up ([`Recovery`]); [`begin_setup`], at start | [`end_setup`] |
//!
//! A data-ready edge during a burst starts no new burst: that sample is late, and is counted. During the set-up, edges
//! are counted for the set-up, and each edge or timer deadline runs a step without a sample.
//!
//! A failed sample is never replaced: the step runs without one, and the flight controller uses the age of its last
//! one.

use core::sync::atomic::{AtomicBool, AtomicU8, AtomicU32, Ordering, fence};

use drivers::icm42688p::{FRAME_LEN, Frame, FrameError, Recovery, decode};
use flight_core::sample::ImuSample;

use crate::clock::Clock;
use crate::counters::COUNTERS;

/// Time after which a burst is taken as hung, µs. A burst takes 13 µs.
const BURST_LIMIT_US: i32 = 100;
/// The control loop counts as hung, and the motors stop, after more wake-ups than this without a finished run. 20
/// periods are 20 ms, long before the watchdog resets the board.
pub const MAX_PENDING_WAKES: u32 = 20;

/// The owner of the bus: FREE, DMA or SETUP.
static OWNER: AtomicU8 = AtomicU8::new(FREE);
const FREE: u8 = 0;
/// A burst is running, or its frame has not been read yet.
const DMA: u8 = 1;
/// The IMU's set-up is running.
const SETUP: u8 = 2;

/// Counter value when the burst's sample was ready, or when the board started the burst without an edge, µs.
static READY_US: AtomicU32 = AtomicU32::new(0);
/// Whether the burst was started without an edge of the data-ready line.
static POLLED: AtomicBool = AtomicBool::new(false);
/// Whether another sample became ready during the burst.
static RISEN: AtomicBool = AtomicBool::new(false);
/// Whether a step must run without a sample.
static OVERDUE: AtomicBool = AtomicBool::new(false);
/// Counter value at which that step became due, µs.
static OVERDUE_US: AtomicU32 = AtomicU32::new(0);
/// Wake-ups since the control loop last finished a run.
static PENDING_WAKES: AtomicU32 = AtomicU32::new(0);
/// Edges of the data-ready line during the set-up.
static EDGES: AtomicU32 = AtomicU32::new(0);

/// What the board's interrupt handler must do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[must_use]
pub enum Action {
    /// Start a burst.
    StartBurst,
    /// Wake `control_loop`: to finish the burst that owns the bus, or to step without a sample.
    WakeControlLoop,
    /// Stop the motors: `control_loop` was woken more than [`MAX_PENDING_WAKES`] times without finishing a run.
    StopMotors,
}

/// Handles a data-ready edge at `at_us`; `running` says whether the previous sample's burst is still running. The
/// board's interrupt handler calls this, at a priority above that of `control_loop`.
pub fn ready(at_us: u32, running: bool) -> Action {
    match OWNER.load(Ordering::Acquire) {
        FREE => {
            begin_burst(at_us, false);
            return count_wake(Action::StartBurst);
        }
        DMA => {
            if running {
                RISEN.store(true, Ordering::Relaxed);
            } else {
                COUNTERS.late.add();
            }
        }
        _ => {
            // No other code writes to it.
            EDGES.store(EDGES.load(Ordering::Relaxed).wrapping_add(1), Ordering::Relaxed);
            return overdue(at_us);
        }
    }
    count_wake(Action::WakeControlLoop)
}

/// Handles a missing data-ready edge at `at_us`. The board's interrupt handler calls this, at the same priority as
/// [`ready`].
pub fn poll(at_us: u32) -> Action {
    if OWNER.load(Ordering::Acquire) == FREE {
        begin_burst(at_us, true);
        return count_wake(Action::StartBurst);
    }
    overdue(at_us)
}

/// Handles a missing sample at `at_us` without starting a burst. For the board's interrupt handler.
pub fn overdue(at_us: u32) -> Action {
    OVERDUE_US.store(at_us, Ordering::Relaxed);
    OVERDUE.store(true, Ordering::Release);
    count_wake(Action::WakeControlLoop)
}

fn begin_burst(at_us: u32, polled: bool) {
    READY_US.store(at_us, Ordering::Relaxed);
    POLLED.store(polled, Ordering::Relaxed);
    RISEN.store(false, Ordering::Relaxed);
    OWNER.store(DMA, Ordering::Release);
}

/// Records that the control loop has finished a run.
pub fn run_finished() {
    PENDING_WAKES.store(0, Ordering::Relaxed);
}

/// Counts a wake-up of `control_loop` and returns `next`, or [`Action::StopMotors`] after too many.
fn count_wake(next: Action) -> Action {
    // Only `run_finished` also writes to it, at a lower priority.
    let unserved = PENDING_WAKES.load(Ordering::Relaxed).wrapping_add(1);
    PENDING_WAKES.store(unserved, Ordering::Relaxed);
    if unserved > MAX_PENDING_WAKES { Action::StopMotors } else { next }
}

/// Gives the bus to the set-up. Called before the interrupts are enabled.
pub fn begin_setup() {
    OWNER.store(SETUP, Ordering::Release);
}

/// Returns whether the set-up owns the bus.
pub fn setting_up() -> bool {
    OWNER.load(Ordering::Acquire) == SETUP
}

/// Returns how often the data-ready line has risen during set-ups.
pub fn edges() -> u32 {
    EDGES.load(Ordering::Relaxed)
}

/// Ends the set-up: the IMU samples, and the bus is free for bursts.
pub fn end_setup() {
    OWNER.store(FREE, Ordering::Release);
}

/// Receive buffer of a burst. DMA must reach its RAM: the linker puts no variable into the core-coupled memory
/// (memory.x). It consists of words, because reading four bytes takes as long as reading one.
pub struct FrameBuffer([AtomicU32; FRAME_LEN / 4]);

impl Default for FrameBuffer {
    fn default() -> Self {
        Self::new()
    }
}

impl FrameBuffer {
    /// Returns a buffer of zeros, which is no valid frame.
    pub const fn new() -> Self {
        Self([const { AtomicU32::new(0) }; FRAME_LEN / 4])
    }

    /// Returns the buffer's address for DMA.
    pub fn address(&self) -> u32 {
        self.0.as_ptr() as u32
    }

    /// Writes a frame, for a board that simulates the IMU.
    pub fn write(&self, frame: &Frame) {
        for (word, bytes) in self.0.iter().zip(frame.as_chunks().0) {
            word.store(u32::from_ne_bytes(*bytes), Ordering::Relaxed);
        }
    }

    /// Returns the received frame.
    #[inline]
    pub fn read(&self) -> Frame {
        fence(Ordering::Acquire);
        let mut frame = [0; FRAME_LEN];
        for (bytes, word) in frame.as_chunks_mut().0.iter_mut().zip(&self.0) {
            *bytes = word.load(Ordering::Relaxed).to_ne_bytes();
        }
        frame
    }
}

/// Status of a burst, as its interrupt flags give it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Signal {
    /// No flag is set: the burst is still running, or there is none, and software has pended the vector.
    Nothing,
    /// The burst is complete.
    Done,
    /// The bus reported an error.
    Failed,
}

/// The bus for bursts.
///
/// The end of a burst raises the vector of `control_loop` as a level: it stays raised until it is acknowledged. A
/// handler that returns before that is entered again at once, and no task of lower priority can run. Therefore
/// [`Sampler::next_sample`] always acknowledges first, whichever interrupt has woken it, and only then decides by the status that
/// it has read.
pub trait BurstBus {
    /// Whether the board can repeat the IMU's set-up.
    const SUPPORTS_SETUP: bool;

    /// Reads the interrupt status and clears exactly the flags that were read: the vector is raised again only by a
    /// later event. Touches neither the burst nor the frame.
    fn acknowledge(&mut self) -> Signal;

    /// Returns the frame of a burst that is [`Signal::Done`]. After that the bus is ready for the next burst.
    fn finish(&mut self) -> Frame;

    /// Aborts a burst that hangs or has failed, and makes the bus ready for the next one. Also clears the flags that
    /// the abort itself raises.
    fn abort(&mut self);
}

/// The sample of a step, or its absence.
pub struct Sample {
    /// Time at which the sample was ready or overdue, µs.
    pub time_us: u64,
    /// The same time as the 32-bit counter value, µs.
    pub woken_us: u32,
    /// The sample's counts; `None` without a valid sample.
    pub imu: Option<ImuSample>,
    /// Whether the burst was started without an edge of the data-ready line.
    pub polled: bool,
}

/// The control loop's side of the sampling.
pub struct Sampler<B> {
    bus: B,
    clock: Clock,
    recovery: Recovery,
}

impl<B: BurstBus> Sampler<B> {
    /// Takes samples from `bus`.
    pub fn new(bus: B) -> Self {
        Self { bus, clock: Clock::new(), recovery: Recovery::new() }
    }

    /// Returns what the next step must process, or `None` if there is nothing to do: for example after a wake-up for a
    /// burst whose step has already run as overdue.
    #[inline]
    pub fn next_sample(&mut self, now_us: u32) -> Option<Sample> {
        let signal = self.bus.acknowledge();
        let overdue = OVERDUE.load(Ordering::Acquire);
        if overdue {
            OVERDUE.store(false, Ordering::Relaxed);
        }
        if OWNER.load(Ordering::Acquire) == DMA {
            let ready_us = READY_US.load(Ordering::Relaxed);
            // Negative if the burst started after this run had read the time.
            let running_us = now_us.wrapping_sub(ready_us) as i32;
            match signal {
                Signal::Done => {
                    let frame = self.bus.finish();
                    return Some(self.finish_burst(ready_us, decode(&frame, RISEN.load(Ordering::Relaxed))));
                }
                Signal::Nothing if running_us <= BURST_LIMIT_US => {}
                Signal::Nothing | Signal::Failed => {
                    self.bus.abort();
                    return Some(self.finish_burst(ready_us, Err(FrameError::NoAnswer)));
                }
            }
        }
        if !overdue {
            return None;
        }
        COUNTERS.lost.add();
        let woken_us = OVERDUE_US.load(Ordering::Relaxed);
        Some(Sample { time_us: self.clock.at(woken_us), woken_us, imu: None, polled: false })
    }

    /// Finishes a burst: releases the bus, or gives it to the set-up.
    #[inline]
    fn finish_burst(&mut self, woken_us: u32, frame: Result<ImuSample, FrameError>) -> Sample {
        let polled = POLLED.load(Ordering::Relaxed);
        let next = if B::SUPPORTS_SETUP && self.recovery.needs_setup(frame, woken_us) { SETUP } else { FREE };
        OWNER.store(next, Ordering::Release);
        let time_us = self.clock.at(woken_us);
        // The line did not rise because there is no new sample: the sample is lost, but the line works.
        if polled && frame == Err(FrameError::Repeated) {
            COUNTERS.lost.add();
            return Sample { time_us, woken_us, imu: None, polled: false };
        }
        if polled {
            COUNTERS.polled.add();
        }
        Sample { time_us, woken_us, imu: sample_or_count(frame), polled }
    }
}

/// Returns the frame's sample, or counts its error by kind.
#[inline]
fn sample_or_count(frame: Result<ImuSample, FrameError>) -> Option<ImuSample> {
    match frame {
        Ok(sample) => return Some(sample),
        Err(FrameError::Repeated) => COUNTERS.repeated.add(),
        Err(FrameError::Torn) => COUNTERS.late.add(),
        Err(FrameError::NoData | FrameError::Reset) => COUNTERS.invalid.add(),
        Err(FrameError::NoAnswer) => COUNTERS.unreadable.add(),
    }
    None
}
