//! Five seconds of fixed input, and a record of the outputs, word by word, in a file on the host. After the table's
//! last step QEMU exits with status 0. Before that, a line `icount,sample to motors,...` gives the cost of the
//! steps.
//!
//! One timer ticks twice a millisecond, and simulates the IMU, the sample's deadline and SysTick:
//! ```text
//!  tick                 -1    0     1     2     3     4     5     6
//!  slot                       0           1           2           3
//!  sample arrives             yes         no          no          yes
//!  control_loop wakes         sample            overdue     overdue sample
//!  SysTick for slot     0           1           2           3
//! ```
//! Inputs that the slow tasks store in the middle of a slot are used by the next slot's step.

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use cortex_m::peripheral::NVIC;
use cortex_m_semihosting::debug::{self, EXIT_SUCCESS};
use cortex_m_semihosting::{hprintln, nr, syscall};
use fixed_input::{STEPS, WORDS_FILE, WORDS_PER_STEP};
use flight_core::Config;
use flight_core::sample::{Battery, MagSample, RcFrame};
use stm32f4xx_hal::pac::{Interrupt, TIM2, interrupt, tim2};
use tasks::deadlines::{BATTERY_TICKS, MAGNETOMETER_TICKS};
use tasks::sampling::{self, Action};
use tasks::{OVERDUE_US, PERIOD_US};

use super::chip::instructions;
use super::{ARRIVED, last_outputs, prepare_frame, sample_to_motors, set_now, wake_control_loop};
use crate::interrupts::{SAMPLING_PRIORITY, WAKE_CONTROL_LOOP, enable};
use crate::step::Step;

/// Time from one tick to the next, µs.
const TICK_US: u32 = PERIOD_US / 2;
/// Ticks in a sample period, and ticks from a sample to the deadline of the next.
const TICKS_PER_PERIOD: u32 = PERIOD_US / TICK_US;
const TICKS_TO_OVERDUE: u32 = OVERDUE_US / TICK_US;
/// Tick at which the table must be finished.
const LAST_TICK: u32 = (STEPS + 1) * TICKS_PER_PERIOD;

/// Returns the configuration: the host runs the same table with the same one.
pub fn config() -> Config {
    fixed_input::config()
}

/// Starts the ticks, and prepares the first slot.
pub fn begin(nvic: &mut NVIC) -> bool {
    // The prescaler divides 1 GHz to microseconds. Writing the period starts the alarm; until then the count must be
    // small. QEMU's first period is too long by the time from power-up to this write, in whole microseconds. The timer
    // without a prescaler has counted that time in nanoseconds. It is subtracted here, early in a microsecond, so that
    // no further microsecond ends before the write.
    let since_power_up_ns = loop {
        let ns = tim2().cnt().read().cnt().bits();
        if ns % 1_000 < 500 {
            break ns;
        }
    };
    tim2().psc().write(|w| w.psc().set(999));
    tim2().egr().write(|w| w.ug().set_bit());
    tim2().arr().write(|w| w.arr().set(TICK_US - since_power_up_ns / 1_000));
    tim2().dier().write(|w| w.uie().set_bit());
    tim2().cr1().write(|w| w.cen().set_bit());
    enable(nvic, Interrupt::TIM2, SAMPLING_PRIORITY);
    // The first tick is the first slot's start. The clock starts five microseconds late, so that it is never ahead of
    // the ticks.
    set_now(0_u32.wrapping_sub(TICK_US - 5));
    prepare(0);
    false
}

fn tim2() -> &'static tim2::RegisterBlock {
    // SAFETY: no other code uses TIM2.
    unsafe { &*TIM2::ptr() }
}

/// Whether the next slot's sample arrives.
static ARRIVES: AtomicBool = AtomicBool::new(false);

fn prepare(slot: u32) {
    ARRIVES.store(fixed_input::sample_arrives(slot), Ordering::Relaxed);
    prepare_frame(fixed_input::imu(slot));
}

// Used by the interrupt handler only.
static TICK: AtomicU32 = AtomicU32::new(0);
static SAMPLE_TICK: AtomicU32 = AtomicU32::new(0);

/// Handles a tick: half a period has passed.
#[interrupt]
fn TIM2() {
    let arrived = instructions();
    tim2().sr().write(|w| w.uif().clear_bit());
    let tick = TICK.fetch_add(1, Ordering::Relaxed);
    assert!(tick < LAST_TICK, "the control loop fell behind the table");
    let at_us = tick * TICK_US;
    if tick.is_multiple_of(TICKS_PER_PERIOD) {
        if ARRIVES.load(Ordering::Relaxed) {
            ARRIVED.store(arrived, Ordering::Relaxed);
            SAMPLE_TICK.store(tick, Ordering::Relaxed);
            assert!(
                sampling::ready(at_us, false) == Action::StartBurst,
                "the previous sample has not been read"
            );
            NVIC::pend(WAKE_CONTROL_LOOP);
        }
        return;
    }
    prepare(tick / TICKS_PER_PERIOD + 1);
    let late = tick - SAMPLE_TICK.load(Ordering::Relaxed);
    if late >= TICKS_TO_OVERDUE && (late - TICKS_TO_OVERDUE).is_multiple_of(TICKS_PER_PERIOD) {
        wake_control_loop(sampling::overdue(at_us));
    }
}

/// The pilot's frames from the table.
#[derive(Default)]
pub struct RcReceiver {
    slot: u32,
    given: bool,
}

impl RcReceiver {
    /// Returns the slot's frame, if it has one, and then `None` once, which ends the slot.
    pub fn poll(&mut self) -> Option<RcFrame> {
        if !self.given {
            self.given = true;
            let frame = fixed_input::input(self.slot).rc;
            if frame.is_some() {
                return frame;
            }
        }
        self.given = false;
        self.slot += 1;
        None
    }
}

/// The battery voltages from the table.
#[derive(Default)]
pub struct BatteryAdc {
    slot: u32,
}

impl BatteryAdc {
    /// Returns the slot's voltage, if it has one.
    pub fn measure(&mut self) -> Option<Battery> {
        let slot = self.slot;
        self.slot += BATTERY_TICKS;
        fixed_input::input(slot).battery
    }
}

/// The magnetometer samples from the table.
#[derive(Default)]
pub struct Magnetometer {
    slot: u32,
}

impl Magnetometer {
    /// Returns the slot's sample, if it has one.
    pub fn run(&mut self) -> Option<MagSample> {
        let slot = self.slot;
        self.slot += MAGNETOMETER_TICKS;
        fixed_input::input(slot).mag
    }
}

/// QEMU has no watchdog.
pub struct Watchdog;

impl Watchdog {
    /// Does nothing.
    pub fn feed(&mut self) {}
}

/// Instruction counts of the steps with a sample.
#[derive(Default)]
struct Counts {
    steps: u32,
    total: u32,
    max: u32,
}

/// The record of the outputs.
pub struct Monitor {
    file: WordFile,
    steps: u32,
    counts: Counts,
}

impl Default for Monitor {
    fn default() -> Self {
        Self { file: WordFile::create(), steps: 0, counts: Counts::default() }
    }
}

impl Monitor {
    /// Writes a step's words. After the table's last step, prints the cost of the steps and exits with status 0.
    pub fn show(&mut self, step: &Step) {
        let (sent, driven) = last_outputs();
        self.file.write(&fixed_input::words(step.time_us, driven, sent, step.attitude));
        self.steps += 1;
        let Counts { steps, total, max } = &mut self.counts;
        if step.sampled {
            let count = sample_to_motors();
            *steps += 1;
            *total += count;
            *max = count.max(*max);
        }
        if self.steps == STEPS {
            hprintln!("icount,sample to motors,{},{},{}", steps, total, max);
            debug::exit(EXIT_SUCCESS);
        }
    }
}

/// A file of words on the host, by semihosting.
struct WordFile {
    handle: usize,
}

impl WordFile {
    fn create() -> Self {
        // SAFETY: the name is terminated, and its length is given.
        let handle = unsafe {
            syscall!(OPEN, WORDS_FILE.as_ptr(), nr::open::W_TRUNC_BINARY, WORDS_FILE.count_bytes())
        };
        assert_ne!(handle, usize::MAX, "the host cannot create {WORDS_FILE:?}");
        Self { handle }
    }

    fn write(&mut self, words: &[u32; WORDS_PER_STEP]) {
        // SAFETY: the length is that of the words.
        let left = unsafe { syscall!(WRITE, self.handle, words.as_ptr(), size_of_val(words)) };
        assert_eq!(left, 0, "the host has not accepted all bytes");
    }
}
