//! From the data-ready line to a sample: what wakes the control loop, and what it finds.
//!
//! ```text
//!      0 µs    data ready       the board's interrupt notes the time, starts the burst          [`ready`]
//!     13 µs    burst done       its end raises the vector that `flight` is bound to              [`Sampler::take`]
//!  1,000 µs    data ready       ...
//!  1,500 µs    no edge came     the board's timer starts the burst itself                        [`poll`]
//! ```
//! So the line may break, or stay high or low: the sensor is then read 1,000 times a second by the board's own clock,
//! and each of these reads is counted, and is a missed deadline, which arming is refused for.
//!
//! # Who has the bus
//! The bus has one owner:
//!
//! | owner | taken by | given back by |
//! |---|---|---|
//! | nobody | | |
//! | a burst | [`ready`], [`poll`] | [`Sampler::take`]: to nobody, or to the set-up |
//! | the set-up | [`Sampler::take`], when the sensor must be set up ([`Recovery`]); [`claim`], at start | [`set_up_done`] |
//!
//! A data-ready edge that finds a burst starts nothing: the sample is late, and counted. While the set-up has the
//! bus, edges are counted for it, and each of them, or the timer, runs a step without a sample.
//!
//! Nothing that fails is replaced: the step runs without a sample, and the flight controller lets the last one
//! age.

use core::sync::atomic::{AtomicBool, AtomicU8, AtomicU32, Ordering, fence};

use drivers::icm42688p::{FRAME_LEN, Frame, FrameError, Recovery, decode};
use flight_core::sample::ImuSample;

use crate::clock::Clock;
use crate::counters::COUNTERS;

/// A burst takes 13 µs. One that takes longer than this hangs, µs.
const BURST_LIMIT_US: i32 = 100;
/// So often the control loop may be woken without finishing a run; then it hangs, and the motors stop: 20 ms,
/// long before the watchdog resets the board.
pub const UNSERVED_LIMIT: u32 = 20;

/// Who has the bus: one of the three that follow.
static OWNER: AtomicU8 = AtomicU8::new(NOBODY);
const NOBODY: u8 = 0;
/// A burst is on its way, or its frame has not been taken.
const DMA: u8 = 1;
/// The sensor is being set up.
const SET_UP: u8 = 2;

/// When the burst's sample was ready, or when the board asked for it.
static READY_US: AtomicU32 = AtomicU32::new(0);
/// The burst was started without an edge of the data-ready line.
static POLLED: AtomicBool = AtomicBool::new(false);
/// Another sample became ready while it ran.
static RISEN: AtomicBool = AtomicBool::new(false);
/// A step must run without a sample.
static OVERDUE: AtomicBool = AtomicBool::new(false);
/// When that was.
static OVERDUE_US: AtomicU32 = AtomicU32::new(0);
/// Wake-ups since the control loop last finished a run.
static UNSERVED: AtomicU32 = AtomicU32::new(0);
/// Edges of the data-ready line while the sensor was being set up.
static EDGES: AtomicU32 = AtomicU32::new(0);

/// What the board's interrupt must do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[must_use]
pub enum Next {
    /// Start a burst.
    Burst,
    /// Wake `flight`, to see to the burst that has the bus, or to step without a sample.
    Flight,
    /// Stop the motors: `flight` was woken [`UNSERVED_LIMIT`] times, and has not finished a run.
    Stop,
}

/// A sample became ready at `at_us`; `running` if the burst of the one before still runs. For the board's interrupt, at a
/// priority above `flight`'s.
pub fn ready(at_us: u32, running: bool) -> Next {
    match OWNER.load(Ordering::Acquire) {
        NOBODY => {
            begin_burst(at_us, false);
            return wake_up(Next::Burst);
        }
        DMA => {
            if running {
                RISEN.store(true, Ordering::Relaxed);
            } else {
                COUNTERS.late.add();
            }
        }
        _ => {
            // Nobody else writes to it.
            EDGES.store(EDGES.load(Ordering::Relaxed).wrapping_add(1), Ordering::Relaxed);
            return overdue(at_us);
        }
    }
    wake_up(Next::Flight)
}

/// No edge came until `at_us`. For the board's interrupt, at the same priority.
pub fn poll(at_us: u32) -> Next {
    if OWNER.load(Ordering::Acquire) == NOBODY {
        begin_burst(at_us, true);
        return wake_up(Next::Burst);
    }
    overdue(at_us)
}

/// No sample came until `at_us`, and none is asked for. For the board's interrupt.
pub fn overdue(at_us: u32) -> Next {
    OVERDUE_US.store(at_us, Ordering::Relaxed);
    OVERDUE.store(true, Ordering::Release);
    wake_up(Next::Flight)
}

fn begin_burst(at_us: u32, polled: bool) {
    READY_US.store(at_us, Ordering::Relaxed);
    POLLED.store(polled, Ordering::Relaxed);
    RISEN.store(false, Ordering::Relaxed);
    OWNER.store(DMA, Ordering::Release);
}

/// The control loop has finished a run.
pub fn served() {
    UNSERVED.store(0, Ordering::Relaxed);
}

/// Counts a wake-up of `flight`, for which `next` is to be done.
fn wake_up(next: Next) -> Next {
    // The only one who writes besides is `served`, at a lower priority.
    let unserved = UNSERVED.load(Ordering::Relaxed).wrapping_add(1);
    UNSERVED.store(unserved, Ordering::Relaxed);
    if unserved > UNSERVED_LIMIT { Next::Stop } else { next }
}

/// The set-up has the bus from now on. Before the interrupts are let in.
pub fn claim() {
    OWNER.store(SET_UP, Ordering::Release);
}

/// Whether the sensor is to be set up, and the bus is the set-up's.
pub fn setting_up() -> bool {
    OWNER.load(Ordering::Acquire) == SET_UP
}

/// How often the data-ready line has risen while the sensor was being set up.
pub fn edges() -> u32 {
    EDGES.load(Ordering::Relaxed)
}

/// The sensor is set up, and its bus ready for bursts.
pub fn set_up_done() {
    OWNER.store(NOBODY, Ordering::Release);
}

/// Where a frame is received. In RAM that DMA reaches: the linker puts no variable into the core-coupled memory
/// (memory.x). Words, because four bytes are fetched as fast as one.
pub struct FrameBuffer([AtomicU32; FRAME_LEN / 4]);

impl Default for FrameBuffer {
    fn default() -> Self {
        Self::new()
    }
}

impl FrameBuffer {
    /// All zeros, which is no frame.
    pub const fn new() -> Self {
        Self([const { AtomicU32::new(0) }; FRAME_LEN / 4])
    }

    /// For DMA.
    pub fn address(&self) -> u32 {
        self.0.as_ptr() as u32
    }

    /// For a board that plays the sensor.
    pub fn write(&self, frame: &Frame) {
        for (word, bytes) in self.0.iter().zip(frame.as_chunks().0) {
            word.store(u32::from_ne_bytes(*bytes), Ordering::Relaxed);
        }
    }

    /// What was received.
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

/// What the interrupt of a burst's end says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Signal {
    /// Nothing: the burst still runs, or there is none. The vector was pended by software.
    Nothing,
    /// The burst is done.
    Done,
    /// The bus failed.
    Failed,
}

/// The bus on which bursts run.
///
/// The end of a burst raises the vector of `flight` as a level: it stays up until it is acknowledged, and a
/// handler that returns before that is entered again at once, so that no task of a lower priority runs any more.
/// Hence the order that [`Sampler::take`] keeps: first it acknowledges, whoever has woken it and whatever it
/// then finds; only then it decides, by what was read.
pub trait BurstBus {
    /// Whether the board sets the sensor up again when it must be.
    const SETS_UP: bool;

    /// Reads what the interrupt says, and takes down exactly what was read: unless something happens after that,
    /// the vector is not raised again. It touches neither the burst nor the frame.
    fn acknowledge(&mut self) -> Signal;

    /// The frame of a burst that is [`Signal::Done`]. The bus is ready for the next burst after that.
    fn finish(&mut self) -> Frame;

    /// Ends a burst that hangs or has failed, and makes the bus ready for the next. What the stopped burst would
    /// still raise is taken down.
    fn abort(&mut self);
}

/// A step's sample, or that there is none.
pub struct Sample {
    /// When it was ready, or when it should have been, µs.
    pub time_us: u64,
    /// The same on the counter.
    pub woken_us: u32,
    /// The counts.
    pub imu: Option<ImuSample>,
    /// The data-ready line did not announce it.
    pub polled: bool,
}

/// The control loop's side.
pub struct Sampler<B> {
    bus: B,
    clock: Clock,
    recovery: Recovery,
}

impl<B: BurstBus> Sampler<B> {
    /// Takes what `bus` brings.
    pub fn new(bus: B) -> Self {
        Self { bus, clock: Clock::new(), recovery: Recovery::new() }
    }

    /// What the next step is for; `None` if there is nothing to do, as when a burst has ended that was also
    /// overdue.
    #[inline]
    pub fn take(&mut self, now_us: u32) -> Option<Sample> {
        let signal = self.bus.acknowledge();
        let overdue = OVERDUE.load(Ordering::Acquire);
        if overdue {
            OVERDUE.store(false, Ordering::Relaxed);
        }
        if OWNER.load(Ordering::Acquire) == DMA {
            let ready_us = READY_US.load(Ordering::Relaxed);
            // Negative if the burst was started since this run began.
            let running_us = now_us.wrapping_sub(ready_us) as i32;
            match signal {
                Signal::Done => {
                    let frame = self.bus.finish();
                    return Some(self.end(ready_us, decode(&frame, RISEN.load(Ordering::Relaxed))));
                }
                Signal::Nothing if running_us <= BURST_LIMIT_US => {}
                Signal::Nothing | Signal::Failed => {
                    self.bus.abort();
                    return Some(self.end(ready_us, Err(FrameError::NoAnswer)));
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

    /// The burst is over: the bus is given back.
    #[inline]
    fn end(&mut self, woken_us: u32, frame: Result<ImuSample, FrameError>) -> Sample {
        let polled = POLLED.load(Ordering::Relaxed);
        let next = if B::SETS_UP && self.recovery.must_set_up(frame, woken_us) { SET_UP } else { NOBODY };
        OWNER.store(next, Ordering::Release);
        let time_us = self.clock.at(woken_us);
        // The line is silent because there is no new sample: it is lost, and the line is well.
        if polled && frame == Err(FrameError::Repeated) {
            COUNTERS.lost.add();
            return Sample { time_us, woken_us, imu: None, polled: false };
        }
        if polled {
            COUNTERS.polled.add();
        }
        Sample { time_us, woken_us, imu: counted(frame), polled }
    }
}

/// The frame's sample. What is none is counted by its kind.
#[inline]
fn counted(frame: Result<ImuSample, FrameError>) -> Option<ImuSample> {
    match frame {
        Ok(sample) => return Some(sample),
        Err(FrameError::Repeated) => COUNTERS.repeated.add(),
        Err(FrameError::Torn) => COUNTERS.late.add(),
        Err(FrameError::NoData | FrameError::Reset) => COUNTERS.invalid.add(),
        Err(FrameError::NoAnswer) => COUNTERS.unreadable.add(),
    }
    None
}
