//! SpeedyBee F405 V4: STM32F405RGT6, ICM-42688-P, 8 MHz crystal.
//!
//! Pins, timers and mounting are as two independent projects have them, which agree:
//! - Betaflight, `betaflight/config`: `configs/SPEEDYBEEF405V4/config.h`
//! - ArduPilot, `ArduPilot/ardupilot`: `libraries/AP_HAL_ChibiOS/hwdef/speedybeef4v4/hwdef.dat` and `README.md`
//!
//! | what | pins | by |
//! |---|---|---|
//! | inertial sensor | SCK PA5, MISO PA6, MOSI PA7, CS PA4 | SPI1, 10.5 MHz, mode 3; DMA2 streams 0, 3 |
//! | its data ready | PC4 | EXTI4, rising edge |
//! | motor pads M1, M2 | PB6, PB7 | TIM4 channels 1, 2; DMA1 stream 6 |
//! | motor pads M3, M4 | PB0, PB1 | TIM3 channels 3, 4; DMA1 stream 2 |
//! | receiver: pad R2, and pad SBUS behind an inverter | PA3 | USART2 |
//! | magnetometer | SCL PB8, SDA PB9 | I2C1 |
//! | battery, ÷ 11 | PC0 | ADC1 channel 10 |
//! | light | PC13, lit when low | |
//! | time, and the deadline | – | TIM5 at 1 MHz, compare channel 1 |
//! | tick | – | SysTick |
//!
//! `docs/hardware.md` has the pins that are not used, and how to wire the rest.

use cortex_m::peripheral::NVIC;
use cortex_m::peripheral::syst::SystClkSource;
use cortex_m::singleton;
use embedded_hal::delay::DelayNs;
use embedded_hal::spi::MODE_3;
use flight_core::arming::MotorPermit;
use flight_core::calibration::Sensitivity;
use flight_core::esc::protocol::{Protocol, STOP_US};
use flight_core::geometry::{Mat3, vec3};
use flight_core::sample::{MagSample, RcFrame};
use flight_core::{ArmState, Config, Params};
use stm32f4xx_hal::gpio::{self, Edge, PinState, Speed};
use stm32f4xx_hal::pac::{self, Interrupt, TIM3, TIM4, TIM5, interrupt};
use stm32f4xx_hal::prelude::*;
use stm32f4xx_hal::rcc::{self, Enable};
use stm32f4xx_hal::spi::Spi;
use stored_config::{DecodeError, MAX_RECORD};

use super::{Board, OVERDUE_US, PERIOD_US, SENSE_PRIORITY, Step, WAKE_FLIGHT, listen};
use crate::clock::Clock;
pub use crate::imu::Imu;
use crate::pilot::Pilot;
use crate::sampling;
use crate::stm32f405::burst::{self, ImuBus, ImuSpi};
use crate::stm32f405::bus::{self, Bus};
use crate::stm32f405::esc::{Lines, Sent};
pub use crate::stm32f405::port::Ear;
use crate::stm32f405::port::{self, Bytes, Port};
use crate::stm32f405::power::{self, Failure};
use crate::stm32f405::reset::Cause;
pub use crate::stm32f405::reset::Watchdog;
pub use crate::stm32f405::supply::Supply;
use crate::stored::{self, Refused};
use crate::tally::TALLY;

/// The board's name.
pub const NAME: &str = "SpeedyBee F405 V4";

/// What the ESCs are driven with: as the vehicle's file says, or the variable `KESTREL_ESC` at build time
/// (`docs/hardware.md`). The ESC that is sold with this board is specified for DShot300 and DShot600.
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
        _ => panic!("KESTREL_ESC is pwm, oneshot125, dshot300 or dshot600"),
    }
};

/// The vehicle's configuration as a record, made of its file at build time (`build.rs`). Its name is for those who read
/// the image.
#[unsafe(no_mangle)]
#[used]
static KESTREL_VEHICLE: [u8; VEHICLE.len()] = *VEHICLE;
const VEHICLE: &[u8; include_bytes!(concat!(env!("OUT_DIR"), "/vehicle.bin")).len()] =
    include_bytes!(concat!(env!("OUT_DIR"), "/vehicle.bin"));

/// Divider from the battery to its pin, and the pin's ADC channel.
const BATTERY_RATIO: f32 = 11.0;
const BATTERY_CHANNEL: u8 = 10;

const LINES: Lines = Lines::new(ESC);

/// How the inertial sensor is soldered to this board: its x points right, its y forward, its z up. A row says what a
/// body axis (forward, right, down) reads of the chip's axes.
const IMU_MOUNTING: Mat3<f32> =
    Mat3 { rows: [vec3(0.0, 1.0, 0.0), vec3(1.0, 0.0, 0.0), vec3(0.0, 0.0, -1.0)] };

/// How the magnetometer is mounted on the vehicle, likewise. To be set for the vehicle: `docs/hardware.md` says how to
/// find it out, and how to check it. As it stands here: the chip's x forward, its y to the right, its z down.
const MAG_MOUNTING: Mat3<f32> =
    Mat3 { rows: [vec3(1.0, 0.0, 0.0), vec3(0.0, 1.0, 0.0), vec3(0.0, 0.0, 1.0)] };

unsafe extern "C" {
    /// The parameter sectors (memory.x): flash, which nothing in this image writes to.
    safe static STORED_CONFIG: [u8; MAX_RECORD];
}

/// What the board has: datasheet sensitivities, and the sensors turned as they are mounted.
fn params() -> Params {
    let mut params = Params::default();
    params.gyro = Sensitivity { mounting: IMU_MOUNTING, ..params.gyro };
    params.accel = Sensitivity { mounting: IMU_MOUNTING, ..params.accel };
    params.mag = Sensitivity { mounting: MAG_MOUNTING, ..params.mag };
    params
}

/// The stored configuration; without one that is sound, that of the vehicle's file without a calibration, which does not
/// arm.
///
/// A function of its own, so that what it takes of the stack is free again when the rest of the board is brought up.
#[inline(never)]
fn config() -> Config {
    let params = params();
    // A record is made of a vehicle's file or of a scene, which know of no mounting of the magnetometer.
    let mounted = |mut config: Config| {
        config.params.mag.mounting = MAG_MOUNTING;
        config
    };
    match stored::read(&STORED_CONFIG, &params).map(mounted) {
        Ok(config) => {
            defmt::info!("configuration: stored, calibrated {=bool}", config.calibration.is_some());
            config
        }
        Err(refused) => {
            let (what, field) = refused.text();
            if refused == Refused::Record(DecodeError::Empty) {
                defmt::warn!("configuration: {=str}, flying needs one", what);
            } else {
                defmt::error!("stored configuration refused: {=str}{=str}", what, field);
            }
            defmt::info!("configuration: vehicle {=str}", env!("KESTREL_VEHICLE_NAME"));
            // The build has seen to it that it is one.
            stored::read(&KESTREL_VEHICLE, &params).map_or(Config { params, calibration: None }, mounted)
        }
    }
}

/// Brings the board up: the motor pads low, the watchdog, clocks, the stop on the outputs, then everything else.
pub fn init(mut core: cortex_m::Peripherals, device: pac::Peripherals) -> Board {
    // The pads float after a reset, and what an ESC makes of that is its affair. The pull-downs stay for ever: a timer
    // that is being set up anew does not drive its pads.
    let mut rcc = device.RCC.constrain();
    let gpiob = device.GPIOB.split(&mut rcc);
    let (m1, m2) = (gpiob.pb6.into_pull_down_input(), gpiob.pb7.into_pull_down_input());
    let (m3, m4) = (gpiob.pb0.into_pull_down_input(), gpiob.pb1.into_pull_down_input());

    let watchdog = Watchdog::start(device.IWDG);
    power::wait_for_supply(&device.PWR, &mut rcc);
    let clocks = rcc::Config::hse(8.MHz()).sysclk(168.MHz()).hclk(168.MHz()).pclk1(42.MHz()).pclk2(84.MHz());
    let mut rcc = rcc.freeze(clocks);
    power::watch_crystal(&mut rcc);
    let reset = Cause::take(&mut rcc);
    let gpioa = device.GPIOA.split(&mut rcc);
    let gpioc = device.GPIOC.split(&mut rcc);

    TIM3::enable(&mut rcc);
    TIM4::enable(&mut rcc);
    pac::DMA1::enable(&mut rcc);
    LINES.start();
    // Edges of 20 ns: a 0 of DShot600 is high for 625.
    m1.into_alternate::<2>().set_speed(Speed::Medium);
    m2.into_alternate::<2>().set_speed(Speed::Medium);
    m3.into_alternate::<2>().set_speed(Speed::Medium);
    m4.into_alternate::<2>().set_speed(Speed::Medium);

    // While a debug probe halts the core, the timers stand, and without frames or pulses an ESC stops its motor. A pad
    // that is high then stays high until the core goes on (docs/hardware.md). The watchdog waits. And the probe can
    // read the log while the core sleeps.
    device
        .DBGMCU
        .apb1_fz()
        .modify(|_, w| w.dbg_tim3_stop().set_bit().dbg_tim4_stop().set_bit().dbg_iwdg_stop().set_bit());
    device.DBGMCU.cr().modify(|_, w| w.dbg_sleep().set_bit());

    let light = gpioc.pc13.into_push_pull_output_in_state(PinState::High);

    // TIM5 counts 84 MHz down to microseconds; the first deadline is set when everything else is.
    TIM5::enable(&mut rcc);
    let prescaler = rcc.clocks.timclk1().raw() / 1_000_000 - 1;
    device.TIM5.psc().write(|w| w.psc().set(prescaler as u16));
    device.TIM5.egr().write(|w| w.ug().set_bit());
    device.TIM5.cr1().write(|w| w.cen().set_bit());

    if let Some(failure) = Failure::take() {
        defmt::error!("before the reset the motors were stopped: {=str}", failure.name());
    }
    if power::brown_out_reset_is_off(&device.FLASH) {
        defmt::warn!("the brown-out reset is not set");
    }

    let spi = Spi::new(
        device.SPI1,
        (
            Some(gpioa.pa5.into_alternate().speed(Speed::High)),
            Some(gpioa.pa6.into_alternate()),
            Some(gpioa.pa7.into_alternate().speed(Speed::High)),
        ),
        MODE_3,
        // The sensor takes up to 24 MHz; 84 MHz over 8 is 10.5 MHz.
        10.MHz(),
        &mut rcc,
    );
    let select = gpioa.pa4.into_push_pull_output_in_state(PinState::High);
    let imu = Imu::new(ImuSpi::new(spi, select));
    sampling::claim();
    let sampler = Sampler::new(ImuBus::new(device.DMA2, &mut rcc));

    gpioa.pa3.into_alternate::<7>().set_internal_resistor(gpio::Pull::Up);
    let bytes = singleton!(: Bytes = Bytes::new()).expect("init runs once");
    let (ear, port) = port::open(device.USART2, bytes, Pilot::FIRST.line(), &mut rcc);
    let config = config();
    let radio = Radio { port, pilot: Pilot::new(config.params.channels), clock: Clock::new(), damaged: 0 };

    gpioc.pc0.into_analog();
    let supply = Supply::new(device.ADC1, &device.ADC_COMMON, BATTERY_CHANNEL, BATTERY_RATIO, &mut rcc);
    let bus = Bus::new(device.I2C1, gpiob.pb8, gpiob.pb9, &mut rcc);
    let compass = Compass(crate::compass::Compass::new(bus));

    let mut exti = device.EXTI;
    power::watch_supply(&device.PWR, &exti, &mut core.NVIC);
    let mut data_ready = gpioc.pc4.into_pull_down_input();
    data_ready.make_interrupt_source(&mut device.SYSCFG.constrain(&mut rcc));
    data_ready.trigger_on_edge(&mut exti, Edge::Rising);
    data_ready.enable_interrupt(&mut exti);
    listen(&mut core.NVIC, Interrupt::EXTI4, SENSE_PRIORITY);
    expect_sample_by(now_us().wrapping_add(OVERDUE_US));
    tim5().dier().write(|w| w.cc1ie().set_bit());
    listen(&mut core.NVIC, Interrupt::TIM5, SENSE_PRIORITY);

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
        monitor: Monitor { light, steps: 0 },
        ear,
        radio,
        supply,
        compass,
        watchdog,
        reset_by: reset.name(),
        watchdog_reset: reset == Cause::Watchdog,
    }
}

/// Free-running microseconds.
pub fn now_us() -> u32 {
    tim5().cnt().read().cnt().bits()
}

fn tim5() -> &'static pac::tim5::RegisterBlock {
    // SAFETY: nobody owns TIM5 after `init`, and the two handlers that write to it have the same priority.
    unsafe { &*TIM5::ptr() }
}

/// Waits by TIM5, for those who may.
pub struct Wait;

impl DelayNs for Wait {
    fn delay_ns(&mut self, ns: u32) {
        let began_us = now_us();
        // One more, because the first has begun already.
        let us = ns.div_ceil(1_000).saturating_add(1);
        while now_us().wrapping_sub(began_us) < us {}
    }
}

/// Sets the deadline, and forgets that of the sample that has come.
fn expect_sample_by(us: u32) {
    tim5().ccr1().write(|w| w.ccr().set(us));
    acknowledge_deadline();
}

/// Whether the deadline has passed since this was last asked. Takes the interrupt down.
fn acknowledge_deadline() -> bool {
    let passed = tim5().sr().read().cc1if().bit_is_set();
    // A zero takes a flag down; nobody uses the others.
    tim5().sr().write(|w| w.cc1if().clear_bit());
    passed
}

/// The sensor has a sample.
#[interrupt]
fn EXTI4() {
    // SAFETY: this register's bits are cleared by writing ones, so that nothing else is touched.
    unsafe { &*pac::EXTI::ptr() }.pr().write(|w| w.pr4().clear_bit_by_one());
    let ready_us = now_us();
    expect_sample_by(ready_us.wrapping_add(OVERDUE_US));
    if sampling::ready(ready_us, burst::running()) {
        burst::start();
    } else {
        NVIC::pend(WAKE_FLIGHT);
    }
}

/// The sensor's next sample is overdue: it is asked for, in case the line is at fault.
#[interrupt]
fn TIM5() {
    // The sample may have come while this waited for its turn.
    if !acknowledge_deadline() {
        return;
    }
    let overdue_us = now_us();
    expect_sample_by(overdue_us.wrapping_add(PERIOD_US));
    if sampling::poll(overdue_us) {
        burst::start();
    } else {
        NVIC::pend(WAKE_FLIGHT);
    }
}

/// The inertial sensor, by DMA.
pub type Sampler = sampling::Sampler<ImuBus>;

/// The receiver.
pub struct Radio {
    port: Port,
    pilot: Pilot,
    clock: Clock,
    damaged: u32,
}

impl Radio {
    /// The next frame that the bytes so far have completed.
    pub fn poll(&mut self) -> Option<RcFrame> {
        let now_us = self.clock.at(now_us());
        while let Some((at_us, heard)) = self.port.next() {
            let found = self.pilot.found();
            let frame = self.pilot.hear(heard, self.clock.at(at_us));
            if found.is_none()
                && let Some(protocol) = self.pilot.found()
            {
                defmt::info!("receiver found: {=str}", protocol.name());
            }
            if frame.is_some() {
                TALLY.rc.add();
                return frame;
            }
        }
        let damaged = self.pilot.damaged();
        TALLY.rc_bad.add_all(damaged.saturating_sub(self.damaged));
        self.damaged = damaged;
        if let Some(line) = self.pilot.search(now_us) {
            self.port.set(line);
        }
        None
    }
}

/// The magnetometer.
pub struct Compass(crate::compass::Compass<Bus>);

impl Compass {
    /// The new sample, if there is one.
    pub fn run(&mut self) -> Option<MagSample> {
        bus::begin_run();
        self.0.run(&mut Wait)
    }
}

/// The four motor pads.
pub struct Outputs(());

impl Outputs {
    /// Sends pulses of rotors 1 to 4. The permit is used up: a step has one, and it moves the motors once.
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

/// The output map. A 4-in-1 ESC plugged into this board has motor 1 at the rear right, 2 at the front right, 3 at
/// the rear left and 4 at the front left; rotors are counted clockwise from the front left.
#[inline]
fn send([front_left, front_right, rear_right, rear_left]: [f32; 4]) {
    match LINES.send([rear_right, front_right, rear_left, front_left]) {
        Sent::Whole => {}
        Sent::Dropped => TALLY.outputs_dropped.add(),
        Sent::Recovered => TALLY.outputs_recovered.add(),
    }
}

/// Puts the stop on the motor pads after a fault, in whatever state it has found them. [`crate::stm32f405::esc`] says
/// how long that takes.
pub fn stop_after_fault() {
    // SAFETY: the clocks of a port that nothing else uses any more.
    unsafe { pac::GPIOB::enable_unchecked() };
    // SAFETY: it is only read.
    let on_pll = unsafe { &*pac::RCC::ptr() }.cfgr().read().sws().is_pll();
    if on_pll {
        LINES.settle(pads_are_low);
        connect_pads();
        send([STOP_US; 4]);
    } else {
        // A fault before the clocks are set up, or the crystal has failed. With this clock nothing can be sent: the
        // pads are low.
        pull_pads_down();
    }
}

/// After [`stop_after_fault`]: stays here until the watchdog resets the board, and goes on sending the stop.
pub fn halt() -> ! {
    LINES.stop_for_ever()
}

fn pads() -> &'static pac::gpiob::RegisterBlock {
    // SAFETY: after a fault nothing else uses the port, and until then this only reads.
    unsafe { &*pac::GPIOB::ptr() }
}

fn pads_are_low() -> bool {
    let levels = pads().idr().read();
    levels.idr0().is_low() && levels.idr1().is_low() && levels.idr6().is_low() && levels.idr7().is_low()
}

/// As [`init`] leaves them: to the timers, pulled down.
fn connect_pads() {
    pads()
        .pupdr()
        .modify(|_, w| w.pupdr0().pull_down().pupdr1().pull_down().pupdr6().pull_down().pupdr7().pull_down());
    pads().afrl().modify(|_, w| w.afrl0().af2().afrl1().af2().afrl6().af2().afrl7().af2());
    pads()
        .moder()
        .modify(|_, w| w.moder0().alternate().moder1().alternate().moder6().alternate().moder7().alternate());
}

fn pull_pads_down() {
    pads()
        .pupdr()
        .modify(|_, w| w.pupdr0().pull_down().pupdr1().pull_down().pupdr6().pull_down().pupdr7().pull_down());
    pads().moder().modify(|_, w| w.moder0().input().moder1().input().moder6().input().moder7().input());
}

/// The light.
///
/// | light | meaning |
/// |---|---|
/// | fast blink (5 Hz) | no inertial samples |
/// | lit | the motors turn, or may |
/// | slow blink (1 Hz) | terminated: disarm first |
/// | a short flash a second | disarmed, or in a state on the ground |
pub struct Monitor {
    light: gpio::PC13<gpio::Output>,
    steps: u32,
}

impl Monitor {
    /// Shows a step.
    #[inline]
    pub fn show(&mut self, step: &Step) {
        self.steps = self.steps.wrapping_add(1);
        let lit = if !step.sampled {
            self.steps % 200 < 100
        } else if step.state == ArmState::Terminated {
            self.steps % 1_000 < 500
        } else {
            step.state.flies() || self.steps % 1_000 < 50
        };
        self.light.set_state(if lit { PinState::Low } else { PinState::High });
    }
}
