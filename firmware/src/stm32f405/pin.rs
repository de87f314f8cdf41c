//! A pin by its port and number, for constants of a board and for faults, which find the pins without anybody's help.
//!
//! At start the pins are set up by their types (`board/flight_board.rs`); what is here is for afterwards.

use stm32f4xx_hal::pac::gpioi;

/// A pin.
#[derive(Clone, Copy)]
pub struct Pin {
    port: *const gpioi::RegisterBlock,
    number: u8,
}

// SAFETY: an address of registers, and a number.
unsafe impl Sync for Pin {}

impl Pin {
    /// Pin `number` of a port, whose registers are those of all ports.
    pub const fn new(port: *const gpioi::RegisterBlock, number: u8) -> Self {
        assert!(number < 16);
        Self { port, number }
    }

    fn registers(&self) -> &'static gpioi::RegisterBlock {
        // SAFETY: a port's registers, of which this changes one pin's bits. Between two that read them, change theirs and
        // write them back nobody comes: after `init` that happens in the task `magnetometer` and in a fault, which does not
        // return.
        unsafe { &*self.port }
    }

    /// Drives it high, if it is an output. Touches no other pin.
    #[inline(always)]
    pub fn set_high(&self) {
        self.registers().bsrr().write(|w| w.bs(self.number).set_bit());
    }

    /// Likewise, low.
    #[inline(always)]
    pub fn set_low(&self) {
        self.registers().bsrr().write(|w| w.br(self.number).set_bit());
    }

    /// The level at it.
    #[inline(always)]
    pub fn is_low(&self) -> bool {
        self.registers().idr().read().idr(self.number).is_low()
    }

    /// Makes it an output; type, speed and pull stay.
    pub fn make_output(&self) {
        self.registers().moder().modify(|_, w| w.moder(self.number).output());
    }

    /// Likewise its alternate function, which has been chosen.
    pub fn make_alternate(&self) {
        self.registers().moder().modify(|_, w| w.moder(self.number).alternate());
    }

    /// Gives it to a peripheral, by an alternate function, with a pull-down, and edges of 20 ns.
    pub fn connect(&self, function: u8) {
        let registers = self.registers();
        registers.pupdr().modify(|_, w| w.pupdr(self.number).pull_down());
        registers.ospeedr().modify(|_, w| w.ospeedr(self.number).medium_speed());
        let n = self.number % 8;
        // SAFETY: four bits, of a table that has only functions in it.
        if self.number < 8 {
            registers.afrl().modify(|_, w| unsafe { w.afr(n).bits(function & 0xf) });
        } else {
            // SAFETY: as above.
            registers.afrh().modify(|_, w| unsafe { w.afr(n).bits(function & 0xf) });
        }
        self.make_alternate();
    }

    /// Makes it an input with a pull-down.
    pub fn pull_down(&self) {
        self.registers().pupdr().modify(|_, w| w.pupdr(self.number).pull_down());
        self.registers().moder().modify(|_, w| w.moder(self.number).input());
    }
}
