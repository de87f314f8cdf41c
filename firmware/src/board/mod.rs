//! The board, as the tasks use it: one module for each board, with the same items, selected by a cargo feature.
//!
//! | item | purpose |
//! |---|---|
//! | `init(core, device) -> Board` | brings the board up: the outputs first, at the stop pulse |
//! | `Sampler` | [`tasks::sampling::Sampler`] on the board's bus |
//! | `Imu::run()` | runs a step of the IMU's set-up, without waiting |
//! | `Outputs::drive(permit, pulses_us)` | sends pulses of rotors 1 to 4; takes the permit by value |
//! | `Outputs::stop()` | sends the stop pulse to all four |
//! | `RcReceiver::poll() -> Option<RcFrame>` | returns the next complete frame |
//! | `BatteryAdc::measure() -> Option<Battery>` | returns the battery voltage, without waiting |
//! | `Magnetometer::run() -> Option<MagSample>` | returns the magnetometer's new sample; may wait, for less than 5 ms |
//! | `Watchdog::feed()` | starts a new watchdog period |
//! | `Monitor::show(&Step)` | shows or stores a step: by a LED, or in a record |
//! | `now_us() -> u32` | returns the free-running time, µs |
//! | `stop_after_fault()` | puts the stop on all four pads, in any state of the outputs, when no other code runs any more |
//! | `halt() -> !` | repeats the stop after a fault until the reset |
//!
//! # Waking the tasks
//! RTIC binds a task to one interrupt vector, which cannot depend on the board. Therefore the control loop is bound to
//! [`crate::interrupts::WAKE_CONTROL_LOOP`]. On a flight board, that is the end of the IMU's DMA burst. Each board also
//! raises it when 1.5 periods have passed since the last sample. So a failed IMU does not stop the flight controller,
//! which sees the age of its last sample. The `tick` task is bound to SysTick, once a millisecond.
//!
//! # Acknowledging interrupts
//! A peripheral's interrupt is a level: while its flag is set, a handler that returns is entered again, and no task of
//! lower priority runs. Therefore every handler acknowledges its source before it does anything else, on every path,
//! also when only software has pended it. It then decides by the status that it has read.
//!
//! | vector | acknowledged by |
//! |---|---|
//! | DMA2_STREAM0 (`control_loop`) | [`BurstBus::acknowledge`](tasks::sampling::BurstBus::acknowledge), first in `Sampler::next_sample` |
//! | that of the data-ready line | the line's bit in EXTI_PR, written first |
//! | TIM5 | CC1IF, read and cleared first; no other interrupt of TIM5 is enabled |
//! | that of the receiver's port | `port::take_byte` reads SR and then DR, which clears RXNE and ORE, the two sources of the interrupt |
//! | PVD, NMI | not acknowledged: they stop the motors, and do not return |
//! | SysTick (`tick`) | the processor, when it enters the handler |
//! | CRYP, DCMI, HASH_RNG (dispatchers) | the processor: only software pends them. The F405 has neither CRYP nor DCMI, and its random number generator is off |
//!
//! A board's own interrupt handlers store the time, and [`tasks::sampling`] returns the action. They have a higher
//! priority than any task ([`crate::interrupts::SAMPLING_PRIORITY`]), so that no running task delays a time.

use flight_core::Config;

pub use crate::step::Step;

#[cfg(feature = "flight-board")]
mod flight_board;
#[cfg(feature = "simulated")]
mod simulated;

#[cfg(feature = "flight-board")]
pub use flight_board::*;
#[cfg(feature = "simulated")]
pub use simulated::*;

#[cfg(all(feature = "simulated", feature = "flight-board"))]
compile_error!("select only one board: build the others with --no-default-features --features qemu (or hil)");
#[cfg(not(any(feature = "simulated", feature = "flight-board")))]
compile_error!("select a board: flight-board, qemu or hil");

/// The parts of the board. One task owns each of them.
pub struct Board {
    /// Configuration of the flight controller, with all fields in range.
    pub config: Config,
    /// Source of IMU samples.
    pub sampler: Sampler,
    /// Set-up of the IMU.
    pub imu: Imu,
    /// Outputs to the motors.
    pub outputs: Outputs,
    /// Display or record of the steps.
    pub monitor: Monitor,
    /// Source of receiver frames.
    pub receiver: RcReceiver,
    /// Battery measurement.
    pub battery_adc: BatteryAdc,
    /// Source of magnetometer samples.
    pub magnetometer: Magnetometer,
    /// Watchdog, which resets the board unless it is fed.
    pub watchdog: Watchdog,
    /// Cause of the last reset, for the log.
    pub reset_by: &'static str,
    /// Whether the watchdog caused the last reset.
    pub watchdog_reset: bool,
}

/// Stops the motors, and then waits for the watchdog to reset the board.
pub fn stop() -> ! {
    // An unexpected interrupt can have any priority, so it must disable all others: the control loop must not run
    // again.
    cortex_m::interrupt::disable();
    stop_after_fault();
    halt()
}
