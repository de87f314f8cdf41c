//! Kestrel's firmware: the RTIC application that runs `flight-core` on an STM32F405.
//!
//! # What happens in a millisecond
//! ```text
//!        0 µs      the inertial sensor raises its data-ready line; the board's interrupt notes the time
//!                  and wakes `flight`
//!                  flight: reads the sample, steps the flight controller, hands pulses and permit to the
//!                  outputs
//!                  idle: sleeps
//!    1,000 µs      the next sample
//! ```
//! If the next sample does not come, a timer wakes `flight` at 1,500 µs after the last one, and then every
//! 1,000 µs: the step runs without a sample, and the flight controller decides what to make of it.
//!
//! # Who may do what
//! Whether the motors turn is decided in one place, `flight_core::arming`, which hands out a `MotorPermit`
//! with each step in which they may. `Outputs::drive` takes that permit by value, and nothing else writes a
//! pulse other than the stop pulse. A panic, a fault or an interrupt that nobody expected stops the motors
//! ([`fault`]).
//!
//! # Two boards, one set of tasks
//! The tasks below are the same on the flight board and on QEMU; what differs lies in [`board`].
#![no_std]
#![no_main]
#![warn(missing_docs)]

mod board;
#[cfg(not(feature = "qemu"))]
mod clock;
mod fault;
mod tally;

use defmt_rtt as _;
#[cfg(not(feature = "qemu"))]
use panic_probe as _;
#[cfg(feature = "qemu")]
use panic_semihosting as _;

defmt::timestamp!("{=u32:us}", board::now_us());

// | task          | woken by                         | priority | rate       | owns                         |
// |---------------|----------------------------------|----------|------------|------------------------------|
// | (board's own) | data ready; sample overdue       | 5        | 1 kHz      | the note of what woke it     |
// | `flight`      | DMA2_STREAM0, pended by those    | 4        | 1 kHz      | flight controller, sensors,  |
// |               |                                  |          |            | outputs, monitor, tally      |
// | `announce`    | `flight`, when arming changes    | 1        | rare       | its argument                 |
// | `health`      | `flight`, every 1,000th step     | 1        | 1 Hz       | its argument                 |
// | `idle`        |                                  | 0        |            |                              |
//
// Nothing is shared, so nothing is ever locked. Priority 1 is dispatched through CRYP, the vector of a
// peripheral that the F405 does not have.
#[rtic::app(device = stm32f4xx_hal::pac, peripherals = true, dispatchers = [CRYP])]
mod app {
    use flight_core::FlightController;
    use flight_core::arming::Event;

    use crate::board::{self, Board, Monitor, Outputs, Sensors, Step};
    use crate::tally::{Report, Tally};

    #[shared]
    struct Shared {}

    #[local]
    struct Local {
        controller: FlightController,
        sensors: Sensors,
        outputs: Outputs,
        monitor: Monitor,
        tally: Tally,
    }

    #[init]
    fn init(cx: init::Context) -> (Shared, Local) {
        let Board { sensors, outputs, monitor } = board::init(cx.core, cx.device);
        let controller = match FlightController::new(&board::config()) {
            Ok(controller) => controller,
            // Its numbers go without a word: formatting floats takes a third of the flash that there is.
            Err(error) => panic!("configuration: {} is out of range", error.field),
        };
        defmt::info!("kestrel {=str} on {=str}", env!("CARGO_PKG_VERSION"), board::NAME);
        (Shared {}, Local { controller, sensors, outputs, monitor, tally: Tally::default() })
    }

    #[idle]
    fn idle(_: idle::Context) -> ! {
        loop {
            cortex_m::asm::wfi();
        }
    }

    #[task(binds = DMA2_STREAM0, priority = 4, local = [controller, sensors, outputs, monitor, tally])]
    fn flight(cx: flight::Context) {
        let flight::LocalResources { controller, sensors, outputs, monitor, tally, .. } = cx.local;
        let began_us = board::now_us();
        let Some(input) = sensors.take() else { return };

        let output = controller.step(&input);
        match output.permit {
            Some(permit) => outputs.drive(permit, output.pulses_us),
            None => outputs.stop(),
        }

        let sampled = input.imu.is_some();
        let attitude = controller.attitude();
        monitor.show(&Step { time_us: input.time_us, sampled, state: output.state, attitude });
        // A line that finds the last one still being written is dropped: the next one comes.
        if let Some(event) = output.event {
            announce::spawn(event).ok();
        }
        let busy_us = board::now_us().wrapping_sub(began_us);
        if let Some(report) = tally.count(sampled, busy_us) {
            health::spawn(report).ok();
        }
    }

    #[task(priority = 1)]
    async fn announce(_: announce::Context, event: Event) {
        let (from, to, cause) = (event.from.name(), event.to.name(), event.cause.text());
        if event.is_refusal() {
            defmt::warn!("refused: {=str}", cause);
        } else {
            defmt::info!("{=str} -> {=str}: {=str}", from, to, cause);
        }
    }

    #[task(priority = 1)]
    async fn health(_: health::Context, report: Report) {
        defmt::info!("{}", report);
    }
}
