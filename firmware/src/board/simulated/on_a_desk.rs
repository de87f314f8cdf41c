//! A SpeedyBee F405 V4 on a desk, with a serial port to the host: pads T6 (PC6) and R6 (PC7), 921,600 baud.
//!
//! The motor pins stay inputs, as after a reset, and their timers have no clock. The sensors are not read.

use cortex_m::peripheral::SCB;
use stm32f4xx_hal::pac::{self, TIM5, USART6};
use stm32f4xx_hal::prelude::*;
use stm32f4xx_hal::rcc::{self, Enable};

/// The board's name.
pub const NAME: &str = "SpeedyBee F405 V4 on a desk";

/// Clock of TIM5, MHz: twice APB1's clock.
pub const TIM5_MHZ: u16 = 84;

/// Clock of the serial port's baud-rate divider, Hz. It is the clock of APB2. 84 MHz divided by 91 are 923 kbaud, which
/// is 0.2 % too fast.
pub const USART6_HZ: u32 = 84_000_000;

/// Starts the clocks that are used, and connects the port.
pub fn start(device: pac::Peripherals) {
    let clocks = rcc::Config::hse(8.MHz()).sysclk(168.MHz()).hclk(168.MHz()).pclk1(42.MHz()).pclk2(84.MHz());
    let mut rcc = device.RCC.freeze(clocks);
    TIM5::enable(&mut rcc);
    USART6::enable(&mut rcc);
    let gpioc = device.GPIOC.split(&mut rcc);
    gpioc.pc6.into_alternate::<8>();
    gpioc.pc7.into_alternate::<8>().set_internal_resistor(stm32f4xx_hal::gpio::Pull::Up);
    // Lets the probe read the log while the core sleeps.
    device.DBGMCU.cr().modify(|_, w| w.dbg_sleep().set_bit());
}

/// Returns 0: this board does not count instructions. The health line's `step` is the longest run of the control loop,
/// µs.
#[inline]
pub fn instructions() -> u32 {
    0
}

/// Ends the flight: resets the chip, ready for the next flight.
pub fn end() -> ! {
    SCB::sys_reset()
}

/// Waits until a probe is connected or the board is reset.
pub fn halt() -> ! {
    loop {
        cortex_m::asm::wfi();
    }
}
