//! A SpeedyBee F405 V4 on a desk, at the other end of a serial port: pads T6 (PC6) and R6 (PC7), 921,600 baud.
//!
//! The pins of its motors stay what they are after a reset, inputs, and the timers behind them have no clock. The
//! sensors are not asked.

use cortex_m::peripheral::SCB;
use stm32f4xx_hal::pac::{self, TIM5, USART6};
use stm32f4xx_hal::prelude::*;
use stm32f4xx_hal::rcc::{self, Enable};

/// The board's name.
pub const NAME: &str = "SpeedyBee F405 V4 on a desk";

/// What TIM5 counts, MHz: twice APB1's clock.
pub const TIM5_MHZ: u16 = 84;

/// What the serial port's baud rate is divided from, Hz: APB2's clock. 84 MHz over 91 are 923 kbaud, 0.2 % fast.
pub const USART6_HZ: u32 = 84_000_000;

/// Starts the clocks of what is used, and connects the port.
pub fn start(device: pac::Peripherals) {
    let clocks = rcc::Config::hse(8.MHz()).sysclk(168.MHz()).hclk(168.MHz()).pclk1(42.MHz()).pclk2(84.MHz());
    let mut rcc = device.RCC.freeze(clocks);
    TIM5::enable(&mut rcc);
    USART6::enable(&mut rcc);
    let gpioc = device.GPIOC.split(&mut rcc);
    gpioc.pc6.into_alternate::<8>();
    gpioc.pc7.into_alternate::<8>().set_internal_resistor(stm32f4xx_hal::gpio::Pull::Up);
    // The probe can read the log while the core sleeps.
    device.DBGMCU.cr().modify(|_, w| w.dbg_sleep().set_bit());
}

/// Nobody counts them here. `longest` in the log's health line is the control loop's longest run, µs.
#[inline]
pub fn instructions() -> u32 {
    0
}

/// The flight is over: ready for the next.
pub fn end() -> ! {
    SCB::sys_reset()
}

/// Waits for somebody to look.
pub fn halt() -> ! {
    loop {
        cortex_m::asm::wfi();
    }
}
