//! The last step of the control loop, where a debug probe finds it: at the symbol `FLIGHT_RECORD`.
//!
//! It stays in RAM when a fault has stopped the motors, and until the watchdog's reset has started the firmware anew:
//! then it is zeroed with all other variables. A probe that halts the core before that, or that reads along while the
//! vehicle stands on a desk, sees what the flight controller was last given and what it answered, bit for bit. An
//! emulator gets the same at every step. `flight_core::record` has the layout, and reads it.
//!
//! | word | what |
//! |---|---|
//! | 0 | sequence count: two more after each step; odd while the words behind it are being written |
//! | 1 to 22 | [`StepRecord::to_words`] |
//!
//! Whoever reads it while the core runs reads word 0, then the rest, then word 0 again: the record is whole if both
//! counts are the same and even. Zero is before the first step.
//!
//! # What it costs
//! It is written when the outputs have been driven. That takes at most 177 instructions, and about 20 to hand the step
//! over: 2.4 µs at two cycles each. Between a sample and the motors 11 instructions more are executed on average, 23
//! at most, because what the step was given must be in memory.

use core::sync::atomic::{AtomicU32, Ordering, fence};

use flight_core::Input;
use flight_core::record::{Outcome, StepRecord, WORDS};

/// The sequence count, and the last step's words. The name is the symbol's in the image.
#[unsafe(no_mangle)]
#[used]
pub static FLIGHT_RECORD: [AtomicU32; WORDS + 1] = [const { AtomicU32::new(0) }; WORDS + 1];

/// Records a step that was given `input`. Only the control loop does.
///
/// A function of its own, so that the step itself need not keep what it was given in registers until here.
#[inline(never)]
pub fn write(input: &Input, outcome: &Outcome) {
    let record = StepRecord::new(input, outcome);
    let [sequence, words @ ..] = &FLIGHT_RECORD;
    let count = sequence.load(Ordering::Relaxed);
    sequence.store(count.wrapping_add(1), Ordering::Relaxed);
    // Before the words, and they before the second count: for whoever reads along.
    fence(Ordering::Release);
    for (word, value) in words.iter().zip(record.to_words()) {
        word.store(value, Ordering::Relaxed);
    }
    sequence.store(count.wrapping_add(2), Ordering::Release);
}
