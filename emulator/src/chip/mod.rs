//! The STM32F405RG, put together from the peripheral models of `rigless` and what they lack.
//!
//! `rigless` models the STM32F427 against ST's RM0090, which is the manual of both parts. The models of the
//! peripherals that the two have in common are used as they are; this folder adds
//!
//! | module | what |
//! |---|---|
//! | [`stm32f405`] | the memory map, instances, clock gates, resets and DMA requests of the F405 |
//! | [`exti`] | external interrupts, with the port selection of SYSCFG |
//! | [`flash`] | the flash array behind the registers: program and erase |
//! | [`timer`] | timers that are not woken while nothing of them can be seen |
//! | [`i2c`] | a bus whose data line is held low |

pub mod exti;
pub mod flash;
pub mod i2c;
pub mod stm32f405;
pub mod timer;
