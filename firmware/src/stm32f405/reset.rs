//! Why the chip has started, and the watchdog that restarts it.

use stm32f4xx_hal::pac::IWDG;
use stm32f4xx_hal::rcc::Rcc;

/// What has reset the chip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// Power came, or had dipped.
    Power,
    /// The reset pin.
    Pin,
    /// The program, or a debug probe.
    Software,
    /// A watchdog.
    Watchdog,
}

impl Cause {
    /// For people.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Power => "power",
            Self::Pin => "pin",
            Self::Software => "software",
            Self::Watchdog => "watchdog",
        }
    }

    /// Reads the cause, and forgets it, so that the next start reads its own.
    pub fn take(rcc: &mut Rcc) -> Self {
        let flags = rcc.csr().read();
        rcc.csr().modify(|_, w| w.rmvf().set_bit());
        // Every reset pulls the pin's flag along, and power sets the brown-out's.
        if flags.wdgrstf().bit_is_set() || flags.wwdgrstf().bit_is_set() {
            Self::Watchdog
        } else if flags.sftrstf().bit_is_set() {
            Self::Software
        } else if flags.porrstf().bit_is_set() || flags.borrstf().bit_is_set() {
            Self::Power
        } else {
            Self::Pin
        }
    }
}

/// The independent watchdog. Its clock is its own, and not exact: 17 to 47 kHz, where 32 are meant (datasheet, table
/// 45), so that its second is 0.68 to 1.9 s. That is more than the 0.5 s at most for which the erasure of a 16 KiB
/// sector of flash stops the core.
pub struct Watchdog(IWDG);

impl Watchdog {
    /// Starts it; nothing but a reset stops it again, except that it stands still while a debug probe halts the
    /// core (the board sets that).
    pub fn start(iwdg: IWDG) -> Self {
        // SAFETY: the keys that start it and open its registers; 32 kHz over 32; 1,000 counts.
        unsafe {
            iwdg.kr().write(|w| w.key().bits(0xcccc));
            iwdg.kr().write(|w| w.key().bits(0x5555));
            iwdg.pr().write(|w| w.pr().bits(0b011));
            iwdg.rlr().write(|w| w.rl().bits(999));
        }
        Self(iwdg)
    }

    /// Another second.
    pub fn feed(&mut self) {
        // SAFETY: the key that reloads it.
        self.0.kr().write(|w| unsafe { w.key().bits(0xaaaa) });
    }
}
