//! Time, and the deadline of the next sample, by TIM5: 32 bits that count microseconds, and its compare channel 1.

use embedded_hal::delay::DelayNs;
use stm32f4xx_hal::pac::{self, TIM5};
use stm32f4xx_hal::rcc::{Enable, Rcc};

/// Starts the time; the first deadline is set when everything else is.
pub fn start(tim5: TIM5, rcc: &mut Rcc) {
    TIM5::enable(rcc);
    // 84 MHz down to 1.
    let prescaler = rcc.clocks.timclk1().raw() / 1_000_000 - 1;
    tim5.psc().write(|w| w.psc().set(prescaler as u16));
    tim5.egr().write(|w| w.ug().set_bit());
    tim5.cr1().write(|w| w.cen().set_bit());
}

fn tim5() -> &'static pac::tim5::RegisterBlock {
    // SAFETY: nobody owns TIM5 after `start`, and the two handlers that write to it have the same priority.
    unsafe { &*TIM5::ptr() }
}

/// Free-running microseconds.
pub fn now_us() -> u32 {
    tim5().cnt().read().cnt().bits()
}

/// From now on a deadline that passes raises TIM5's interrupt.
pub fn raise_interrupt() {
    tim5().dier().write(|w| w.cc1ie().set_bit());
}

/// Sets the deadline, and forgets that of the sample that has come.
pub fn expect_sample_by(us: u32) {
    tim5().ccr1().write(|w| w.ccr().set(us));
    acknowledge();
}

/// Whether the deadline has passed since this was last asked. Takes the interrupt down.
pub fn acknowledge() -> bool {
    let passed = tim5().sr().read().cc1if().bit_is_set();
    // A zero takes a flag down; nobody uses the others.
    tim5().sr().write(|w| w.cc1if().clear_bit());
    passed
}

/// Waits, for those who may.
pub struct Wait;

impl DelayNs for Wait {
    fn delay_ns(&mut self, ns: u32) {
        let began_us = now_us();
        // One more, because the first has begun already.
        let us = ns.div_ceil(1_000).saturating_add(1);
        while now_us().wrapping_sub(began_us) < us {}
    }
}
