//! A pin by its port and number, for the board's constants and for fault handlers, which have no access to other
//! objects.
//!
//! At start the pins are configured by their types (`board/flight_board.rs`); this module is for later changes.

use stm32f4xx_hal::pac::gpioi;

/// A pin.
#[derive(Clone, Copy)]
pub struct Pin {
    port: *const gpioi::RegisterBlock,
    number: u8,
}

// SAFETY: the type holds an address of registers, and a number.
unsafe impl Sync for Pin {}

impl Pin {
    /// Returns pin `number` of a port. All ports have the same registers.
    pub const fn new(port: *const gpioi::RegisterBlock, number: u8) -> Self {
        assert!(number < 16);
        Self { port, number }
    }

    fn registers(&self) -> &'static gpioi::RegisterBlock {
        // SAFETY: the registers of a port; these methods change the bits of one pin. A read-modify-write cannot be
        // interrupted by another: after `init` they are done only in the task `magnetometer` and in a fault handler,
        // which does not return.
        unsafe { &*self.port }
    }

    /// Drives the pin high, if it is an output. Affects no other pin.
    #[inline(always)]
    pub fn set_high(&self) {
        self.registers().bsrr().write(|w| w.bs(self.number).set_bit());
    }

    /// Drives the pin low, if it is an output. Affects no other pin.
    #[inline(always)]
    pub fn set_low(&self) {
        self.registers().bsrr().write(|w| w.br(self.number).set_bit());
    }

    /// Returns whether the pin's level is low.
    #[inline(always)]
    pub fn is_low(&self) -> bool {
        self.registers().idr().read().idr(self.number).is_low()
    }

    /// Makes the pin an output, with its type, speed and pull unchanged.
    pub fn make_output(&self) {
        self.registers().moder().modify(|_, w| w.moder(self.number).output());
    }

    /// Switches the pin to the alternate function that was selected before.
    pub fn make_alternate(&self) {
        self.registers().moder().modify(|_, w| w.moder(self.number).alternate());
    }

    /// Connects the pin to a peripheral by an alternate function, with a pull-down, and edges of 20 ns.
    pub fn connect(&self, function: u8) {
        let registers = self.registers();
        registers.pupdr().modify(|_, w| w.pupdr(self.number).pull_down());
        registers.ospeedr().modify(|_, w| w.ospeedr(self.number).medium_speed());
        let n = self.number % 8;
        // SAFETY: four bits of a table that holds only alternate functions.
        if self.number < 8 {
            registers.afrl().modify(|_, w| unsafe { w.afr(n).bits(function & 0xf) });
        } else {
            // SAFETY: as above.
            registers.afrh().modify(|_, w| unsafe { w.afr(n).bits(function & 0xf) });
        }
        self.make_alternate();
    }

    /// Makes the pin an input with a pull-down.
    pub fn pull_down(&self) {
        self.registers().pupdr().modify(|_, w| w.pupdr(self.number).pull_down());
        self.registers().moder().modify(|_, w| w.moder(self.number).input());
    }
}
