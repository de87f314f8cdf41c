//! A flight board, as described by its file `boards/NAME.toml`. `KESTREL_BOARD` selects the file at build time.
//!
//! The build turns the file into the module [`wiring`] (`firmware/build.rs`, `board/`): constants of pins, timers and
//! streams, the peripherals by purpose, and the interrupt handlers whose vectors depend on the board. This module holds
//! what all flight boards have in common. `docs/hardware.md` describes their pins and the wiring of the other parts.

use cortex_m::peripheral::NVIC;
use cortex_m::peripheral::syst::SystClkSource;
use cortex_m::singleton;
use cortex_m_rt::exception;
use embedded_hal::spi::MODE_3;
use flight_core::arming::MotorPermit;
use flight_core::calibration::Sensitivity;
use flight_core::esc::protocol::{Protocol, STOP_US};
use flight_core::sample::MagSample;
use flight_core::{Config, Params};
use receiver::search::Search;
use stm32f4xx_hal::gpio::{self, Edge, Speed};
use stm32f4xx_hal::pac::{self, Interrupt, interrupt};
use stm32f4xx_hal::prelude::*;
use stm32f4xx_hal::rcc::{self, Enable};
use stm32f4xx_hal::spi::Spi;
use stored_config::board::{Refused, read_for_board};
use stored_config::{DecodeError, MAX_RECORD};
use tasks::counters::COUNTERS;
use tasks::sampling::{self, Action};
use tasks::{OVERDUE_US, PERIOD_US};

use super::{Board, stop};
use crate::interrupts::{SAMPLING_PRIORITY, WAKE_CONTROL_LOOP, enable};
use crate::led::Led;
use crate::stm32f405::burst::{self, ImuBus, ImuSpi};
use crate::stm32f405::bus::{self, Bus};
use crate::stm32f405::esc::{Lines, SendResult};
use crate::stm32f405::port::{self, Bytes, Port};
use crate::stm32f405::power::{self, Failure};
use crate::stm32f405::reset::Cause;
use crate::stm32f405::{deadline, esc};

pub use crate::led::Led as Monitor;
pub use crate::stm32f405::battery_adc::BatteryAdc;
pub use crate::stm32f405::deadline::{Delay, now_us};
pub use crate::stm32f405::reset::Watchdog;

/// The code that the build generates from the board's file.
mod wiring {
    use flight_core::geometry::{Mat3, vec3};
    use stm32f4xx_hal::dma::{self, traits::DMASet};
    use stm32f4xx_hal::gpio::{self, PinState};
    use stm32f4xx_hal::pac::{self, Interrupt, interrupt};
    use stm32f4xx_hal::prelude::*;
    use stm32f4xx_hal::rcc::{Enable, Rcc, Reset};
    use stm32f4xx_hal::timer::DMAR;

    use crate::stm32f405::dma::Stream;
    use crate::stm32f405::esc::{Pad, Timer};
    use crate::stm32f405::pin::Pin;
    use crate::stm32f405::{burst, bus, port};

    /// Compiles only if the chip has this signal at this pin.
    const fn pin_has_signal<PIN, SIGNAL: From<PIN>>() {}

    /// Compiles only if the chip connects this peripheral to this stream and channel.
    const fn stream_serves<PERIPHERAL, STREAM, const CHANNEL: u8, DIRECTION>()
    where
        PERIPHERAL: DMASet<STREAM, CHANNEL, DIRECTION>,
    {
    }

    /// Handles the rising edge of the data-ready line.
    fn data_ready() {
        super::data_ready();
    }

    /// Handles a byte at the receiver's port.
    fn receive() {
        super::port::take_byte::<super::FlightBoard>();
    }

    include!(concat!(env!("OUT_DIR"), "/wiring.rs"));
}

/// The board's name.
pub const NAME: &str = wiring::TITLE;

/// The board's wiring as a type.
pub struct FlightBoard;

impl burst::HasWiring for FlightBoard {
    const IMU: burst::Wiring = wiring::IMU;
}

impl bus::HasWiring for FlightBoard {
    const MAGNETOMETER: bus::Wiring = wiring::MAGNETOMETER;
}

impl port::HasWiring for FlightBoard {
    const RECEIVER: port::Wiring = wiring::RECEIVER;
}

/// Protocol of the ESCs: from the vehicle's file, or from the variable `KESTREL_ESC` at build time
/// (`docs/hardware.md`).
const ESC: Protocol = {
    let name = match option_env!("KESTREL_ESC") {
        None => env!("KESTREL_VEHICLE_ESC"),
        Some(name) => name,
    };
    match name.as_bytes() {
        b"pwm" => Protocol::Pwm { rate_hz: 400.0 },
        b"oneshot125" => Protocol::OneShot125,
        b"dshot300" => Protocol::DShot300,
        b"dshot600" => Protocol::DShot600,
        _ => panic!("KESTREL_ESC must be pwm, oneshot125, dshot300 or dshot600"),
    }
};

const LINES: Lines = Lines::new(
    esc::Outputs {
        timers: &wiring::TIMERS,
        pads: &wiring::PADS,
        enable: wiring::enable_motor_timers,
        reset: wiring::reset_motor_timers,
    },
    ESC,
);

/// The vehicle's configuration as a record, generated from its file at build time (`build.rs`). It has a symbol for
/// tools that read the image.
#[unsafe(no_mangle)]
#[used]
static KESTREL_VEHICLE: [u8; VEHICLE.len()] = *VEHICLE;
const VEHICLE: &[u8; include_bytes!(concat!(env!("OUT_DIR"), "/vehicle.bin")).len()] =
    include_bytes!(concat!(env!("OUT_DIR"), "/vehicle.bin"));

unsafe extern "C" {
    /// The parameter sectors (memory.x): flash that no code in this image writes.
    safe static STORED_CONFIG: [u8; MAX_RECORD];
}

/// Returns the parameters that the board determines: datasheet sensitivities, and the IMU's mounting.
fn params() -> Params {
    let mut params = Params::default();
    params.gyro = Sensitivity { mounting: wiring::IMU_MOUNTING, ..params.gyro };
    params.accel = Sensitivity { mounting: wiring::IMU_MOUNTING, ..params.accel };
    params
}

/// Returns the stored configuration. If there is no valid one, returns that of the vehicle's file without a
/// calibration, with which arming is refused.
///
/// It is not inlined, so that its part of the stack is free again during the rest of the start.
#[inline(never)]
fn config() -> Config {
    let params = params();
    match read_for_board(&STORED_CONFIG, &params) {
        Ok(config) => {
            defmt::info!("configuration: stored, calibrated {=bool}", config.calibration.is_some());
            config
        }
        Err(refused) => {
            let (what, field) = refused.text();
            if refused == Refused::Record(DecodeError::Empty) {
                defmt::warn!("configuration: {=str}, arming is refused", what);
            } else {
                defmt::error!("stored configuration refused: {=str}{=str}", what, field);
            }
            defmt::info!("configuration: vehicle {=str}", env!("KESTREL_VEHICLE_NAME"));
            // The build has checked that this record is valid.
            read_for_board(&KESTREL_VEHICLE, &params).unwrap_or(Config { params, calibration: None })
        }
    }
}

/// Brings the board up: first the motor pads low, the watchdog, the clocks and the stop on the outputs, then all other
/// parts.
pub fn init(mut core: cortex_m::Peripherals, device: pac::Peripherals) -> Board {
    // The pads float after a reset, and the reaction of an ESC to that is unknown. The pull-downs stay enabled, because
    // a timer that is being set up again does not drive its pads.
    let (mut rcc, parts) = wiring::split(device);
    LINES.pull_pads_down();

    let watchdog = Watchdog::start(parts.iwdg);
    power::wait_for_supply(&parts.pwr, &mut rcc);
    let clocks = rcc::Config::hse(wiring::CRYSTAL_MHZ.MHz());
    let clocks = clocks.sysclk(168.MHz()).hclk(168.MHz()).pclk1(42.MHz()).pclk2(84.MHz());
    let mut rcc = rcc.freeze(clocks);
    power::watch_crystal(&mut rcc);
    let reset = Cause::take(&mut rcc);

    // SAFETY: no code has used the timers before.
    unsafe { wiring::enable_motor_timers() };
    LINES.start();
    LINES.connect_pads();

    // While a debug probe halts the core, the timers stop, and without frames or pulses an ESC stops its motor. A pad
    // that is high then stays high until the core continues (docs/hardware.md). The watchdog pauses. The last bit lets
    // the probe read the log while the core sleeps.
    wiring::hold_motor_timers_in_debug_halts(&parts.dbgmcu);
    parts.dbgmcu.apb1_fz().modify(|_, w| w.dbg_iwdg_stop().set_bit());
    parts.dbgmcu.cr().modify(|_, w| w.dbg_sleep().set_bit());

    let led = parts.led.map(|pin| pin.into_push_pull_output_in_state(!wiring::LED_ON).erase());
    let led = Led::new(led, wiring::LED_ON);
    deadline::start(parts.tim5, &mut rcc);

    if let Some(failure) = Failure::take() {
        defmt::error!("motors stopped before the reset: {=str}", failure.name());
    }
    if power::brown_out_reset_is_off(&parts.flash) {
        defmt::warn!("the brown-out reset is not set");
    }

    // Other chips on the IMU's bus could answer too, if their chip selects floated.
    for select in &wiring::IMU_DESELECT {
        select.set_high();
        select.make_output();
    }
    let pins = (
        Some(parts.imu_sck.into_alternate().speed(Speed::High)),
        Some(parts.imu_miso.into_alternate()),
        Some(parts.imu_mosi.into_alternate().speed(Speed::High)),
    );
    // The IMU allows up to 24 MHz; the nearest clock, 84 MHz divided by 8, is 10.5 MHz.
    let _spi = Spi::new(parts.imu_spi, pins, MODE_3, 10.MHz(), &mut rcc);
    let _select = parts.imu_select.into_push_pull_output_in_state(gpio::PinState::High);
    let imu = Imu::new(ImuSpi::new());
    sampling::begin_setup();
    pac::DMA2::enable(&mut rcc);
    let sampler = Sampler::new(ImuBus::new());

    wiring::connect_receiver(parts.receiver_rx, &mut rcc);
    let bytes = singleton!(: Bytes = Bytes::new()).expect("init runs once");
    let (apb1, apb2) = (rcc.clocks.pclk1().raw(), rcc.clocks.pclk2().raw());
    let port = Port::open(bytes, Search::FIRST.line(), [apb1, apb2]);
    let config = config();
    let receiver = RcReceiver::new(port, config.params.channels);

    parts.battery.into_analog();
    let battery_adc = BatteryAdc::new(
        parts.adc1,
        &parts.adc_common,
        wiring::BATTERY_CHANNEL,
        wiring::BATTERY_RATIO,
        &mut rcc,
    );
    wiring::connect_magnetometer(parts.magnetometer_scl, parts.magnetometer_sda, &mut rcc);
    let magnetometer = Magnetometer(crate::magnetometer::Magnetometer::new(Bus::new(apb1 / 1_000_000)));

    let mut exti = parts.exti;
    power::watch_supply(&exti);
    enable(&mut core.NVIC, Interrupt::PVD, power::DETECTOR_PRIORITY);
    // The supply may have fallen before the event was enabled.
    if power::supply_is_low(&parts.pwr) {
        stop_for(Failure::Supply);
    }
    enable(&mut core.NVIC, wiring::RECEIVER_INTERRUPT, SAMPLING_PRIORITY);
    let mut data_ready = parts.imu_ready.into_pull_down_input();
    data_ready.make_interrupt_source(&mut parts.syscfg.constrain(&mut rcc));
    data_ready.trigger_on_edge(&mut exti, Edge::Rising);
    data_ready.enable_interrupt(&mut exti);
    enable(&mut core.NVIC, wiring::READY_INTERRUPT, SAMPLING_PRIORITY);
    deadline::expect_sample_by(now_us().wrapping_add(OVERDUE_US));
    deadline::enable_interrupt();
    enable(&mut core.NVIC, Interrupt::TIM5, SAMPLING_PRIORITY);

    core.SYST.set_clock_source(SystClkSource::Core);
    core.SYST.set_reload(rcc.clocks.sysclk().raw() / (1_000_000 / PERIOD_US) - 1);
    core.SYST.clear_current();
    core.SYST.enable_counter();
    core.SYST.enable_interrupt();

    Board {
        config,
        sampler,
        imu,
        outputs: Outputs(()),
        monitor: led,
        receiver,
        battery_adc,
        magnetometer,
        watchdog,
        reset_by: reset.name(),
        watchdog_reset: reset == Cause::Watchdog,
    }
}

/// Handles a new sample of the IMU.
#[inline(always)]
fn data_ready() {
    // SAFETY: this register's bits are cleared by writing ones, so no other line is affected.
    unsafe { (*pac::EXTI::ptr()).pr().write(|w| w.bits(1 << wiring::READY_LINE)) };
    let ready_us = now_us();
    deadline::expect_sample_by(ready_us.wrapping_add(OVERDUE_US));
    carry_out(sampling::ready(ready_us, wiring::IMU.running()));
}

/// Handles an overdue sample: reads the IMU anyway, in case only the line has failed.
#[interrupt]
fn TIM5() {
    // The sample may have come while this interrupt was pending.
    if !deadline::acknowledge() {
        return;
    }
    let overdue_us = now_us();
    deadline::expect_sample_by(overdue_us.wrapping_add(PERIOD_US));
    carry_out(sampling::poll(overdue_us));
}

#[inline(always)]
fn carry_out(next: Action) {
    match next {
        Action::StartBurst => wiring::IMU.start(),
        Action::WakeControlLoop => NVIC::pend(WAKE_CONTROL_LOOP),
        Action::StopMotors => stop(),
    }
}

/// Samples of the IMU by DMA.
pub type Sampler = sampling::Sampler<ImuBus<FlightBoard>>;

/// Set-up of the IMU.
pub type Imu = crate::imu::Imu<FlightBoard>;

/// The receiver.
pub type RcReceiver = crate::rc_receiver::RcReceiver<FlightBoard>;

/// The magnetometer.
pub struct Magnetometer(crate::magnetometer::Magnetometer<Bus<FlightBoard>>);

impl Magnetometer {
    /// Returns the new sample, if there is one.
    pub fn run(&mut self) -> Option<MagSample> {
        bus::begin_run();
        self.0.run(&mut Delay)
    }
}

/// The four motor pads.
pub struct Outputs(());

impl Outputs {
    /// Sends pulses of rotors 1 to 4. The permit is consumed: each step has one, and it allows one output.
    #[inline]
    pub fn drive(&mut self, permit: MotorPermit, pulses_us: [f32; 4]) {
        send(permit.apply(pulses_us, STOP_US));
    }

    /// Sends the stop pulse to all four.
    #[inline]
    pub fn stop(&mut self) {
        send([STOP_US; 4]);
    }
}

/// Sends pulses of rotors 1 to 4 to the pads M1 to M4, by the board's output map. Rotors are counted clockwise from the
/// front left.
#[inline]
fn send(pulses_us: [f32; 4]) {
    match LINES.send(wiring::ROTORS.map(|rotor| pulses_us[rotor])) {
        SendResult::Sent => {}
        SendResult::Dropped => COUNTERS.outputs_dropped.add(),
        SendResult::Recovered => COUNTERS.outputs_recovered.add(),
    }
}

/// Sends the stop command to the motor pads after a fault, in any state of the outputs. `esc/end.rs` gives the time
/// that this takes.
pub fn stop_after_fault() {
    // SAFETY: this enables the clocks of ports that no other code uses any more.
    unsafe { wiring::enable_motor_ports() };
    // SAFETY: the register is only read.
    let on_pll = unsafe { &*pac::RCC::ptr() }.cfgr().read().sws().is_pll();
    if on_pll {
        LINES.finish_and_restart();
        send([STOP_US; 4]);
    } else {
        // The fault came before the clock set-up, or the crystal has failed. With this clock no pulse can be sent: keep
        // the pads low.
        LINES.pull_pads_down();
    }
}

/// Stores the reason for the next start's log, and calls [`stop`].
fn stop_for(failure: Failure) -> ! {
    failure.note();
    stop()
}

/// Handles a supply below the voltage detector's level.
#[interrupt]
fn PVD() -> ! {
    stop_for(Failure::Supply)
}

/// Handles a failed crystal: only the clock security system raises this interrupt.
#[exception]
unsafe fn NonMaskableInt() -> ! {
    stop_for(Failure::Crystal)
}

/// Repeats the stop after [`stop_after_fault`] until the watchdog resets the board.
pub fn halt() -> ! {
    LINES.send_stop_forever()
}
