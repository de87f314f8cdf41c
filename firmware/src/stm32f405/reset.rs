//! Why the chip has started, and the watchdog that restarts it.

use stm32f4xx_hal::pac::IWDG;
use stm32f4xx_hal::prelude::*;
use stm32f4xx_hal::rcc::Rcc;
use stm32f4xx_hal::watchdog::IndependentWatchdog;

/// What has reset the chip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// Power came.
    Power,
    /// Power had dipped below the level of the brown-out reset, if that is set.
    BrownOut,
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
            Self::BrownOut => "brown-out",
            Self::Pin => "pin",
            Self::Software => "software",
            Self::Watchdog => "watchdog",
        }
    }

    /// Reads the cause, and forgets it, so that the next start reads its own.
    pub fn take(rcc: &mut Rcc) -> Self {
        let flags = rcc.csr().read();
        rcc.csr().modify(|_, w| w.rmvf().set_bit());
        // Every reset pulls the pin's flag along, and power that of the brown-out.
        if flags.wdgrstf().bit_is_set() || flags.wwdgrstf().bit_is_set() {
            Self::Watchdog
        } else if flags.sftrstf().bit_is_set() {
            Self::Software
        } else if flags.porrstf().bit_is_set() {
            Self::Power
        } else if flags.borrstf().bit_is_set() {
            Self::BrownOut
        } else {
            Self::Pin
        }
    }
}

/// The independent watchdog, with a period of a second.
///
/// It counts 125 of its clock over 256. That clock is its own, and not exact: 32 kHz are meant, 17 to 47 kHz it may be
/// (datasheet, table 45). So the period is
///
/// ```text
///  32 kHz    125 · 256 / 32,000 = 1.00 s
///  47 kHz    125 · 256 / 47,000 = 0.68 s
///  17 kHz    125 · 256 / 17,000 = 1.88 s
/// ```
///
/// The first one too. The hardware starts the count at its largest value, 4,095 (RM0090, 21.3.1), which would be 22 to
/// 62 s, and takes the period over some cycles of that clock after it has been written: so it is started, waited
/// for, and then fed.
///
/// 0.68 s is more than the 0.5 s at most for which the erasure of a 16 KiB sector of flash stops the core, 32 bits at
/// a time.
pub struct Watchdog(IndependentWatchdog);

/// Looks until the period has been taken over: five cycles of the slowest clock, 0.3 ms. A look takes some 8 cycles, and
/// the core has 16 MHz at that time, so that this is 2.5 ms.
const TAKEN_OVER_LOOKS: u32 = 5_000;

impl Watchdog {
    /// Starts it; nothing but a reset stops it again, except that it stands still while a debug probe halts the
    /// core (the board sets that).
    pub fn start(iwdg: IWDG) -> Self {
        let mut watchdog = IndependentWatchdog::new(iwdg);
        watchdog.start(1_000.millis());
        // SAFETY: the register is only read.
        let status = unsafe { &*IWDG::ptr() }.sr();
        for _ in 0..TAKEN_OVER_LOOKS {
            let status = status.read();
            if status.pvu().bit_is_clear() && status.rvu().bit_is_clear() {
                break;
            }
        }
        watchdog.feed();
        Self(watchdog)
    }

    /// Another period.
    pub fn feed(&mut self) {
        self.0.feed();
    }
}
