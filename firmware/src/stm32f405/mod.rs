//! Drivers of the chip's peripherals, where the hardware abstraction layer has none, or has one that waits.
//!
//! | module | driver | waits |
//! |---|---|---|
//! | [`esc`] | four ESC outputs by timers and DMA | with PWM up to 3 µs |
//! | [`burst`] | the IMU by SPI and DMA | no |
//! | [`bus`] | an I2C bus for sensors that may be missing | until the run's time is up |
//! | [`port`] | the receiver's serial port | no |
//! | [`pin`] | a pin by its number | no |
//! | [`dma`] | a DMA stream by its number | while it stops, a microsecond |
//! | [`deadline`] | time, and the deadline of a sample, by TIM5 | no |
//! | [`power`] | failures of the chip's supply or its crystal | at start, until the supply is high enough |
//! | [`battery_adc`] | the battery voltage by ADC1 | no |
//! | [`reset`] | the cause of the last reset, and the watchdog | no |
//!
//! The board's wiring says which peripheral, pin, timer or stream each driver uses. Registers and their fields are
//! those of ST's RM0090.

#[cfg(feature = "flight-board")]
pub mod battery_adc;
#[cfg(feature = "flight-board")]
pub mod burst;
#[cfg(feature = "flight-board")]
pub mod bus;
#[cfg(feature = "flight-board")]
pub mod deadline;
pub mod dma;
pub mod esc;
#[cfg(feature = "flight-board")]
pub mod pin;
#[cfg(feature = "flight-board")]
pub mod port;
#[cfg(feature = "flight-board")]
pub mod power;
#[cfg(feature = "flight-board")]
pub mod reset;
