//! Kestrel's firmware: the RTIC application that runs `flight-core` on an STM32F405.
//!
//! # What happens in a millisecond
//! ```text
//!        0 µs      the inertial sensor raises its data-ready line: the board's interrupt notes the time and
//!                  starts a burst of DMA
//!       13 µs      the burst is done, and its vector is that of `control_loop`: sample and inbox to the flight
//!                  controller, pulses and permit to the outputs
//!     any time     `tick`: the bytes that the receiver has sent; starts what is due of `battery`, `magnetometer`,
//!                  `health`, and `imu_setup` while the sensor is being set up
//!                  idle: sleeps
//!    1,000 µs      the next sample
//! ```
//! If the next edge does not come, a timer starts the burst at 1,500 µs after the last one, and then every
//! 1,000 µs. If that brings no sample, or the sensor is being set up, the step runs without one, and the flight
//! controller decides what to make of it.
//!
//! # Who may do what
//! Whether the motors turn is decided in one place, `flight_core::arming`, which hands out a `MotorPermit`
//! with each step in which they may. `Outputs::drive` takes that permit by value, and nothing else writes a
//! pulse other than the stop pulse. A panic, a fault, an interrupt that nobody expected, and a control loop that
//! does not end its run stop the motors ([`fault`]). The watchdog is fed in one place, `battery`, and only if
//! the tasks that a flight needs are on time ([`tasks::deadlines`]).
//!
//! # Two boards, one set of tasks
//! The tasks below are the same in flight, on a desk and on QEMU; what differs lies in [`board`]. With the feature
//! `bench` the outputs are never driven, and every sample is logged.
//!
//! # The last step
//! Each step's input and outcome stand in RAM at the symbol `FLIGHT_RECORD`, for a debug probe ([`recorder`]).
//!
//! `docs/timing.md` has each task's worst time and what follows from it.
#![no_std]
#![no_main]
#![warn(missing_docs)]

#[cfg(feature = "bench")]
mod bench;
mod board;
mod fault;
mod health;
#[cfg(feature = "flight-board")]
mod imu;
mod inbox;
mod interrupts;
#[cfg(feature = "flight-board")]
mod led;
#[cfg(feature = "flight-board")]
mod magnetometer;
#[cfg(feature = "flight-board")]
mod rc_receiver;
mod recorder;
mod step;
mod stm32f405;

use defmt_rtt as _;
#[cfg(feature = "qemu")]
use panic_semihosting as _;

/// Without it defmt compiles only errors in, and a silent firmware looks like a dead one.
const _: () = assert!(option_env!("DEFMT_LOG").is_some(), ".cargo/config.toml sets DEFMT_LOG");

defmt::timestamp!("{=u32:us}", board::now_us());

/// What this image is: the board's name, and the features that change what it does. The emulator and people with a
/// debug probe read it by its symbol; it ends with a zero.
#[unsafe(no_mangle)]
#[used]
static KESTREL_IMAGE: [u8; IMAGE_NAME.len()] = {
    let mut bytes = [0; IMAGE_NAME.len()];
    bytes.copy_from_slice(IMAGE_NAME.as_bytes());
    bytes
};
const IMAGE_NAME: &str = if cfg!(feature = "bench") {
    concat!(env!("KESTREL_BOARD_NAME"), ", bench\0")
} else {
    concat!(env!("KESTREL_BOARD_NAME"), "\0")
};

// | task           | woken by                      | prio | rate     | deadline      | uses                                    |
// |----------------|-------------------------------|------|----------|---------------|-----------------------------------------|
// | (the board's)  | data ready                    | 6    | 1 kHz    | –             | the time, the burst                     |
// | (the board's)  | TIM5: sample overdue          | 6    | ≤ 1 kHz  | –             | the time, the burst                     |
// | (the board's)  | a byte at the receiver's port | 6    | ≤ 42 kHz | the next byte | its end of the queue                    |
// | `control_loop` | DMA2_STREAM0: burst done, or  | 5    | 1 kHz    | 1 ms          | flight controller, sampler, outputs,    |
// |                | pended when overdue           |      |          |               | monitor; inbox, deadlines               |
// | `tick`         | SysTick                       | 4    | 1 kHz    | 1 ms          | receiver; inbox, deadlines              |
// | `battery`      | `tick`, every 20th            | 3    | 50 Hz    | 20 ms         | battery ADC, watchdog; inbox, deadlines |
// | `imu_setup`    | `tick`, during set-up         | 2    | 1 kHz    | –             | the inertial sensor's set-up            |
// | `health`       | `tick`, every 1,000th         | 2    | 1 Hz     | 1 s           | deadlines                               |
// | `log_event`    | any task                      | 2    | rare     | –             | its argument                            |
// | `log_samples`  | `control_loop` (`bench` only) | 2    | 1 kHz    | –             | its argument                            |
// | `magnetometer` | `tick`, every 5th             | 1    | 200 Hz   | 5 ms          | magnetometer; inbox                     |
// | `idle`         |                               | 0    |          |               |                                         |
//
// A flight needs `control_loop`, `tick` and `battery`, and the watchdog looks at these three. Whatever has a lower priority
// may hang without holding them up.
//
// `inbox` and `deadlines` are shared under RTIC's priority ceiling, which is 5: a lock holds `control_loop` up for some
// dozens of instructions, and priority 6, which takes the times, never. The dispatchers are the vectors of
// peripherals that the F405 does not have, and of its random number generator, which nobody switches on.
#[rtic::app(device = stm32f4xx_hal::pac, peripherals = true, dispatchers = [CRYP, DCMI, HASH_RNG])]
mod app {
    use flight_core::arming::Event;
    use flight_core::record::Outcome;
    use flight_core::sample::Health;
    use flight_core::watchdog::Deadline;
    use flight_core::{FlightController, Input};

    use tasks::counters::COUNTERS;
    use tasks::deadlines::{self, BATTERY_TICKS, DeadlineMonitor, HEALTH_TICKS, MAGNETOMETER_TICKS, Task};
    use tasks::{OVERDUE_US, PERIOD_US, sampling};

    use crate::board::{
        self, BatteryAdc, Board, Imu, Magnetometer, Monitor, Outputs, RcReceiver, Sampler, Step, Watchdog,
    };
    use crate::inbox::Inbox;
    use crate::recorder;

    /// The outputs are locked, because people are about.
    const BENCH: bool = cfg!(feature = "bench");

    /// An event for the log.
    pub enum LogEvent {
        /// The arm state has changed, or a request was refused.
        Arming(Event),
        /// This task was late.
        Missed(Task),
    }

    #[shared]
    struct Shared {
        inbox: Inbox,
        deadlines: DeadlineMonitor,
    }

    #[local]
    struct Local {
        controller: FlightController,
        sampler: Sampler,
        imu: Imu,
        outputs: Outputs,
        monitor: Monitor,
        receiver: RcReceiver,
        battery_adc: BatteryAdc,
        magnetometer: Magnetometer,
        watchdog: Watchdog,
        watchdog_reset: bool,
        ticks: u32,
        ticked_us: u32,
    }

    #[init]
    fn init(cx: init::Context) -> (Shared, Local) {
        let board = board::init(cx.core, cx.device);
        let controller = match FlightController::new(&board.config) {
            Ok(controller) => controller,
            // Its numbers go without a word: formatting floats takes a third of the flash that there is.
            Err(error) => panic!("configuration: {} is out of range", error.field),
        };
        defmt::info!(
            "kestrel {=str} on {=str}, reset by {=str}",
            env!("CARGO_PKG_VERSION"),
            board::NAME,
            board.reset_by
        );
        if BENCH {
            defmt::info!("bench: the outputs are locked");
        }
        #[cfg(feature = "bench")]
        crate::bench::begin(&board.config);
        let Board {
            sampler,
            imu,
            outputs,
            monitor,
            receiver,
            battery_adc,
            magnetometer,
            watchdog,
            watchdog_reset,
            ..
        } = board;
        let local = Local {
            controller,
            sampler,
            imu,
            outputs,
            monitor,
            receiver,
            battery_adc,
            magnetometer,
            watchdog,
            watchdog_reset,
            ticks: 0,
            ticked_us: board::now_us(),
        };
        (Shared { inbox: Inbox::default(), deadlines: DeadlineMonitor::new(board::now_us()) }, local)
    }

    #[idle]
    fn idle(_: idle::Context) -> ! {
        loop {
            cortex_m::asm::wfi();
        }
    }

    #[task(
        binds = DMA2_STREAM0, priority = 5, shared = [inbox, deadlines],
        local = [controller, sampler, outputs, monitor, watchdog_reset]
    )]
    fn control_loop(cx: control_loop::Context) {
        let control_loop::LocalResources { controller, sampler, outputs, monitor, watchdog_reset, .. } =
            cx.local;
        let control_loop::SharedResources { mut inbox, mut deadlines, .. } = cx.shared;
        let Some(sample) = sampler.take(board::now_us()) else { return };

        let Inbox { rc, mag, battery } = inbox.lock(core::mem::take);
        let input = Input {
            time_us: sample.time_us,
            imu: sample.imu,
            mag,
            rc,
            battery,
            bench: None,
            health: Health {
                usb: BENCH,
                maintenance: false,
                watchdog_reset: *watchdog_reset,
                missed_deadlines: deadlines::missed(),
            },
        };
        let output = controller.step(&input);
        let driven = match output.permit {
            Some(permit) if !BENCH => {
                outputs.drive(permit, output.pulses_us);
                true
            }
            _ => {
                outputs.stop();
                false
            }
        };

        #[cfg(feature = "bench")]
        log_samples::spawn(sample.time_us, sample.imu, mag).ok();
        let attitude = controller.attitude();
        let (pulses_us, state, event) = (output.pulses_us, output.state, output.event);
        recorder::write(&input, &Outcome { driven, pulses_us, state, event, attitude });
        let sampled = sample.imu.is_some();
        monitor.show(&Step {
            time_us: sample.time_us,
            sampled,
            state,
            event,
            attitude,
            missed_deadlines: deadlines::missed(),
        });
        // A line that finds the last one still being written is dropped: the next one comes.
        if let Some(event) = event {
            log_event::spawn(LogEvent::Arming(event)).ok();
        }

        let now_us = board::now_us();
        let took_us = now_us.wrapping_sub(sample.woken_us);
        COUNTERS.longest_us.record_max(took_us);
        let deadline = if took_us <= PERIOD_US { Deadline::Met } else { Deadline::Missed };
        if deadlines.lock(|deadlines| deadlines.check_in(Task::Control, deadline, now_us)) {
            log_event::spawn(LogEvent::Missed(Task::Control)).ok();
        }
        if sample.polled && deadlines.lock(|deadlines| deadlines.miss(Task::DataReady)) {
            log_event::spawn(LogEvent::Missed(Task::DataReady)).ok();
        }
        sampling::served();
    }

    #[task(binds = SysTick, priority = 4, shared = [inbox, deadlines], local = [receiver, ticks, ticked_us])]
    fn tick(cx: tick::Context) {
        let tick::LocalResources { receiver, ticks, ticked_us, .. } = cx.local;
        let tick::SharedResources { mut inbox, mut deadlines, .. } = cx.shared;

        while let Some(frame) = receiver.poll() {
            inbox.lock(|inbox| inbox.rc = Some(frame));
        }
        let mut miss = |task| {
            if deadlines.lock(|deadlines| deadlines.miss(task)) {
                log_event::spawn(LogEvent::Missed(task)).ok();
            }
        };
        // What is still at its last run has missed the deadline of that.
        if ticks.is_multiple_of(MAGNETOMETER_TICKS) && magnetometer::spawn().is_err() {
            miss(Task::Magnetometer);
        }
        if ticks.is_multiple_of(BATTERY_TICKS) && battery::spawn().is_err() {
            miss(Task::Battery);
        }
        if ticks.is_multiple_of(HEALTH_TICKS) && health::spawn().is_err() {
            miss(Task::Health);
        }
        // It has no deadline: one that is still at its last step goes on with the next tick.
        if sampling::setting_up() {
            imu_setup::spawn().ok();
        }
        *ticks = ticks.wrapping_add(1);

        let now_us = board::now_us();
        // A tick that comes so long after the last has swallowed one.
        let late = now_us.wrapping_sub(*ticked_us) > OVERDUE_US;
        *ticked_us = now_us;
        let deadline = if late { Deadline::Missed } else { Deadline::Met };
        if deadlines.lock(|deadlines| deadlines.check_in(Task::Tick, deadline, now_us)) {
            log_event::spawn(LogEvent::Missed(Task::Tick)).ok();
        }
    }

    #[task(priority = 3, shared = [inbox, deadlines], local = [battery_adc, watchdog])]
    async fn battery(cx: battery::Context) {
        let battery::LocalResources { battery_adc, watchdog, .. } = cx.local;
        let battery::SharedResources { mut inbox, mut deadlines, .. } = cx.shared;
        if let Some(battery) = battery_adc.measure() {
            COUNTERS.battery_mv.set((battery.voltage_v * 1.0e3) as u32);
            inbox.lock(|inbox| inbox.battery = Some(battery));
        }
        let on_time = deadlines.lock(|deadlines| {
            let now_us = board::now_us();
            deadlines.check_in(Task::Battery, Deadline::Met, now_us);
            deadlines.may_feed(now_us)
        });
        match on_time {
            Ok(()) => watchdog.feed(),
            Err(late) => defmt::warn!("watchdog not fed, late: {=u32:b}", late.bits()),
        }
    }

    #[task(priority = 2, shared = [deadlines])]
    async fn health(mut cx: health::Context) {
        cx.shared.deadlines.lock(DeadlineMonitor::begin_report);
        crate::health::log(deadlines::missed());
    }

    #[task(priority = 2, local = [imu])]
    async fn imu_setup(cx: imu_setup::Context) {
        cx.local.imu.run();
    }

    #[task(priority = 2)]
    async fn log_event(_: log_event::Context, event: LogEvent) {
        match event {
            LogEvent::Missed(task) => defmt::warn!("deadline missed: {=str}", task.name()),
            LogEvent::Arming(event) if event.is_refusal() => {
                defmt::warn!("refused: {=str}", event.cause.text())
            }
            LogEvent::Arming(event) => {
                let (from, to) = (event.from.name(), event.to.name());
                defmt::info!("{=str} -> {=str}: {=str}", from, to, event.cause.text());
            }
        }
    }

    #[cfg(feature = "bench")]
    #[task(priority = 2)]
    async fn log_samples(
        _: log_samples::Context,
        time_us: u64,
        imu: Option<flight_core::sample::ImuSample>,
        mag: Option<flight_core::sample::MagSample>,
    ) {
        crate::bench::log(time_us, imu, mag);
    }

    #[task(priority = 1, shared = [inbox], local = [magnetometer])]
    async fn magnetometer(mut cx: magnetometer::Context) {
        if let Some(mag) = cx.local.magnetometer.run() {
            cx.shared.inbox.lock(|inbox| inbox.mag = Some(mag));
        }
    }
}
