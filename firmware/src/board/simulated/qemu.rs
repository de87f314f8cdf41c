//! QEMU's `netduinoplus2`.

#[cfg(feature = "hil")]
use cortex_m_semihosting::debug::EXIT_SUCCESS;
use cortex_m_semihosting::debug::{self, EXIT_FAILURE};
use stm32f4xx_hal::pac::{self, TIM4};

/// The board's name.
pub const NAME: &str = "QEMU netduinoplus2";

/// Clock of TIM5, MHz.
pub const TIM5_MHZ: u16 = 1_000;

/// Clock of the serial port's baud-rate divider, Hz. QEMU ignores it.
#[cfg(feature = "hil-usart")]
pub const USART6_HZ: u32 = 16_000_000;

/// Does nothing: all clocks run.
pub fn start(_: pac::Peripherals) {}

/// Returns the instruction count.
#[inline]
pub fn instructions() -> u32 {
    // SAFETY: the counter is only read.
    unsafe { &*TIM4::ptr() }.cnt().read().bits()
}

/// Ends the flight: exits with status 0.
#[cfg(feature = "hil")]
pub fn end() -> ! {
    loop {
        debug::exit(EXIT_SUCCESS);
    }
}

/// Exits with status 1.
pub fn halt() -> ! {
    loop {
        debug::exit(EXIT_FAILURE);
    }
}
