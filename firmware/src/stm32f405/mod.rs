//! The chip's peripherals, as far as the hardware abstraction layer does not have them or waits for them.
//!
//! | module | what | waits |
//! |---|---|---|
//! | [`esc`] | four outputs by timers and DMA | with PWM up to 3 µs |
//! | [`burst`] | the inertial sensor by SPI and DMA | no |
//! | [`bus`] | an I2C, for sensors that may not be there | until the run's time is up |
//! | [`port`] | the receiver by a serial port | no |
//! | [`pin`] | a pin by its number | no |
//! | [`dma`] | a stream of DMA by its number | while it stops, a microsecond |
//! | [`deadline`] | time, and the deadline of a sample, by TIM5 | no |
//! | [`power`] | what happens when the chip's supply or its crystal fails | at start, until there is supply |
//! | [`battery_adc`] | the battery by ADC1 | no |
//! | [`reset`] | why the chip has started, and the watchdog that restarts it | no |
//!
//! Which peripheral, pin, timer or stream it is, each is told by the board's wiring. Registers and their fields are those
//! of ST's RM0090.

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
