//! An STM32F405 that is wired to no sensor and no motor: QEMU's `netduinoplus2`, or a flight board on a desk.
//!
//! The same tasks run here as in flight. What they get comes from a [`source`]:
//!
//! | features | chip | source |
//! |---|---|---|
//! | `qemu` | emulated | the table of `fixed-input`, at the times of an interrupt that comes twice a millisecond |
//! | `hil-qemu` | emulated | `sim-host` at the other end of two pipes |
//! | `hil-usart` | emulated | `sim-host` at the other end of a serial port |
//! | `hil` | the flight board's | the same |
//!
//! Nothing can turn a motor: no pin is connected to a timer, and on a flight board the motors' timers do not even have
//! a clock.
//!
//! What the emulator lacks decides much (measured with 7.2): RCC reads as zero, so that the clock setup of
//! a flight board would wait for ever; SPI is a stub; of the timers, 2 to 5 count (at 1 GHz, whatever the clock
//! tree says) and interrupt at the end of their period, but have no compare interrupt, and restarting one puts
//! its next interrupt at a wrong time.
//!
//! # What a step costs
//! From the entry of the interrupt that brings a sample to the last compare value of the motors, instructions are
//! counted on the emulator: TIM4 counts 250 MHz there, and with `-icount shift=2` an instruction takes 4 ns. In that
//! are the control loop's entry, its locks, the decoding of the frame, the flight controller with arming and failsafe,
//! and the pulses' conversion. Not in it is what only the flight board does: starting the burst, looking at its end,
//! and waiting for room in the timers' period if there is none.

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use cortex_m::peripheral::{NVIC, SCB};
use drivers::icm42688p::{FRAME_LEN, Frame};
use flight_core::arming::MotorPermit;
use flight_core::esc::protocol::{Protocol, STOP_US};
use flight_core::sample::ImuSample;
use stm32f4xx_hal::pac::{self, TIM3, TIM4, TIM5};
use stm32f4xx_hal::rcc::{Enable, Reset};
use tasks::sampling::{self, BurstBus, FrameBuffer, Next, Signal};

use super::{Board, stop};
use crate::interrupts::WAKE_CONTROL_LOOP;
use crate::stm32f405::dma::Stream;
use crate::stm32f405::esc::{self, Lines, Pad, Timer};

#[cfg_attr(feature = "qemu", path = "emulated.rs")]
#[cfg_attr(not(feature = "qemu"), path = "on_a_desk.rs")]
mod chip;
#[cfg_attr(feature = "hil", path = "link.rs")]
#[cfg_attr(not(feature = "hil"), path = "table.rs")]
mod source;

pub use chip::{NAME, halt};
pub use source::{BatteryAdc, Magnetometer, Monitor, RcReceiver, Watchdog};

/// Two timers, as most flight boards have them; no pin is connected to them.
const TIMERS: [Timer; 2] = [
    Timer {
        registers: TIM4::PTR.cast(),
        advanced: false,
        stream: Stream::new(pac::DMA1::PTR, 6, 2),
        first: 0,
        pairs: 1,
    },
    Timer {
        registers: TIM3::PTR.cast(),
        advanced: false,
        stream: Stream::new(pac::DMA1::PTR, 2, 5),
        first: 2,
        pairs: 1,
    },
];

const fn pad(timer: usize, channel: u8) -> Pad {
    Pad { timer: TIMERS[timer].registers, channel, complementary: false }
}

/// The emulator's TIM4 has a prescaler of 3 then, which makes it count instructions.
const LINES: Lines = Lines::new(
    esc::Outputs {
        timers: &TIMERS,
        pads: &[pad(0, 0), pad(0, 1), pad(1, 2), pad(1, 3)],
        enable: enable_motor_timers,
        reset: reset_motor_timers,
    },
    Protocol::Pwm { rate_hz: 400.0 },
);

/// # Safety
/// Whoever calls it has the timers.
unsafe fn enable_motor_timers() {
    // SAFETY: the caller's.
    unsafe {
        TIM3::enable_unchecked();
        TIM4::enable_unchecked();
    }
}

/// # Safety
/// Whoever calls it has the timers.
unsafe fn reset_motor_timers() {
    // SAFETY: the caller's.
    unsafe {
        TIM3::reset_unchecked();
        TIM4::reset_unchecked();
    }
}

/// Wakes `flight`: software alone plays the burst.
fn wake_flight(next: Next) {
    match next {
        Next::Burst | Next::Flight => NVIC::pend(WAKE_CONTROL_LOOP),
        Next::Stop => stop(),
    }
}

/// Starts the time, and the source.
pub fn init(mut core: cortex_m::Peripherals, device: pac::Peripherals) -> Board {
    chip::start(device);
    LINES.start();
    // TIM3 is the one that is asked for room in the period. Here its count does not end with the period: it goes
    // slowly, and begins anew with each slot, so that there is always room.
    tim3().psc().write(|w| w.psc().set(u16::MAX));
    tim5().psc().write(|w| w.psc().set(chip::TIM5_MHZ - 1));
    tim5().egr().write(|w| w.ug().set_bit());
    tim5().cr1().write(|w| w.cen().set_bit());
    let watchdog_reset = source::begin(&mut core.NVIC);

    Board {
        config: source::config(),
        sampler: Sampler::new(Frames),
        imu: Imu,
        outputs: Outputs(()),
        monitor: Monitor::default(),
        receiver: RcReceiver::default(),
        battery_adc: BatteryAdc::default(),
        magnetometer: Magnetometer::default(),
        watchdog: Watchdog,
        reset_by: if watchdog_reset { "watchdog" } else { "power" },
        watchdog_reset,
    }
}

/// TIM5's count at the time zero.
static ZERO: AtomicU32 = AtomicU32::new(0);

/// Free-running microseconds; zero is the first slot's start.
pub fn now_us() -> u32 {
    tim5().cnt().read().cnt().bits().wrapping_sub(ZERO.load(Ordering::Relaxed))
}

/// It is this time now.
fn set_now(us: u32) {
    ZERO.store(ZERO.load(Ordering::Relaxed).wrapping_add(now_us().wrapping_sub(us)), Ordering::Relaxed);
}

fn tim3() -> &'static pac::tim3::RegisterBlock {
    // SAFETY: the control loop, which also writes to it, does not run while anybody here does.
    unsafe { &*TIM3::ptr() }
}

fn tim5() -> &'static pac::tim5::RegisterBlock {
    // SAFETY: after `init` its counter is only read.
    unsafe { &*TIM5::ptr() }
}

/// When the sample came, in instructions.
static CAME: AtomicU32 = AtomicU32::new(0);
/// When the motors' last compare value was written.
static WRITTEN: AtomicU32 = AtomicU32::new(0);

/// The frame of the slot that comes next.
static FRAME: FrameBuffer = FrameBuffer::new();

/// Prepares a slot: its frame as the sensor would send it, and the task `tick`, which brings the rest.
fn play(sample: ImuSample) {
    let axes = sample.accel.into_iter().chain(sample.gyro).flat_map(i16::to_be_bytes);
    // The byte that comes with the address, the axes, two bytes of time, and the flag of a new sample.
    let mut frame = [0; FRAME_LEN];
    for (place, byte) in frame.iter_mut().zip([0].into_iter().chain(axes).chain([0, 0, 0x08])) {
        *place = byte;
    }
    FRAME.write(&frame);
    tim3().egr().write(|w| w.ug().set_bit());
    SCB::set_pendst();
}

/// The slots' frames.
pub struct Frames;

impl BurstBus for Frames {
    /// Whoever plays the sensor plays its end too.
    const SETS_UP: bool = false;

    /// Software pends the vector here, and so nothing stays up: the frame is there before the vector is pended.
    #[inline]
    fn acknowledge(&mut self) -> Signal {
        Signal::Done
    }

    #[inline]
    fn finish(&mut self) -> Frame {
        FRAME.read()
    }

    fn abort(&mut self) {}
}

/// The slots' samples.
pub type Sampler = sampling::Sampler<Frames>;

/// The sensor is played, and never set up.
pub struct Imu;

impl Imu {
    /// Is never called.
    pub fn run(&mut self) {}
}

// The pulses last sent, µs as the bits of an f32, and whether with a permit: for the record.
static SENT: [AtomicU32; 4] = [const { AtomicU32::new(STOP_US.to_bits()) }; 4];
static DRIVEN: AtomicBool = AtomicBool::new(false);

#[inline]
fn send(driven: bool, pulses_us: [f32; 4]) {
    let [front_left, front_right, rear_right, rear_left] = pulses_us;
    // PWM takes every pulse.
    let _ = LINES.send([rear_right, front_right, rear_left, front_left]);
    WRITTEN.store(chip::instructions(), Ordering::Relaxed);
    DRIVEN.store(driven, Ordering::Relaxed);
    for (sent, us) in SENT.iter().zip(pulses_us) {
        sent.store(us.to_bits(), Ordering::Relaxed);
    }
}

/// The motors' pulses, which go to timers without pins, and to the record.
pub struct Outputs(());

impl Outputs {
    /// Sends pulses of rotors 1 to 4.
    #[inline]
    pub fn drive(&mut self, permit: MotorPermit, pulses_us: [f32; 4]) {
        send(true, permit.apply(pulses_us, STOP_US));
    }

    /// Sends the stop pulse to all four.
    #[inline]
    pub fn stop(&mut self) {
        send(false, [STOP_US; 4]);
    }
}

/// [`Outputs::stop`], from a fault.
pub fn stop_after_fault() {
    send(false, [STOP_US; 4]);
}

/// What a step with a sample took, from its interrupt to the motors' last compare value, in instructions.
fn sample_to_motors() -> u32 {
    WRITTEN.load(Ordering::Relaxed).wrapping_sub(CAME.load(Ordering::Relaxed))
}

/// What went out to the motors last, µs, and whether with a permit.
fn sent() -> ([f32; 4], bool) {
    (SENT.each_ref().map(|us| f32::from_bits(us.load(Ordering::Relaxed))), DRIVEN.load(Ordering::Relaxed))
}
