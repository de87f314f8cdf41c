//! What the tasks know of the board: one module for each, with the same items, chosen by a cargo feature.
//!
//! | item | what it is |
//! |---|---|
//! | `init(core, device) -> Board` | brings the board up, outputs first and at the stop pulse |
//! | `Sampler` | [`tasks::sampling::Sampler`] on the board's bus |
//! | `Imu::run()` | a step of the inertial sensor's set-up, without waiting |
//! | `Outputs::drive(permit, pulses_us)` | sends pulses of rotors 1 to 4; takes the permit by value |
//! | `Outputs::stop()` | sends the stop pulse to all four |
//! | `RcReceiver::poll() -> Option<RcFrame>` | the next frame that the bytes so far have completed |
//! | `BatteryAdc::measure() -> Option<Battery>` | the battery, without waiting |
//! | `Magnetometer::run() -> Option<MagSample>` | the magnetometer's new sample; may wait, for less than 5 ms |
//! | `Watchdog::feed()` | another period |
//! | `Monitor::show(&Step)` | what the board shows of a step: a LED, or a record |
//! | `now_us() -> u32` | free-running microseconds |
//! | `stop_after_fault()` | the stop on all four, when nothing else runs any more, whatever state the outputs are in |
//! | `halt() -> !` | the end, after a fault; the stop goes on |
//!
//! # Waking the tasks
//! RTIC binds a task to one interrupt vector, and takes no vector that depends on the board. So the control loop
//! is bound to [`crate::interrupts::WAKE_CONTROL_LOOP`], which is the end of the sensor's DMA burst on a flight board, and which each board
//! also raises when 1.5 periods have passed since the last sample. A dead sensor thus ages in the flight
//! controller, and does not stop it. The `tick` task is bound to SysTick, once a millisecond.
//!
//! # Acknowledging interrupts
//! A peripheral's interrupt is a level: while its flag is set, a handler that returns is entered again, and no
//! task of a lower priority runs. So every handler acknowledges its source before it does anything else, on every
//! path, also when software alone has pended it; and it decides by what it read then.
//!
//! | vector | acknowledged by |
//! |---|---|
//! | DMA2_STREAM0 (`flight`) | [`BurstBus::acknowledge`](tasks::sampling::BurstBus::acknowledge), first in `Sampler::take` |
//! | the data-ready line's | the line's bit in EXTI_PR, written first |
//! | TIM5 | CC1IF, read and cleared first; it is the only one of TIM5's interrupts that is on |
//! | the receiver's port's | `port::take_byte` reads SR and then DR, which clears RXNE and ORE, the two that raise it |
//! | PVD, NMI | nothing: they stop the motors, and do not come back |
//! | SysTick (`tick`) | the processor, when it enters the handler |
//! | CRYP, DCMI, HASH_RNG (dispatchers) | the same: software alone pends them. The F405 has neither of the first two, and its random number generator is off |
//!
//! A board's own interrupt handlers note what happened and when, and ask [`tasks::sampling`] what to do. They have a higher
//! priority than any task ([`crate::interrupts::SAMPLING_PRIORITY`]), so that a time is not late because a task runs.

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
compile_error!("one board at a time: build the others with --no-default-features --features qemu (or hil)");
#[cfg(not(any(feature = "simulated", feature = "flight-board")))]
compile_error!("choose a board: wired, qemu or hil");

/// The board's parts, each of which one task owns.
pub struct Board {
    /// What the flight controller is built from. It is within all ranges.
    pub config: Config,
    /// Where samples come from.
    pub sampler: Sampler,
    /// The inertial sensor's set-up.
    pub imu: Imu,
    /// The way to the motors.
    pub outputs: Outputs,
    /// What the board shows of a step.
    pub monitor: Monitor,
    /// The receiver's frames.
    pub receiver: RcReceiver,
    /// The battery.
    pub battery_adc: BatteryAdc,
    /// The magnetometer.
    pub magnetometer: Magnetometer,
    /// What restarts the board if it is not fed.
    pub watchdog: Watchdog,
    /// What has started it, for people.
    pub reset_by: &'static str,
    /// It was the watchdog.
    pub watchdog_reset: bool,
}

/// Stops the motors, and nothing else happens until the watchdog resets the board.
pub fn stop() -> ! {
    // An unexpected interrupt comes at its own priority, and the control loop must not run again.
    cortex_m::interrupt::disable();
    stop_after_fault();
    halt()
}
