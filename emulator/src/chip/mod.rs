//! The STM32F405RG, built from the peripheral models of `rigless` and from additional models.
//!
//! `rigless` models the STM32F427 after ST's RM0090, which is the manual of both parts. The models of the common
//! peripherals are used unchanged. This module adds:
//!
//! | module | content |
//! |---|---|
//! | [`stm32f405`] | the memory map, instances, clock gates, resets and DMA requests of the F405 |
//! | [`exti`] | external interrupts, with the port selection of SYSCFG |
//! | [`flash`] | the content of the flash array: programming and erasing |
//! | [`timer`] | timers that stop while they have no visible effect |
//! | [`i2c`] | a bus whose data line can be held low |

pub mod exti;
pub mod flash;
pub mod i2c;
pub mod stm32f405;
pub mod timer;
