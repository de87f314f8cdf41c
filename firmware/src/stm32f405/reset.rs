//! The cause of the last reset, and the watchdog.

use stm32f4xx_hal::pac::IWDG;
use stm32f4xx_hal::prelude::*;
use stm32f4xx_hal::rcc::Rcc;
use stm32f4xx_hal::watchdog::IndependentWatchdog;

/// Cause of a reset.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// Power-on.
    Power,
    /// The supply fell below the level of the brown-out reset, if that is set.
    BrownOut,
    /// The reset pin.
    Pin,
    /// The program, or a debug probe.
    Software,
    /// A watchdog.
    Watchdog,
}

impl Cause {
    /// Returns the name for the log.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Power => "power",
            Self::BrownOut => "brown-out",
            Self::Pin => "pin",
            Self::Software => "software",
            Self::Watchdog => "watchdog",
        }
    }

    /// Reads the cause, and clears it for the next start.
    pub fn take(rcc: &mut Rcc) -> Self {
        let flags = rcc.csr().read();
        rcc.csr().modify(|_, w| w.rmvf().set_bit());
        // Every reset also sets the pin's flag, and power-on also sets that of the brown-out reset.
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
/// It counts to 125 with its clock divided by 256. Its clock is a separate oscillator: nominally 32 kHz, 17 to 47 kHz
/// by the datasheet (table 45). So the period is
///
/// ```text
///  32 kHz    125 · 256 / 32,000 = 1.00 s
///  47 kHz    125 · 256 / 47,000 = 0.68 s
///  17 kHz    125 · 256 / 17,000 = 1.88 s
/// ```
///
/// This also holds for the first period. The hardware starts the count at its largest value, 4,095 (RM0090, 21.3.1),
/// which would be 22 to 62 s, and applies a written period only after some cycles of that clock. Therefore the watchdog
/// is started, the update is awaited, and then the watchdog is fed.
///
/// Erasing a 16 KiB flash sector with 32-bit parallelism stalls the core for at most 0.5 s. The shortest period, 0.68 s,
/// is longer.
pub struct Watchdog(IndependentWatchdog);

/// Polls until the period has been applied: five cycles of the slowest clock, 0.3 ms. A poll takes about 8 cycles at
/// the core's 16 MHz of that time: 5,000 polls are 2.5 ms.
const UPDATE_POLLS: u32 = 5_000;

impl Watchdog {
    /// Starts the watchdog. Only a reset stops it; it pauses while a debug probe halts the core (the board sets that).
    pub fn start(iwdg: IWDG) -> Self {
        let mut watchdog = IndependentWatchdog::new(iwdg);
        watchdog.start(1_000.millis());
        // SAFETY: the register is only read.
        let status = unsafe { &*IWDG::ptr() }.sr();
        for _ in 0..UPDATE_POLLS {
            let status = status.read();
            if status.pvu().bit_is_clear() && status.rvu().bit_is_clear() {
                break;
            }
        }
        watchdog.feed();
        Self(watchdog)
    }

    /// Starts a new period.
    pub fn feed(&mut self) {
        self.0.feed();
    }
}
