//! SpeedyBee F405 V4: STM32F405RGT6, ICM-42688-P, 8 MHz crystal.
//!
//! Pins, timers and mounting are as two independent projects have them, which agree:
//! - Betaflight, `betaflight/config`: `configs/SPEEDYBEEF405V4/config.h`
//! - ArduPilot, `ArduPilot/ardupilot`: `libraries/AP_HAL_ChibiOS/hwdef/speedybeef4v4/hwdef.dat`
//!
//! | what | pins | by |
//! |---|---|---|
//! | inertial sensor | SCK PA5, MISO PA6, MOSI PA7, CS PA4 | SPI1, 10.5 MHz, mode 3 |
//! | its data ready | PC4 | EXTI4, rising edge |
//! | motor pads M1, M2 | PB6, PB7 | TIM4 channels 1, 2 |
//! | motor pads M3, M4 | PB0, PB1 | TIM3 channels 3, 4 |
//! | light | PC13, lit when low | |
//! | time, and the deadline | – | TIM5 at 1 MHz, compare channel 1 |
//!
//! `docs/hardware.md` has the pins that are not used yet, and how to wire the rest.

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use cortex_m::peripheral::NVIC;
use drivers::icm42688p::{self, Icm42688p};
use embedded_hal::spi::MODE_3;
use embedded_hal_bus::spi::{ExclusiveDevice, NoDelay};
use flight_core::arming::MotorPermit;
use flight_core::calibration::Sensitivity;
use flight_core::esc::protocol::{STOP_US, pwm_counts};
use flight_core::geometry::{Mat3, vec3};
use flight_core::sample::Health;
use flight_core::{Config, Input, Params};
use stm32f4xx_hal::gpio::{self, Edge, PinState, Speed};
use stm32f4xx_hal::pac::{self, Interrupt, SPI1, TIM3, TIM4, TIM5, interrupt};
use stm32f4xx_hal::prelude::*;
use stm32f4xx_hal::rcc::{self, Enable};
use stm32f4xx_hal::spi::Spi;
use stm32f4xx_hal::timer::ErasedChannel;

use super::{Board, OVERDUE_US, PERIOD_US, Step, WAKE_FLIGHT, listen};
use crate::clock::Clock;

/// The board's name.
pub const NAME: &str = "SpeedyBee F405 V4";

/// Pulses a second on each output: the 2,500 µs from one start to the next hold the longest pulse.
const PULSE_RATE_HZ: u32 = 400;
/// Counts of the pulse timers in a microsecond: their 84 MHz over 4, the smallest divider with which 2,500 µs
/// fit into 16 bits.
const PULSE_COUNTS_PER_US: f32 = 21.0;
/// Counts of a pulse timer from one pulse to the next.
const PULSE_PERIOD_COUNTS: u16 = 52_500;

/// Datasheet sensitivities, and the sensor turned as it is on this board: its x points right, its y forward,
/// its z up.
pub fn config() -> Config {
    let mut params = Params::default();
    let mounting = Mat3 { rows: [vec3(0.0, 1.0, 0.0), vec3(1.0, 0.0, 0.0), vec3(0.0, 0.0, -1.0)] };
    params.gyro = Sensitivity { mounting, ..params.gyro };
    params.accel = Sensitivity { mounting, ..params.accel };
    Config { params, calibration: None }
}

/// Brings the board up: clocks, then the stop pulse on the outputs, then everything else.
pub fn init(mut core: cortex_m::Peripherals, device: pac::Peripherals) -> Board {
    let clocks = rcc::Config::hse(8.MHz()).sysclk(168.MHz()).hclk(168.MHz()).pclk1(42.MHz()).pclk2(84.MHz());
    let mut rcc = device.RCC.freeze(clocks);
    let gpioa = device.GPIOA.split(&mut rcc);
    let gpiob = device.GPIOB.split(&mut rcc);
    let gpioc = device.GPIOC.split(&mut rcc);

    let (_, (m1, m2, ..)) = device.TIM4.pwm_hz(PULSE_RATE_HZ.Hz(), &mut rcc);
    let (_, (_, _, m3, m4)) = device.TIM3.pwm_hz(PULSE_RATE_HZ.Hz(), &mut rcc);
    let mut outputs = Outputs {
        m1: m1.with(gpiob.pb6).erase(),
        m2: m2.with(gpiob.pb7).erase(),
        m3: m3.with(gpiob.pb0).erase(),
        m4: m4.with(gpiob.pb1).erase(),
    };
    outputs.stop();
    outputs.enable();

    // While a debug probe halts the core, the pulses stop too, and without pulses an ESC stops its motor. And
    // the probe can read the log while the core sleeps.
    device.DBGMCU.apb1_fz().modify(|_, w| w.dbg_tim3_stop().set_bit().dbg_tim4_stop().set_bit());
    device.DBGMCU.cr().modify(|_, w| w.dbg_sleep().set_bit());

    let light = gpioc.pc13.into_push_pull_output_in_state(PinState::High);

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
    let Ok(spi) = ExclusiveDevice::new_no_delay(spi, select);
    let mut delay = core.SYST.delay(&rcc.clocks);
    let imu = match Icm42688p::new(spi, &mut delay) {
        Ok(imu) => Some(imu),
        Err(error) => {
            // The flight task runs all the same, and refuses to arm.
            defmt::error!("inertial sensor: {}", defmt::Debug2Format(&error));
            None
        }
    };

    // TIM5 counts 84 MHz down to microseconds; the first deadline is set before the first sample.
    TIM5::enable(&mut rcc);
    let prescaler = rcc.clocks.timclk1().raw() / 1_000_000 - 1;
    device.TIM5.psc().write(|w| w.psc().set(prescaler as u16));
    device.TIM5.egr().write(|w| w.ug().set_bit());
    device.TIM5.ccr1().write(|w| w.ccr().set(OVERDUE_US));
    device.TIM5.sr().write(|w| w.cc1if().clear_bit());
    device.TIM5.dier().write(|w| w.cc1ie().set_bit());
    device.TIM5.cr1().write(|w| w.cen().set_bit());
    listen(&mut core.NVIC, Interrupt::TIM5);

    let mut exti = device.EXTI;
    let mut data_ready = gpioc.pc4.into_pull_down_input();
    data_ready.make_interrupt_source(&mut device.SYSCFG.constrain(&mut rcc));
    data_ready.trigger_on_edge(&mut exti, Edge::Rising);
    data_ready.enable_interrupt(&mut exti);
    listen(&mut core.NVIC, Interrupt::EXTI4);

    Board { sensors: Sensors { imu, clock: Clock::default() }, outputs, monitor: Monitor { light, steps: 0 } }
}

/// Free-running microseconds.
pub fn now_us() -> u32 {
    tim5().cnt().read().cnt().bits()
}

fn tim5() -> &'static pac::tim5::RegisterBlock {
    // SAFETY: after `init` nobody owns TIM5. Its counter is only read, and its compare channel 1 is used by
    // the two interrupt handlers below alone, which cannot preempt each other.
    unsafe { &*TIM5::ptr() }
}

// What woke the flight task: written by the handlers below, taken by `Sensors::take`.
static SAMPLE_READY: AtomicBool = AtomicBool::new(false);
static SAMPLE_READY_US: AtomicU32 = AtomicU32::new(0);
static SAMPLE_OVERDUE: AtomicBool = AtomicBool::new(false);
static SAMPLE_OVERDUE_US: AtomicU32 = AtomicU32::new(0);

/// The sensor has a sample.
#[interrupt]
fn EXTI4() {
    let ready_us = now_us();
    // SAFETY: this register's bits are cleared by writing ones, so that nothing else is touched.
    unsafe { &*pac::EXTI::ptr() }.pr().write(|w| w.pr4().clear_bit_by_one());
    tim5().ccr1().write(|w| w.ccr().set(ready_us.wrapping_add(OVERDUE_US)));
    SAMPLE_READY_US.store(ready_us, Ordering::Relaxed);
    SAMPLE_READY.store(true, Ordering::Release);
    NVIC::pend(WAKE_FLIGHT);
}

/// The sensor's next sample is overdue.
#[interrupt]
fn TIM5() {
    let overdue_us = now_us();
    tim5().sr().write(|w| w.cc1if().clear_bit());
    tim5().ccr1().write(|w| w.ccr().set(overdue_us.wrapping_add(PERIOD_US)));
    SAMPLE_OVERDUE_US.store(overdue_us, Ordering::Relaxed);
    SAMPLE_OVERDUE.store(true, Ordering::Release);
    NVIC::pend(WAKE_FLIGHT);
}

type Imu = Icm42688p<ExclusiveDevice<Spi<SPI1>, gpio::PA4<gpio::Output>, NoDelay>>;

/// The inertial sensor, and the time.
pub struct Sensors {
    imu: Option<Imu>,
    clock: Clock,
}

impl Sensors {
    /// The next step's input, or `None` if there is nothing to do: the wake-up that brought an overdue sample
    /// together with its deadline is followed by an empty one.
    pub fn take(&mut self) -> Option<Input> {
        let ready = SAMPLE_READY.swap(false, Ordering::Acquire);
        let overdue = SAMPLE_OVERDUE.swap(false, Ordering::Acquire);
        let (at_us, imu) = if ready {
            // An unreadable sample is a missing one.
            let frame = self.imu.as_mut().and_then(|imu| imu.read_frame().ok());
            let risen = SAMPLE_READY.load(Ordering::Acquire);
            let sample = frame.and_then(|frame| icm42688p::decode(&frame, risen).ok());
            (SAMPLE_READY_US.load(Ordering::Relaxed), sample)
        } else if overdue {
            (SAMPLE_OVERDUE_US.load(Ordering::Relaxed), None)
        } else {
            return None;
        };
        Some(Input {
            time_us: self.clock.extend(at_us),
            imu,
            mag: None,
            rc: None,
            battery: None,
            bench: None,
            health: Health::default(),
        })
    }
}

/// The four motor pads.
pub struct Outputs {
    m1: ErasedChannel<TIM4>,
    m2: ErasedChannel<TIM4>,
    m3: ErasedChannel<TIM3>,
    m4: ErasedChannel<TIM3>,
}

impl Outputs {
    /// Sends pulses of rotors 1 to 4. The permit is used up: a step has one, and it moves the motors once.
    pub fn drive(&mut self, permit: MotorPermit, pulses_us: [f32; 4]) {
        self.write(permit.apply(pulses_us, STOP_US));
    }

    /// Sends the stop pulse to all four.
    pub fn stop(&mut self) {
        self.write([STOP_US; 4]);
    }

    /// The output map. A 4-in-1 ESC plugged into this board has motor 1 at the rear right, 2 at the front
    /// right, 3 at the rear left and 4 at the front left; rotors are counted clockwise from the front left.
    fn write(&mut self, pulses_us: [f32; 4]) {
        let [front_left, front_right, rear_right, rear_left] =
            pulses_us.map(|us| pwm_counts(us, PULSE_COUNTS_PER_US));
        self.m4.set_duty(front_left);
        self.m2.set_duty(front_right);
        self.m1.set_duty(rear_right);
        self.m3.set_duty(rear_left);
    }

    fn enable(&mut self) {
        assert_eq!(self.m1.get_max_duty(), PULSE_PERIOD_COUNTS);
        assert_eq!(self.m3.get_max_duty(), PULSE_PERIOD_COUNTS);
        self.m1.enable();
        self.m2.enable();
        self.m3.enable();
        self.m4.enable();
    }
}

/// [`Outputs::stop`], from a fault: the stop pulse follows at the end of the pulse period, by hardware alone.
pub fn stop_outputs() {
    let stop = pwm_counts(STOP_US, PULSE_COUNTS_PER_US);
    // SAFETY: interrupts are off and the fault does not return, so the owner of the timers does not run any
    // more. Before `init` the timers have no clock, and the writes go nowhere.
    let (tim3, tim4) = unsafe { (&*TIM3::ptr(), &*TIM4::ptr()) };
    tim4.ccr1().write(|w| w.ccr().set(stop));
    tim4.ccr2().write(|w| w.ccr().set(stop));
    tim3.ccr3().write(|w| w.ccr().set(stop));
    tim3.ccr4().write(|w| w.ccr().set(stop));
}

/// Stays here; the timers go on sending the stop pulse.
pub fn halt() -> ! {
    loop {
        cortex_m::asm::nop();
    }
}

/// The light: lit while armed, a short flash a second while disarmed, a fast blink while samples are missing.
pub struct Monitor {
    light: gpio::PC13<gpio::Output>,
    steps: u32,
}

impl Monitor {
    /// Shows a step.
    pub fn show(&mut self, step: &Step) {
        self.steps = self.steps.wrapping_add(1);
        let lit = if !step.sampled {
            self.steps % 200 < 100
        } else {
            step.state.flies() || self.steps % 1_000 < 50
        };
        self.light.set_state(if lit { PinState::Low } else { PinState::High });
    }
}
