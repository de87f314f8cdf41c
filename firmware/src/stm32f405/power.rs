//! The chip's supply and its crystal, and what happens when they fail.
//!
//! | VDD | who | does what |
//! |---|---|---|
//! | above 2.76 V | [`wait_for_supply`] | before that the clocks are not set up, and nothing drives the motors |
//! | below 2.7 V | | at 168 MHz with five wait states the flash may be read wrong (datasheet, table 15) |
//! | below 2.66 V (2.59 to 2.71) | the voltage detector, [`watch_supply`], and its interrupt | stops the motors, for good: the watchdog starts the chip anew |
//! | below 2.83 V at level 3, 2.50 V at level 2 | the brown-out reset, if its option byte is set: [`brown_out_reset_is_off`] | resets the chip |
//! | below 1.7 V | the power-down reset | resets the chip |
//!
//! The thresholds are those of the datasheet's table 19, typical; for a rising supply they are 0.1 V higher.
//!
//! The detector is set as low as the flash allows: a dip that the chip survives within its limits does not end a
//! flight. What lies below is out of them, and a program that may be read wrong must not drive motors. With the 6.2 µF
//! that ST asks for at VDD, 100 mA take 40 µs from 3.3 V down to the threshold: a dip of a microsecond does not get
//! there. The stop begins a microsecond after the threshold.
//!
//! # Why the firmware does not set the brown-out reset
//! Its level is an option byte. Setting one erases them all and writes them anew, and a reset or a loss of power
//! in between leaves the chip read-protected: the next debug probe has to erase the firmware to get in. Power comes
//! with the plug of a battery, which bounces, and the watchdog cannot be stopped. So it is a step of the first
//! power-up, with a debug probe and a steady supply (`docs/hardware.md`), and the log says at each start if it is
//! missing.
//!
//! # The crystal
//! The clock security system watches it. When it fails, the hardware turns to the internal oscillator of 16 MHz and raises
//! the non-maskable interrupt, within microseconds. The core and its bus clocks then have 16 MHz, and APB1's timers 8
//! instead of 84: every pulse would be ten times as long as it says, and every frame of DShot ten times as slow. So nothing is
//! sent any more: the pads are pulled down ([`crate::board::stop_after_fault`]), and without a signal an ESC stops its motor.
//! The watchdog has a clock of its own, and resets the chip. If the crystal does not start, the set-up of the
//! clocks waits for it until the next reset by the watchdog, and so on, with the pads pulled down.
//!
//! One could go on flying with the internal oscillator and the PLL: at 1 % it is exact enough for pulses and for the receiver.
//! But a crystal that has failed is a board that has come apart, and a path that is taken once in its life is one that nobody
//! has tried.

use core::mem::MaybeUninit;
use core::sync::atomic::{AtomicU32, Ordering};

use stm32f4xx_hal::pac::{EXTI, FLASH, PWR};
use stm32f4xx_hal::rcc::{Enable, Rcc};

/// Of the voltage detector: nominally 2.6 V (RM0090, 5.4.1).
const DETECTOR_LEVEL: u8 = 0b100;

/// RTIC priority of the voltage detector's interrupt: more urgent than all others, because it does not come back.
pub const DETECTOR_PRIORITY: u8 = 7;

/// What an option byte of an unset brown-out reset reads. (`stm32f4` 0.16 has the names of the levels the wrong
/// way round; ST's are: 0 is level 3, 1 level 2, 2 level 1, 3 off.)
const BROWN_OUT_RESET_OFF: u8 = 0b11;

/// What has failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Failure {
    /// The supply fell below the limit.
    Supply,
    /// The crystal stopped.
    Crystal,
}

impl Failure {
    const ALL: [Self; 2] = [Self::Supply, Self::Crystal];

    /// For people.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Supply => "supply below 2.7 V",
            Self::Crystal => "crystal failed",
        }
    }

    /// What stands for it in a word that outlives a reset. Whatever else is there after power-up, it is hardly this.
    const fn mark(self) -> u32 {
        match self {
            Self::Supply => 0x5d19_7e3a,
            Self::Crystal => 0xc3a1_60f5,
        }
    }

    /// What has stopped the motors before this start, if it was one of these. Forgets it.
    pub fn take() -> Option<Self> {
        let mark = FAILED.word().swap(0, Ordering::SeqCst);
        Self::ALL.into_iter().find(|failure| failure.mark() == mark)
    }

    /// Notes it for the next start.
    pub fn note(self) {
        FAILED.word().store(self.mark(), Ordering::SeqCst);
    }
}

/// A word that no start clears.
struct Mark(MaybeUninit<AtomicU32>);

#[unsafe(link_section = ".uninit.failed")]
static FAILED: Mark = Mark(MaybeUninit::uninit());

impl Mark {
    fn word(&self) -> &AtomicU32 {
        // SAFETY: any bits are a number.
        unsafe { self.0.assume_init_ref() }
    }
}

/// Sets the voltage detector, and waits until it finds enough. If that takes longer than the watchdog's period, the
/// chip begins anew.
pub fn wait_for_supply(pwr: &PWR, rcc: &mut Rcc) {
    PWR::enable(rcc);
    pwr.cr().modify(|_, w| w.pls().set(DETECTOR_LEVEL).pvde().enabled());
    while supply_is_low(pwr) {}
}

/// Whether the supply is below the detector's level.
pub fn supply_is_low(pwr: &PWR) -> bool {
    pwr.csr().read().pvdo().is_lower()
}

/// From now on a supply that falls below the detector's level raises the interrupt PVD, if that is let in.
pub fn watch_supply(exti: &EXTI) {
    // Its line rises when the supply falls.
    exti.rtsr().modify(|_, w| w.tr16().set_bit());
    exti.pr().write(|w| w.pr16().clear_bit_by_one());
    exti.imr().modify(|_, w| w.mr16().set_bit());
}

/// From now on a crystal that fails raises the non-maskable interrupt. It runs, and the chip with it.
pub fn watch_crystal(rcc: &mut Rcc) {
    rcc.cr().modify(|_, w| w.csson().set_bit());
}

/// Whether nothing resets the chip between 2.66 V, where the detector stops the motors, and 1.7 V.
pub fn brown_out_reset_is_off(flash: &FLASH) -> bool {
    flash.optcr().read().bor_lev().bits() == BROWN_OUT_RESET_OFF
}
