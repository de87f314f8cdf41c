//! Failures of the chip's supply and of its crystal.
//!
//! | VDD | detected by | effect |
//! |---|---|---|
//! | above 2.76 V | [`wait_for_supply`] | until then the clocks are not set up, and the motors are not driven |
//! | below 2.7 V | | at 168 MHz with five wait states, flash reads may be wrong (datasheet, table 15) |
//! | below 2.66 V (2.59 to 2.71) | the voltage detector, [`watch_supply`], and its interrupt | stops the motors until the watchdog resets the chip |
//! | below 2.83 V at level 3, 2.50 V at level 2 | the brown-out reset, if its option byte is set: [`brown_out_reset_is_off`] | resets the chip |
//! | below 1.7 V | the power-down reset | resets the chip |
//!
//! The thresholds are the typical ones of the datasheet's table 19. For a rising supply they are 0.1 V higher.
//!
//! The detector is set as low as the flash allows, so that a dip within the chip's limits does not end a flight. Below
//! that level the core may read the program wrongly, and the program must not drive motors. With the 6.2 µF that ST
//! asks for at VDD, a current of 100 mA takes 40 µs to lower the supply from 3.3 V to the threshold. So a dip of a
//! microsecond does not reach it. The stop begins a microsecond after the threshold is crossed.
//!
//! # Why the firmware does not set the brown-out reset
//! Its level is an option byte. Setting one erases all option bytes and writes them again. A reset or a power loss in
//! between leaves the chip read-protected, and the next debug probe must erase the firmware to get access. Power comes
//! from a battery's plug, which bounces, and the watchdog cannot be stopped. Therefore the level is set once at the
//! first power-up, with a debug probe and a steady supply (`docs/hardware.md`). The log reports at each start if it is
//! not set.
//!
//! # The crystal
//! The clock security system monitors it. If it fails, the hardware switches to the internal 16 MHz oscillator and
//! raises the non-maskable interrupt, within microseconds. The core and its bus clocks then run at 16 MHz, and APB1's
//! timers at 8 instead of 84 MHz. So every pulse would be ten times too long, and every DShot frame ten times too slow.
//! Therefore sending stops: the pads are pulled down ([`crate::board::stop_after_fault`]), and without a signal an ESC
//! stops its motor. The watchdog has its own clock, and resets the chip. If the crystal does not start, the clock
//! set-up waits for it until the watchdog's next reset, and so on, with the pads pulled down.
//!
//! The flight could continue with the internal oscillator and the PLL: its error of 1 % is small enough for pulses and
//! for the receiver. But a failed crystal means a board with mechanical damage, and that code path would be used at
//! most once in a board's life and could not be tested well.

use core::mem::MaybeUninit;
use core::sync::atomic::{AtomicU32, Ordering};

use stm32f4xx_hal::pac::{EXTI, FLASH, PWR};
use stm32f4xx_hal::rcc::{Enable, Rcc};

/// Level of the voltage detector: nominally 2.6 V (RM0090, 5.4.1).
const DETECTOR_LEVEL: u8 = 0b100;

/// RTIC priority of the voltage detector's interrupt: above all others, because its handler does not return.
pub const DETECTOR_PRIORITY: u8 = 7;

/// Value of the option field when the brown-out reset is off. (`stm32f4` 0.16 has the names of the levels in the wrong
/// order; ST's are: 0 is level 3, 1 is level 2, 2 is level 1, 3 is off.)
const BROWN_OUT_RESET_OFF: u8 = 0b11;

/// A failure that stops the motors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Failure {
    /// The supply fell below the limit.
    Supply,
    /// The crystal stopped.
    Crystal,
}

impl Failure {
    const ALL: [Self; 2] = [Self::Supply, Self::Crystal];

    /// Returns the name for the log.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Supply => "supply below 2.7 V",
            Self::Crystal => "crystal failed",
        }
    }

    /// Returns the value that marks the failure in a word that survives a reset. The word's random content after
    /// power-up is very unlikely to be equal.
    const fn mark(self) -> u32 {
        match self {
            Self::Supply => 0x5d19_7e3a,
            Self::Crystal => 0xc3a1_60f5,
        }
    }

    /// Returns the failure that stopped the motors before this start, if any, and clears it.
    pub fn take() -> Option<Self> {
        let mark = FAILED.word().swap(0, Ordering::SeqCst);
        Self::ALL.into_iter().find(|failure| failure.mark() == mark)
    }

    /// Stores the failure for the next start.
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
        // SAFETY: every bit pattern is a valid number.
        unsafe { self.0.assume_init_ref() }
    }
}

/// Enables the voltage detector, and waits until the supply is high enough. If that takes longer than the watchdog's
/// period, the chip is reset and starts again.
pub fn wait_for_supply(pwr: &PWR, rcc: &mut Rcc) {
    PWR::enable(rcc);
    pwr.cr().modify(|_, w| w.pls().set(DETECTOR_LEVEL).pvde().enabled());
    while supply_is_low(pwr) {}
}

/// Returns whether the supply is below the detector's level.
pub fn supply_is_low(pwr: &PWR) -> bool {
    pwr.csr().read().pvdo().is_lower()
}

/// Enables the event of a supply that falls below the detector's level: it raises the interrupt PVD, once that is
/// enabled.
pub fn watch_supply(exti: &EXTI) {
    // The detector's line rises when the supply falls.
    exti.rtsr().modify(|_, w| w.tr16().set_bit());
    exti.pr().write(|w| w.pr16().clear_bit_by_one());
    exti.imr().modify(|_, w| w.mr16().set_bit());
}

/// Enables the non-maskable interrupt for a crystal failure. The crystal must be running as the chip's clock.
pub fn watch_crystal(rcc: &mut Rcc) {
    rcc.cr().modify(|_, w| w.csson().set_bit());
}

/// Returns whether nothing resets the chip between 2.66 V, where the detector stops the motors, and 1.7 V.
pub fn brown_out_reset_is_off(flash: &FLASH) -> bool {
    flash.optcr().read().bor_lev().bits() == BROWN_OUT_RESET_OFF
}
