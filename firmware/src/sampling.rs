//! From the data-ready line to a sample: what wakes the flight task, and what it finds.
//!
//! ```text
//!      0 µs    data ready       the board's interrupt notes the time, starts the burst          [`ready`]
//!     13 µs    burst done       its end raises the vector that `flight` is bound to              [`Sampler::take`]
//!  1,000 µs    data ready       ...
//!  1,500 µs    nothing came     the board's timer wakes `flight` without a sample                [`overdue`]
//! ```
//! One burst is on its way at a time. Its token is [`BURST`]: taken by [`ready`], given back by
//! [`Sampler::take`]. A data-ready edge that finds it taken starts nothing: the sample is late, and counted.
//!
//! Nothing that fails is replaced: the step runs without a sample, and the flight controller lets the last one
//! age.

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering, fence};

use drivers::icm42688p::{FRAME_LEN, Frame, FrameError, decode};
use flight_core::sample::ImuSample;

use crate::clock::Clock;
use crate::fault;
use crate::tally::TALLY;

/// A burst takes 13 µs. One that takes longer than this hangs, µs.
const BURST_LIMIT_US: i32 = 100;
/// So often the flight task may be woken without finishing a run; then it hangs, and the motors stop: 20 ms,
/// long before the watchdog resets the board.
const UNSERVED_LIMIT: u32 = 20;

/// A burst is on its way, or its frame has not been taken.
static BURST: AtomicBool = AtomicBool::new(false);
/// When its sample was ready.
static READY_US: AtomicU32 = AtomicU32::new(0);
/// Another sample became ready while it ran.
static RISEN: AtomicBool = AtomicBool::new(false);
/// The deadline has passed.
static OVERDUE: AtomicBool = AtomicBool::new(false);
/// When.
static OVERDUE_US: AtomicU32 = AtomicU32::new(0);
/// Wake-ups since the flight task last finished a run.
static UNSERVED: AtomicU32 = AtomicU32::new(0);

/// A sample became ready at `at_us`; `running` if the burst of the one before still runs. Returns whether a burst
/// must be started; if not, `flight` must be woken, to see to the one that has the token. For the board's
/// interrupt, at a priority above `flight`'s.
pub fn ready(at_us: u32, running: bool) -> bool {
    count_wake_up();
    if BURST.load(Ordering::Acquire) {
        if running {
            RISEN.store(true, Ordering::Relaxed);
        } else {
            TALLY.late.add();
        }
        return false;
    }
    READY_US.store(at_us, Ordering::Relaxed);
    RISEN.store(false, Ordering::Relaxed);
    BURST.store(true, Ordering::Release);
    true
}

/// No sample came until `at_us`. For the board's interrupt, which then wakes `flight`.
pub fn overdue(at_us: u32) {
    count_wake_up();
    OVERDUE_US.store(at_us, Ordering::Relaxed);
    OVERDUE.store(true, Ordering::Release);
}

/// The flight task has finished a run.
pub fn served() {
    UNSERVED.store(0, Ordering::Relaxed);
}

fn count_wake_up() {
    // The only one who writes besides is `served`, at a lower priority.
    let unserved = UNSERVED.load(Ordering::Relaxed).wrapping_add(1);
    UNSERVED.store(unserved, Ordering::Relaxed);
    if unserved > UNSERVED_LIMIT {
        fault::stop();
    }
}

/// Where a frame is received. In RAM that DMA reaches: the linker puts no variable into the core-coupled memory
/// (memory.x). Words, because four bytes are fetched as fast as one.
pub struct FrameBuffer([AtomicU32; FRAME_LEN / 4]);

impl FrameBuffer {
    /// All zeros, which is no frame.
    pub const fn new() -> Self {
        Self([const { AtomicU32::new(0) }; FRAME_LEN / 4])
    }

    /// For DMA.
    #[cfg(not(feature = "unwired"))]
    pub fn address(&self) -> u32 {
        self.0.as_ptr() as u32
    }

    /// For a board that plays the sensor.
    #[cfg(feature = "unwired")]
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
}

/// The flight task's side.
pub struct Sampler<B> {
    bus: B,
    clock: Clock,
}

impl<B: BurstBus> Sampler<B> {
    /// Takes what `bus` brings.
    pub fn new(bus: B) -> Self {
        Self { bus, clock: Clock::new() }
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
        if BURST.load(Ordering::Acquire) {
            let ready_us = READY_US.load(Ordering::Relaxed);
            // Negative if the sample has become ready since this run began.
            let running_us = now_us.wrapping_sub(ready_us) as i32;
            match signal {
                Signal::Done => {
                    let frame = self.bus.finish();
                    return Some(self.end(ready_us, judge(&frame)));
                }
                Signal::Nothing if running_us <= BURST_LIMIT_US => {}
                Signal::Nothing | Signal::Failed => {
                    self.bus.abort();
                    TALLY.unreadable.add();
                    return Some(self.end(ready_us, None));
                }
            }
        }
        if !overdue {
            return None;
        }
        TALLY.lost.add();
        let woken_us = OVERDUE_US.load(Ordering::Relaxed);
        Some(Sample { time_us: self.clock.at(woken_us), woken_us, imu: None })
    }

    fn end(&mut self, woken_us: u32, imu: Option<ImuSample>) -> Sample {
        BURST.store(false, Ordering::Release);
        Sample { time_us: self.clock.at(woken_us), woken_us, imu }
    }
}

/// The frame's sample. What is none is counted by its kind.
#[inline]
fn judge(frame: &Frame) -> Option<ImuSample> {
    match decode(frame, RISEN.load(Ordering::Relaxed)) {
        Ok(sample) => return Some(sample),
        Err(FrameError::Repeated) => TALLY.repeated.add(),
        Err(FrameError::Torn) => TALLY.late.add(),
        Err(FrameError::NoData | FrameError::Reset) => TALLY.invalid.add(),
        Err(FrameError::NoAnswer) => TALLY.unreadable.add(),
    }
    None
}
