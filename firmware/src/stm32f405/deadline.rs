//! Time, and the deadline of the next sample, by TIM5: a 32-bit microsecond counter and its compare channel 1.

use embedded_hal::delay::DelayNs;
use stm32f4xx_hal::pac::{self, TIM5};
use stm32f4xx_hal::rcc::{Enable, Rcc};

/// Starts the counter. The first deadline is set after the rest of the board.
pub fn start(tim5: TIM5, rcc: &mut Rcc) {
    TIM5::enable(rcc);
    // 84 MHz divided to 1 MHz.
    let prescaler = rcc.clocks.timclk1().raw() / 1_000_000 - 1;
    tim5.psc().write(|w| w.psc().set(prescaler as u16));
    tim5.egr().write(|w| w.ug().set_bit());
    tim5.cr1().write(|w| w.cen().set_bit());
}

fn tim5() -> &'static pac::tim5::RegisterBlock {
    // SAFETY: no code owns TIM5 after `start`, and the two handlers that write to it have the same priority.
    unsafe { &*TIM5::ptr() }
}

/// Returns the free-running time, µs.
pub fn now_us() -> u32 {
    tim5().cnt().read().cnt().bits()
}

/// Enables TIM5's interrupt at the deadline.
pub fn enable_interrupt() {
    tim5().dier().write(|w| w.cc1ie().set_bit());
}

/// Sets the deadline, and clears the flag of the previous one.
pub fn expect_sample_by(us: u32) {
    tim5().ccr1().write(|w| w.ccr().set(us));
    acknowledge();
}

/// Returns whether the deadline has passed since the last call, and clears the interrupt.
pub fn acknowledge() -> bool {
    let passed = tim5().sr().read().cc1if().bit_is_set();
    // Writing zero clears a flag; the other flags are not used.
    tim5().sr().write(|w| w.cc1if().clear_bit());
    passed
}

/// A blocking delay, for tasks that may wait.
pub struct Delay;

impl DelayNs for Delay {
    fn delay_ns(&mut self, ns: u32) {
        let began_us = now_us();
        // One more, because the current microsecond has already started.
        let us = ns.div_ceil(1_000).saturating_add(1);
        while now_us().wrapping_sub(began_us) < us {}
    }
}
