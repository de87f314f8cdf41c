//! An STM32F405 without sensors and motors: QEMU's `netduinoplus2`, or a flight board on a desk.
//!
//! The same tasks run here as in flight. Their inputs come from a [`source`]:
//!
//! | features | chip | source |
//! |---|---|---|
//! | `qemu` | that of QEMU | the table of `fixed-input`, timed by an interrupt that comes twice a millisecond |
//! | `hil-qemu` | that of QEMU | `sim-host` at the other end of two pipes |
//! | `hil-usart` | that of QEMU | `sim-host` at the other end of a serial port |
//! | `hil` | that of a flight board | `sim-host` at the other end of a serial port |
//!
//! No motor can turn: no pin is connected to a timer, and on a flight board the motor timers do not even have a clock.
//!
//! QEMU's limits determine much of this module (measured with 7.2). RCC reads as zero, so a flight board's
//! clock set-up would never end. SPI is a stub. Of the timers, only 2 to 5 count, at 1 GHz regardless of the clock
//! tree. They interrupt at the end of their period, but have no compare interrupt, and restarting one gives its next
//! interrupt a wrong time.
//!
//! # Cost of a step
//! QEMU counts the instructions from the entry of the interrupt that brings a sample to the last write of a
//! motor's compare value: TIM4 counts 250 MHz there, and with `-icount shift=2` an instruction takes 4 ns. The count
//! includes the control loop's entry, its locks, the decoding of the frame, the flight controller with arming and
//! failsafe, and the conversion of the pulses. It does not include the work that only the flight board does: starting
//! the burst, checking its end, and waiting near the end of the timers' period.

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use cortex_m::peripheral::{NVIC, SCB};
use drivers::icm42688p::{FRAME_LEN, Frame};
use flight_core::arming::MotorPermit;
use flight_core::esc::protocol::{Protocol, STOP_US};
use flight_core::sample::ImuSample;
use stm32f4xx_hal::pac::{self, TIM3, TIM4, TIM5};
use stm32f4xx_hal::rcc::{Enable, Reset};
use tasks::sampling::{self, Action, BurstBus, FrameBuffer, Signal};

use super::{Board, stop};
use crate::interrupts::WAKE_CONTROL_LOOP;
use crate::stm32f405::dma::Stream;
use crate::stm32f405::esc::{self, Lines, Pad, Timer};

#[cfg_attr(feature = "qemu", path = "qemu.rs")]
#[cfg_attr(not(feature = "qemu"), path = "on_a_desk.rs")]
mod chip;
#[cfg_attr(feature = "hil", path = "link.rs")]
#[cfg_attr(not(feature = "hil"), path = "table.rs")]
mod source;

pub use chip::{NAME, halt};
pub use source::{BatteryAdc, Magnetometer, Monitor, RcReceiver, Watchdog};

/// Two timers, as on most flight boards; no pin is connected to them.
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

/// With this protocol QEMU's TIM4 has a prescaler of 3, with which it counts instructions.
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
/// The caller must own the timers.
unsafe fn enable_motor_timers() {
    // SAFETY: the caller owns the timers.
    unsafe {
        TIM3::enable_unchecked();
        TIM4::enable_unchecked();
    }
}

/// # Safety
/// The caller must own the timers.
unsafe fn reset_motor_timers() {
    // SAFETY: the caller owns the timers.
    unsafe {
        TIM3::reset_unchecked();
        TIM4::reset_unchecked();
    }
}

/// Wakes `control_loop`: software simulates the burst.
fn wake_control_loop(next: Action) {
    match next {
        Action::StartBurst | Action::WakeControlLoop => NVIC::pend(WAKE_CONTROL_LOOP),
        Action::StopMotors => stop(),
    }
}

/// Starts the time and the source.
pub fn init(mut core: cortex_m::Peripherals, device: pac::Peripherals) -> Board {
    chip::start(device);
    LINES.start();
    // The outputs poll TIM3's counter for room in the period. Here TIM3 counts slowly, and each slot restarts its
    // count, so that there is always room.
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

/// Returns the free-running time, µs; zero is the first slot's start.
pub fn now_us() -> u32 {
    tim5().cnt().read().cnt().bits().wrapping_sub(ZERO.load(Ordering::Relaxed))
}

/// Sets the current time, µs.
fn set_now(us: u32) {
    ZERO.store(ZERO.load(Ordering::Relaxed).wrapping_add(now_us().wrapping_sub(us)), Ordering::Relaxed);
}

fn tim3() -> &'static pac::tim3::RegisterBlock {
    // SAFETY: the control loop also writes to it, but does not run at the same time as the other users.
    unsafe { &*TIM3::ptr() }
}

fn tim5() -> &'static pac::tim5::RegisterBlock {
    // SAFETY: after `init` its counter is only read.
    unsafe { &*TIM5::ptr() }
}

/// Instruction count when the sample came.
static ARRIVED: AtomicU32 = AtomicU32::new(0);
/// Instruction count after the motors' last compare value was written.
static OUTPUTS_WRITTEN: AtomicU32 = AtomicU32::new(0);

/// The frame of the next slot.
static FRAME: FrameBuffer = FrameBuffer::new();

/// Prepares a slot: writes its frame as the IMU would send it, and pends the task `tick`, which starts the other tasks.
fn prepare_frame(sample: ImuSample) {
    let axes = sample.accel.into_iter().chain(sample.gyro).flat_map(i16::to_be_bytes);
    // The byte received with the address, the axes, two bytes of time, and the flag of a new sample.
    let mut frame = [0; FRAME_LEN];
    for (place, byte) in frame.iter_mut().zip([0].into_iter().chain(axes).chain([0, 0, 0x08])) {
        *place = byte;
    }
    FRAME.write(&frame);
    tim3().egr().write(|w| w.ug().set_bit());
    SCB::set_pendst();
}

/// The frames of the slots.
pub struct Frames;

impl BurstBus for Frames {
    /// The simulated IMU never needs a set-up.
    const SUPPORTS_SETUP: bool = false;

    /// Only software pends the vector here, so there is no flag to clear. The frame is written before the vector is
    /// pended.
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

/// The samples of the slots.
pub type Sampler = sampling::Sampler<Frames>;

/// The simulated IMU, which is never set up.
pub struct Imu;

impl Imu {
    /// Does nothing: it is never called.
    pub fn run(&mut self) {}
}

// The pulses sent last, µs as the bits of an f32, and whether they were sent with a permit: for the record.
static SENT: [AtomicU32; 4] = [const { AtomicU32::new(STOP_US.to_bits()) }; 4];
static DRIVEN: AtomicBool = AtomicBool::new(false);

#[inline]
fn send(driven: bool, pulses_us: [f32; 4]) {
    let [front_left, front_right, rear_right, rear_left] = pulses_us;
    // PWM accepts every pulse.
    let _ = LINES.send([rear_right, front_right, rear_left, front_left]);
    OUTPUTS_WRITTEN.store(chip::instructions(), Ordering::Relaxed);
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

/// Sends the stop pulse after a fault.
pub fn stop_after_fault() {
    send(false, [STOP_US; 4]);
}

/// Returns the instructions of a step with a sample, from its interrupt to the motors' last compare value.
fn sample_to_motors() -> u32 {
    OUTPUTS_WRITTEN.load(Ordering::Relaxed).wrapping_sub(ARRIVED.load(Ordering::Relaxed))
}

/// Returns the pulses sent last, µs, and whether they were sent with a permit.
fn last_outputs() -> ([f32; 4], bool) {
    (SENT.each_ref().map(|us| f32::from_bits(us.load(Ordering::Relaxed))), DRIVEN.load(Ordering::Relaxed))
}
