//! The chip's peripherals, as far as the hardware abstraction layer does not have them or waits for them.
//!
//! | module | what | waits |
//! |---|---|---|
//! | [`esc`] | four outputs by TIM3 and TIM4, and DMA1 streams 2 and 6 | with PWM up to 3 µs |
//! | [`burst`] | the inertial sensor by SPI1, and DMA2 streams 0 and 3 | no |
//! | [`bus`] | I2C1, for sensors that may not be there | until the run's time is up |
//! | [`port`] | the receiver by USART2 | no |
//! | [`power`] | what happens when the chip's supply or its crystal fails | at start, until there is supply |
//! | [`supply`] | the battery by ADC1 | no |
//! | [`reset`] | why the chip has started, and the watchdog that restarts it | no |
//!
//! Registers and their fields are those of ST's RM0090. Which DMA stream and channel serves what is in its
//! tables 42 and 43, and in `dma/traits/f4.rs` of `stm32f4xx-hal`, which agree.

#[cfg(not(feature = "unwired"))]
pub mod burst;
#[cfg(not(feature = "unwired"))]
pub mod bus;
pub mod esc;
#[cfg(not(feature = "unwired"))]
pub mod port;
#[cfg(not(feature = "unwired"))]
pub mod power;
#[cfg(not(feature = "unwired"))]
pub mod reset;
#[cfg(not(feature = "unwired"))]
pub mod supply;
