//! Kestrel's firmware: the RTIC application that runs `flight-core` on an STM32F405.
//!
//! # What happens in a millisecond
//! ```text
//!        0 µs      the IMU raises its data-ready line: the board's interrupt handler stores the time and
//!                  starts a DMA burst
//!       13 µs      the burst is done and raises the vector of `control_loop`: sample and inbox go to the flight
//!                  controller, pulses and permit go to the outputs
//!     any time     `tick`: reads the bytes from the receiver; starts `battery`, `magnetometer` and `health` when
//!                  they are due, and `imu_setup` during the IMU's set-up
//!                  idle: sleeps
//!    1,000 µs      the next sample
//! ```
//! If the next edge does not come, a timer starts the burst 1,500 µs after the last sample, and then every 1,000 µs. If
//! the burst brings no sample, or during the IMU's set-up, the step runs without a sample. The flight controller
//! decides how to react.
//!
//! # Which code may drive the motors
//! Only `flight_core::arming` decides whether the motors may turn. For each step in which they may, it returns a
//! `MotorPermit`. `Outputs::drive` takes that permit by value, and no other function sends a pulse other than the stop
//! pulse. A panic, a fault, an unexpected interrupt and a control loop that does not finish its run stop the motors
//! ([`fault`]). Only `battery` feeds the watchdog, and only if the tasks that a flight needs are on time
//! ([`tasks::deadlines`]).
//!
//! # Several boards, one set of tasks
//! The tasks below are the same in flight, on a desk and on QEMU; the differences are in [`board`]. With the feature
//! `bench` the outputs are never driven, and every sample is logged.
//!
//! # The last step
//! The input and the outcome of the last step are in RAM at the symbol `FLIGHT_RECORD`, for a debug probe
//! ([`recorder`]).
//!
//! `docs/timing.md` has each task's worst-case time and the consequences.
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

/// Makes the build fail without DEFMT_LOG: defmt would then compile in errors only, and working firmware would log
/// nothing.
const _: () = assert!(option_env!("DEFMT_LOG").is_some(), ".cargo/config.toml sets DEFMT_LOG");

defmt::timestamp!("{=u32:us}", board::now_us());

/// The image's name: the board's name, and the features that change the image's behaviour; zero-terminated. The
/// emulator and a debug probe read it by its symbol.
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
// | `imu_setup`    | `tick`, during set-up         | 2    | 1 kHz    | –             | the IMU's set-up                        |
// | `health`       | `tick`, every 1,000th         | 2    | 1 Hz     | 1 s           | deadlines                               |
// | `log_event`    | any task                      | 2    | rare     | –             | its argument                            |
// | `log_samples`  | `control_loop` (`bench` only) | 2    | 1 kHz    | –             | its argument                            |
// | `magnetometer` | `tick`, every 5th             | 1    | 200 Hz   | 5 ms          | magnetometer; inbox                     |
// | `idle`         |                               | 0    |          |               |                                         |
//
// A flight needs `control_loop`, `tick` and `battery`; the watchdog checks these three. A task of lower priority may
// hang without delaying them.
//
// RTIC's priority ceiling of `inbox` and `deadlines` is 5: a lock delays `control_loop` by some dozens of instructions,
// and never delays priority 6, which takes the times. The dispatchers are the vectors of two peripherals that the F405
// does not have, and of its random number generator, which the firmware never enables.
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
        self, BatteryAdc, Imu, Magnetometer, Monitor, Outputs, RcReceiver, Sampler, Step, Watchdog,
    };
    use crate::inbox::Inbox;
    use crate::recorder;

    /// Whether the outputs are locked, because people may be near the board.
    const BENCH: bool = cfg!(feature = "bench");

    /// An event for the log.
    pub enum LogEvent {
        /// The arm state has changed, or a request was refused.
        Arming(Event),
        /// This task missed its deadline.
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
        last_tick_us: u32,
    }

    #[init]
    fn init(cx: init::Context) -> (Shared, Local) {
        let board = board::init(cx.core, cx.device);
        let controller = match FlightController::new(&board.config) {
            Ok(controller) => controller,
            // The error's numbers are left out: formatting floats takes a third of the available flash.
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
        let local = Local {
            controller,
            sampler: board.sampler,
            imu: board.imu,
            outputs: board.outputs,
            monitor: board.monitor,
            receiver: board.receiver,
            battery_adc: board.battery_adc,
            magnetometer: board.magnetometer,
            watchdog: board.watchdog,
            watchdog_reset: board.watchdog_reset,
            ticks: 0,
            last_tick_us: board::now_us(),
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
        let Some(sample) = sampler.next_sample(board::now_us()) else { return };

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
        // If the previous log line is still being written, this one is dropped.
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
        sampling::run_finished();
    }

    #[task(binds = SysTick, priority = 4, shared = [inbox, deadlines], local = [receiver, ticks, last_tick_us])]
    fn tick(cx: tick::Context) {
        let tick::LocalResources { receiver, ticks, last_tick_us, .. } = cx.local;
        let tick::SharedResources { mut inbox, mut deadlines, .. } = cx.shared;

        while let Some(frame) = receiver.poll() {
            inbox.lock(|inbox| inbox.rc = Some(frame));
        }
        let mut miss = |task| {
            if deadlines.lock(|deadlines| deadlines.miss(task)) {
                log_event::spawn(LogEvent::Missed(task)).ok();
            }
        };
        // A task that is still in its previous run has missed that run's deadline.
        if ticks.is_multiple_of(MAGNETOMETER_TICKS) && magnetometer::spawn().is_err() {
            miss(Task::Magnetometer);
        }
        if ticks.is_multiple_of(BATTERY_TICKS) && battery::spawn().is_err() {
            miss(Task::Battery);
        }
        if ticks.is_multiple_of(HEALTH_TICKS) && health::spawn().is_err() {
            miss(Task::Health);
        }
        // `imu_setup` has no deadline: if it is still in its last step, it continues with the next tick.
        if sampling::setting_up() {
            imu_setup::spawn().ok();
        }
        *ticks = ticks.wrapping_add(1);

        let now_us = board::now_us();
        // At least one tick was lost if more than 1.5 periods have passed since the last one.
        let late = now_us.wrapping_sub(*last_tick_us) > OVERDUE_US;
        *last_tick_us = now_us;
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
            Err(late) => defmt::warn!("watchdog not fed, late tasks: {=u32:b}", late.bits()),
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
