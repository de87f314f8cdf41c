//! Faults stop the motors.
//!
//! The PWM timers go on by themselves: without this, a fault in flight would leave the motors at their last
//! pulse. Every way out of the program ends here: a panic (its handler ends in an undefined instruction), a
//! fault, a stack that has run out of its region, an interrupt that has no handler, a flight task that hangs
//! ([`crate::sampling`]). Then nobody feeds the watchdog, and within two seconds the board starts anew, with its
//! outputs stopped and its arm state saying so.

use core::arch::naked_asm;

use cortex_m_rt::exception;

use crate::board;

/// The vector table's hard fault entry.
///
/// The fault may be that the stack has no room left, and then a function's first push would fault again,
/// which locks the core up. Nothing returns from here, so the stack is begun anew.
#[unsafe(naked)]
#[unsafe(export_name = "HardFault")]
unsafe extern "C" fn hard_fault() -> ! {
    naked_asm!(
        "ldr r0, =_stack_start",
        "msr msp, r0",
        "b {stop}",
        stop = sym stop,
    )
}

#[exception]
unsafe fn DefaultHandler(_irqn: i16) -> ! {
    stop()
}

/// Stops the motors, and nothing else happens until the watchdog resets the board.
pub extern "C" fn stop() -> ! {
    // An unexpected interrupt comes at its own priority, and the flight task must not run again.
    cortex_m::interrupt::disable();
    board::stop_outputs();
    board::halt()
}
