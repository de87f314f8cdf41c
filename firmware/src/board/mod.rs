//! What the tasks know of the board: one module for each, with the same items, chosen by a cargo feature.
//!
//! | item | what it is |
//! |---|---|
//! | `init(core, device) -> Board` | brings the board up, outputs first and at the stop pulse |
//! | `config() -> Config` | what the flight controller is built from: how the sensors are mounted |
//! | `Sensors::take() -> Option<Input>` | the next step's input; `None` if the wake-up was a false one |
//! | `Outputs::drive(permit, pulses_us)` | sends pulses of rotors 1 to 4; takes the permit by value |
//! | `Outputs::stop()` | sends the stop pulse to all four |
//! | `Monitor::show(&Step)` | what the board shows of a step: a light, or a record |
//! | `now_us() -> u32` | free-running microseconds, for measuring spans |
//! | `stop_outputs()` | `Outputs::stop` for a fault, when nothing else runs any more |
//! | `halt() -> !` | the end, after a fault |
//!
//! # Waking the flight task
//! RTIC binds a task to one interrupt vector, and takes no vector that depends on the board. So the flight
//! task is bound to [`WAKE_FLIGHT`], and each board pends that from its own interrupts: when a sample is
//! ready, and when 1.5 periods have passed since the last one. A dead sensor thus ages in the flight
//! controller, and does not stop it.
//!
//! A board's own interrupt handlers only note what happened and when. They have a higher priority than any
//! task ([`SENSE_PRIORITY`]), so that a time is not late because a task runs.

use cortex_m::peripheral::NVIC;
use flight_core::ArmState;
use flight_core::geometry::Quaternion;
use stm32f4xx_hal::pac::{Interrupt, NVIC_PRIO_BITS};

#[cfg(feature = "qemu")]
mod qemu;
#[cfg(feature = "speedybee-f405-v4")]
mod speedybee_f405_v4;

#[cfg(feature = "qemu")]
pub use qemu::*;
#[cfg(feature = "speedybee-f405-v4")]
pub use speedybee_f405_v4::*;

#[cfg(all(feature = "qemu", feature = "speedybee-f405-v4"))]
compile_error!("one board at a time: build the emulated one with --no-default-features --features qemu");
#[cfg(not(any(feature = "qemu", feature = "speedybee-f405-v4")))]
compile_error!("choose a board: speedybee-f405-v4 or qemu");

/// The vector that the flight task is bound to.
pub const WAKE_FLIGHT: Interrupt = Interrupt::DMA2_STREAM0;

/// RTIC priority (larger is more urgent) of a board's own interrupts. Tasks have lower ones.
pub const SENSE_PRIORITY: u8 = 5;

/// Time from one inertial sample to the next, µs: the rate of [`flight_core::Params::default`].
pub const PERIOD_US: u32 = 1_000;

/// How long after a sample the next one counts as missing, µs; after that, one step in each period.
pub const OVERDUE_US: u32 = PERIOD_US + PERIOD_US / 2;

/// The board's parts, each of which one task owns.
pub struct Board {
    /// Where a step's input comes from.
    pub sensors: Sensors,
    /// The way to the motors.
    pub outputs: Outputs,
    /// What the board shows of a step.
    pub monitor: Monitor,
}

/// A finished step, for [`Monitor::show`].
pub struct Step {
    /// [`flight_core::Input::time_us`].
    pub time_us: u64,
    /// Whether an inertial sample came.
    pub sampled: bool,
    /// [`flight_core::Output::state`].
    pub state: ArmState,
    /// The attitude after the step.
    pub attitude: Quaternion<f32>,
}

/// Lets one of a board's own interrupts in, at [`SENSE_PRIORITY`].
fn listen(nvic: &mut NVIC, interrupt: Interrupt) {
    let level = ((1 << NVIC_PRIO_BITS) - SENSE_PRIORITY) << (8 - NVIC_PRIO_BITS);
    // SAFETY: the priority is above every task's, so no lock of a task's is relied on to keep the handler
    // out; the handlers share nothing with tasks but atomics.
    unsafe {
        nvic.set_priority(interrupt, level);
        NVIC::unmask(interrupt);
    }
}
