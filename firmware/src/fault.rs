//! Faults stop the motors.
//!
//! The PWM timers go on by themselves, and an ESC holds its last throttle for a while when frames stop coming: without
//! this, a fault in flight would leave the motors as they were. Every way out of the program ends here: a panic, a
//! fault, a stack that has run out of its region, an interrupt that has no handler, a control loop that hangs
//! ([`tasks::sampling`]).
//!
//! The stop is on every pad 0.1 to 3.6 ms later, by protocol (`firmware/src/stm32f405/esc.rs` has the arithmetic), and
//! goes on. From then on nothing feeds the watchdog, which resets the board 0.68 to 1.88 s after its last feed (its clock
//! is that inaccurate). The board starts again with its outputs stopped, and its arm state says why. A fault before
//! `init` has started the watchdog ends in no reset; at that time nothing drives the motor pads.

use core::arch::naked_asm;

use cortex_m_rt::exception;

use crate::board;

/// The vector table's hard fault entry.
///
/// The fault may be that the stack has no room left, and then a function's first push would fault again,
/// which locks the core up. Nothing returns from here, so the stack is begun anew.
///
/// The processor may still owe the interrupted code's floating-point registers to the old stack, into which it would
/// write them at the next floating-point instruction: over the new one. FPCCR (0xe000_ef34) with zero in it forgets that.
#[unsafe(naked)]
#[unsafe(export_name = "HardFault")]
unsafe extern "C" fn hard_fault() -> ! {
    naked_asm!(
        "ldr r0, =0xe000ef34",
        "movs r1, #0",
        "str r1, [r0]",
        "dsb",
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

extern "C" fn stop() -> ! {
    board::stop()
}

/// Stops the motors, and only then says what has happened: writing that down may take a while, or panic again.
#[cfg(not(feature = "qemu"))]
#[panic_handler]
fn panic(info: &core::panic::PanicInfo) -> ! {
    use core::sync::atomic::{AtomicBool, Ordering};
    static PANICKED: AtomicBool = AtomicBool::new(false);

    cortex_m::interrupt::disable();
    board::stop_after_fault();
    if !PANICKED.load(Ordering::Relaxed) {
        PANICKED.store(true, Ordering::Relaxed);
        defmt::error!("{}", defmt::Display2Format(info));
    }
    board::halt()
}
