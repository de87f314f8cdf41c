//! The interrupts that are no task's: their priority, and how they are let in.

use cortex_m::peripheral::NVIC;
use stm32f4xx_hal::pac::{Interrupt, NVIC_PRIO_BITS};

/// The vector that the control loop is bound to.
pub const WAKE_CONTROL_LOOP: Interrupt = Interrupt::DMA2_STREAM0;

/// RTIC priority (larger is more urgent) of the interrupts that take times. Tasks have this one or a lower one.
#[cfg(not(feature = "hil"))]
pub const SAMPLING_PRIORITY: u8 = 6;

/// Lets one of a board's own interrupts in, at this RTIC priority.
pub fn enable(nvic: &mut NVIC, interrupt: Interrupt, priority: u8) {
    let level = ((1 << NVIC_PRIO_BITS) - priority) << (8 - NVIC_PRIO_BITS);
    // SAFETY: no lock of the tasks is relied on to keep the handler out, or is broken by its coming: the handlers
    // share nothing with tasks but atomics, and what they keep behind a critical section.
    unsafe {
        nvic.set_priority(interrupt, level);
        NVIC::unmask(interrupt);
    }
}
