//! Interrupts that do not belong to an RTIC task: their priority, and how they are enabled.

use cortex_m::peripheral::NVIC;
use stm32f4xx_hal::pac::{Interrupt, NVIC_PRIO_BITS};

/// The vector of the task `control_loop`.
pub const WAKE_CONTROL_LOOP: Interrupt = Interrupt::DMA2_STREAM0;

/// RTIC priority (larger is more urgent) of the interrupts that store times. All tasks have a lower priority, or the
/// same.
#[cfg(not(feature = "hil"))]
pub const SAMPLING_PRIORITY: u8 = 6;

/// Enables one of the board's own interrupts at an RTIC priority.
pub fn enable(nvic: &mut NVIC, interrupt: Interrupt, priority: u8) {
    let level = ((1 << NVIC_PRIO_BITS) - priority) << (8 - NVIC_PRIO_BITS);
    // SAFETY: no lock of the tasks needs to keep the handler out: the handlers share with tasks only atomics and data
    // behind a critical section.
    unsafe {
        nvic.set_priority(interrupt, level);
        NVIC::unmask(interrupt);
    }
}
