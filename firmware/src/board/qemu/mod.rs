//! QEMU's `netduinoplus2`: an STM32F405 without a sensor, a motor, or most of its peripherals.
//!
//! The same tasks run here as on a flight board. What they get comes from a [`source`]: the table of
//! `fixed-input`, or, with the feature `hil-qemu`, `sim-host` at the other end of a link. A panic or a fault exits
//! with status 1.
//!
//! What the emulator lacks decides the rest (measured with 7.2): RCC reads as zero, so that the clock setup of
//! a flight board would wait for ever; SPI is a stub; of the timers, 2 to 5 count (at 1 GHz, whatever the clock
//! tree says) and interrupt at the end of their period, but have no compare interrupt, and restarting one puts
//! its next interrupt at a wrong time. So one timer ticks twice a millisecond, and plays the sensor, the deadline and
//! SysTick:
//!
//! ```text
//!  tick          -1    0     1     2     3     4     5     6
//!  slot                0           1           2           3
//!  arrives             yes         no          no          yes
//!  flight wakes        sample            overdue     overdue sample      (table; by the link, at each slot)
//!  SysTick for   0           1           2           3
//! ```
//! `flight` comes before `tick`, so that a slot's frame, field and battery, which the slow tasks bring in the middle
//! of the slot before, are there for its step and for no other.
//!
//! # What a step costs
//! From the entry of the interrupt that brings a sample to the last compare value of the motors, instructions are
//! counted: TIM4 counts 250 MHz here, and with `-icount shift=2` an instruction takes 4 ns. In that are the
//! flight task's entry, its locks, the decoding of the frame, the flight controller with arming and failsafe, and
//! the pulses' conversion. Not in it is what only the flight board does: starting the burst, looking at its end,
//! and waiting for room in the timers' period if there is none.

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use cortex_m::peripheral::SCB;
use cortex_m_semihosting::debug::{self, EXIT_FAILURE};
use drivers::icm42688p::FRAME_LEN;
use flight_core::arming::MotorPermit;
use flight_core::esc::protocol::{Protocol, STOP_US};
use flight_core::sample::ImuSample;
use stm32f4xx_hal::pac::{self, Interrupt, TIM2, TIM3, TIM4, TIM5, interrupt};

use super::{Board, PERIOD_US, listen};
use crate::sampling::{self, Burst, BurstBus, FrameBuffer};
use crate::stm32f405::esc::Lines;

#[cfg(feature = "hil-qemu")]
#[path = "link.rs"]
mod source;
#[cfg(not(feature = "hil-qemu"))]
#[path = "table.rs"]
mod source;

pub use source::{Compass, Monitor, Radio, Supply, Watchdog, config};

/// The board's name.
pub const NAME: &str = "QEMU netduinoplus2";

/// TIM4's prescaler is 3 then, which makes it count instructions.
const LINES: Lines = Lines::new(Protocol::Pwm { rate_hz: 400.0 });

/// Time from one tick to the next, µs.
const TICK_US: u32 = PERIOD_US / 2;
/// Starts the ticks.
pub fn init(mut core: cortex_m::Peripherals, device: pac::Peripherals) -> Board {
    LINES.start();
    // TIM3 is the one that is asked for room in the period. Here its count does not end with the period: it goes
    // slowly, and begins anew with each slot, so that there is always room.
    device.TIM3.psc().write(|w| w.psc().set(u16::MAX));
    // 1 GHz down to microseconds. Setting the period starts the alarm; before that, the count must be small.
    device.TIM5.psc().write(|w| w.psc().set(999));
    device.TIM5.cr1().write(|w| w.cen().set_bit());
    device.TIM2.psc().write(|w| w.psc().set(999));
    device.TIM2.egr().write(|w| w.ug().set_bit());
    device.TIM2.arr().write(|w| w.arr().set(TICK_US - 1));
    device.TIM2.dier().write(|w| w.uie().set_bit());
    device.TIM2.cr1().write(|w| w.cen().set_bit());
    listen(&mut core.NVIC, Interrupt::TIM2);
    // The first tick is the first slot's start. A few microseconds less, so that it is never ahead of the count.
    BEGAN_US.store(now_us().wrapping_add(TICK_US - 5), Ordering::Relaxed);
    let watchdog_reset = source::begin();

    Board {
        sampler: Sampler::new(Frames),
        outputs: Outputs(()),
        monitor: Monitor::default(),
        ear: Ear,
        radio: Radio::default(),
        supply: Supply::default(),
        compass: Compass::default(),
        watchdog: Watchdog,
        reset_by: if watchdog_reset { "watchdog" } else { "power" },
        watchdog_reset,
    }
}

/// Half a period has passed.
#[interrupt]
fn TIM2() {
    let came = instructions();
    // SAFETY: nobody owns TIM2 after `init`.
    unsafe { &*TIM2::ptr() }.sr().write(|w| w.uif().clear_bit());
    source::tick(came);
}

/// TIM5's count when the first slot began.
static BEGAN_US: AtomicU32 = AtomicU32::new(0);

/// Free-running microseconds; zero is the first slot's start.
pub fn now_us() -> u32 {
    // SAFETY: nobody owns TIM5 after `init`, and its counter is only read.
    let count = unsafe { &*TIM5::ptr() }.cnt().read().cnt().bits();
    count.wrapping_sub(BEGAN_US.load(Ordering::Relaxed))
}

/// The count of instructions.
fn instructions() -> u32 {
    // SAFETY: the counter is only read.
    unsafe { &*TIM4::ptr() }.cnt().read().bits()
}

/// When the sample came, in instructions.
static CAME: AtomicU32 = AtomicU32::new(0);
/// When the motors' last compare value was written.
static WRITTEN: AtomicU32 = AtomicU32::new(0);

/// The frame of the slot that comes next.
static FRAME: FrameBuffer = FrameBuffer::new();

/// Prepares a slot: its frame as the sensor would send it, and the tick that brings the rest.
fn play(sample: ImuSample) {
    let axes = sample.accel.into_iter().chain(sample.gyro).flat_map(i16::to_be_bytes);
    // The byte that comes with the address, the axes, two bytes of time, and the flag of a new sample.
    let mut frame = [0; FRAME_LEN];
    for (place, byte) in frame.iter_mut().zip([0].into_iter().chain(axes).chain([0, 0, 0x08])) {
        *place = byte;
    }
    FRAME.write(&frame);
    // SAFETY: the flight task, which also writes to TIM3, does not run now.
    unsafe { &*TIM3::ptr() }.egr().write(|w| w.ug().set_bit());
    SCB::set_pendst();
}

/// The slots' frames.
pub struct Frames;

impl BurstBus for Frames {
    #[inline]
    fn look(&mut self) -> Burst {
        Burst::Done(FRAME.read())
    }

    fn abort(&mut self) {}
}

/// The slots' samples.
pub type Sampler = sampling::Sampler<Frames>;

/// No bytes come.
pub struct Ear;

impl Ear {
    /// Is never called.
    pub fn hear(&mut self) {}
}

// The pulses last sent, µs as the bits of an f32, and whether with a permit: for the record.
static SENT: [AtomicU32; 4] = [const { AtomicU32::new(STOP_US.to_bits()) }; 4];
static DRIVEN: AtomicBool = AtomicBool::new(false);

#[inline]
fn send(driven: bool, pulses_us: [f32; 4]) {
    let [front_left, front_right, rear_right, rear_left] = pulses_us;
    LINES.send([rear_right, front_right, rear_left, front_left]);
    WRITTEN.store(instructions(), Ordering::Relaxed);
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
        stop_outputs();
    }
}

/// [`Outputs::stop`], from a fault.
pub fn stop_outputs() {
    send(false, [STOP_US; 4]);
}

/// Exits with status 1.
pub fn halt() -> ! {
    loop {
        debug::exit(EXIT_FAILURE);
    }
}

/// What a step with a sample took, from its interrupt to the motors' last compare value, in instructions.
fn sample_to_motors() -> u32 {
    WRITTEN.load(Ordering::Relaxed).wrapping_sub(CAME.load(Ordering::Relaxed))
}

/// What went out to the motors last, µs, and whether with a permit.
fn sent() -> ([f32; 4], bool) {
    (SENT.each_ref().map(|us| f32::from_bits(us.load(Ordering::Relaxed))), DRIVEN.load(Ordering::Relaxed))
}
