//! Faults stop the motors.
//!
//! The PWM timers run without the core, and an ESC holds its last throttle for a while after the last frame. Without
//! this module, a fault in flight would leave the motors running. Every abnormal end of the program leads here: a
//! panic, a fault, a stack overflow, an interrupt without a handler, a control loop that hangs ([`tasks::sampling`]).
//!
//! The stop pulse is on every pad after 0.1 to 3.6 ms, depending on the protocol (`firmware/src/stm32f405/esc/end.rs`
//! has the arithmetic), and is sent again until the reset. The watchdog is no longer fed, and resets the board 0.68 to
//! 1.88 s after its last feed; the range comes from the tolerance of its clock. The board then starts with its outputs
//! stopped, and its arm state gives the cause. A fault before `init` has started the watchdog causes no reset, but at
//! that time nothing drives the motor pads.

use core::arch::naked_asm;

use cortex_m_rt::exception;

use crate::board;

/// The vector table's hard-fault entry.
///
/// A stack overflow may be the cause. A function's first push would then fault again and lock up the core. This handler
/// never returns, so it resets the stack pointer.
///
/// With lazy stacking, the processor may still have to store the interrupted code's floating-point registers on the old
/// stack, at the next floating-point instruction. That would overwrite the new stack. Writing zero to FPCCR
/// (0xe000_ef34) cancels the pending store.
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

/// Stops the motors first, and logs the panic afterwards: logging takes time, and may panic again.
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
