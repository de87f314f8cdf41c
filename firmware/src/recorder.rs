//! The last step of the control loop, for a debug probe: at the symbol `FLIGHT_RECORD`.
//!
//! After a fault the record stays in RAM until the watchdog's reset; at the next start it is zeroed with all other
//! variables. A probe that halts the core before the reset, or that reads while the board runs on a desk, gets the
//! flight controller's last input and output, bit for bit. The emulator reads it at every step. `flight_core::record`
//! has the layout and the decoder.
//!
//! | word | content |
//! |---|---|
//! | 0 | sequence count: increased by two with each step; odd while the following words are being written |
//! | 1 to 22 | [`StepRecord::to_words`] |
//!
//! To read it while the core runs, read word 0, then the rest, then word 0 again: the record is valid if both counts
//! are equal and even. The count is zero before the first step.
//!
//! # Cost
//! The record is written after the outputs. Writing takes at most 177 instructions, and passing the step about 20: 2.4
//! µs at two cycles each. Between a sample and the motors, the recorder adds 11 instructions on average and 23 at most,
//! because the step's input must be kept in memory.

use core::sync::atomic::{AtomicU32, Ordering, fence};

use flight_core::Input;
use flight_core::record::{Outcome, StepRecord, WORDS};

/// The sequence count and the words of the last step. The static's name is the symbol in the image.
#[unsafe(no_mangle)]
#[used]
pub static FLIGHT_RECORD: [AtomicU32; WORDS + 1] = [const { AtomicU32::new(0) }; WORDS + 1];

/// Records a step with its input and outcome. Only the control loop calls it.
///
/// It is not inlined, so that the step itself need not keep its input in registers until here.
#[inline(never)]
pub fn write(input: &Input, outcome: &Outcome) {
    let record = StepRecord::new(input, outcome);
    let [sequence, words @ ..] = &FLIGHT_RECORD;
    let count = sequence.load(Ordering::Relaxed);
    sequence.store(count.wrapping_add(1), Ordering::Relaxed);
    // Orders the first count before the words; the release store below orders the words before the second count. A
    // reader on the debug port sees the same order.
    fence(Ordering::Release);
    for (word, value) in words.iter().zip(record.to_words()) {
        word.store(value, Ordering::Relaxed);
    }
    sequence.store(count.wrapping_add(2), Ordering::Release);
}
