//! Five seconds of fixed input, and a record of what came of it, word by word, in a file on the host. After the
//! table's last step the emulator exits with status 0; before that, a line `icount,sample to motors,...` says what
//! the steps cost.
//!
//! One timer ticks twice a millisecond, and plays the sensor, the deadline and SysTick:
//! ```text
//!  tick          -1    0     1     2     3     4     5     6
//!  slot                0           1           2           3
//!  arrives             yes         no          no          yes
//!  flight wakes        sample            overdue     overdue sample
//!  SysTick for   0           1           2           3
//! ```
//! What the slow tasks bring in the middle of a slot is there for the next one's step.

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use cortex_m::peripheral::NVIC;
use cortex_m_semihosting::debug::{self, EXIT_SUCCESS};
use cortex_m_semihosting::{hprintln, nr, syscall};
use fixed_input::{STEPS, WORDS_FILE, WORDS_PER_STEP};
use flight_core::Config;
use flight_core::sample::{Battery, MagSample, RcFrame};
use stm32f4xx_hal::pac::{Interrupt, TIM2, interrupt, tim2};
use tasks::deadlines::{BATTERY_TICKS, MAGNETOMETER_TICKS};
use tasks::sampling::{self, Next};
use tasks::{OVERDUE_US, PERIOD_US};

use super::chip::instructions;
use super::{CAME, play, sample_to_motors, sent, set_now, wake_flight};
use crate::interrupts::{SAMPLING_PRIORITY, WAKE_CONTROL_LOOP, enable};
use crate::step::Step;

/// Time from one tick to the next, µs.
const TICK_US: u32 = PERIOD_US / 2;
/// Ticks of a sample period, and from a sample to the deadline of the next.
const TICKS_PER_PERIOD: u32 = PERIOD_US / TICK_US;
const TICKS_TO_OVERDUE: u32 = OVERDUE_US / TICK_US;
/// By this one the table is done, or something is wrong.
const LAST_TICK: u32 = (STEPS + 1) * TICKS_PER_PERIOD;

/// The configuration that the host steps through the same table.
pub fn config() -> Config {
    fixed_input::config()
}

/// Starts the ticks, and prepares the first slot.
pub fn begin(nvic: &mut NVIC) -> bool {
    // 1 GHz down to microseconds. Setting the period starts the alarm; before that, the count must be small. The
    // emulator's period is what is set and, on top, the time from power-up to here in whole microseconds. The timer has
    // counted the nanoseconds of that time, as long as it has no prescaler: it is taken off, early in a microsecond, so
    // that none ends meanwhile.
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
    // The first tick is the first slot's start. A few microseconds less, so that it is never ahead of the count.
    set_now(0_u32.wrapping_sub(TICK_US - 5));
    prepare(0);
    false
}

fn tim2() -> &'static tim2::RegisterBlock {
    // SAFETY: nobody else uses TIM2.
    unsafe { &*TIM2::ptr() }
}

/// Whether the sample of the slot that comes next arrives.
static ARRIVES: AtomicBool = AtomicBool::new(false);

fn prepare(slot: u32) {
    ARRIVES.store(fixed_input::sample_arrives(slot), Ordering::Relaxed);
    play(fixed_input::imu(slot));
}

// The handler's own.
static TICK: AtomicU32 = AtomicU32::new(0);
static SAMPLE_TICK: AtomicU32 = AtomicU32::new(0);

/// Half a period has passed.
#[interrupt]
fn TIM2() {
    let came = instructions();
    tim2().sr().write(|w| w.uif().clear_bit());
    let tick = TICK.fetch_add(1, Ordering::Relaxed);
    assert!(tick < LAST_TICK, "the control loop fell behind the table");
    let at_us = tick * TICK_US;
    if tick.is_multiple_of(TICKS_PER_PERIOD) {
        if ARRIVES.load(Ordering::Relaxed) {
            CAME.store(came, Ordering::Relaxed);
            SAMPLE_TICK.store(tick, Ordering::Relaxed);
            assert!(sampling::ready(at_us, false) == Next::Burst, "the last sample has not been taken");
            NVIC::pend(WAKE_CONTROL_LOOP);
        }
        return;
    }
    prepare(tick / TICKS_PER_PERIOD + 1);
    let late = tick - SAMPLE_TICK.load(Ordering::Relaxed);
    if late >= TICKS_TO_OVERDUE && (late - TICKS_TO_OVERDUE).is_multiple_of(TICKS_PER_PERIOD) {
        wake_flight(sampling::overdue(at_us));
    }
}

/// The table's frames of the pilot.
#[derive(Default)]
pub struct RcReceiver {
    slot: u32,
    given: bool,
}

impl RcReceiver {
    /// The slot's frame, if it has one, and then nothing.
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

/// The table's battery.
#[derive(Default)]
pub struct BatteryAdc {
    slot: u32,
}

impl BatteryAdc {
    /// The slot's reading, if it has one.
    pub fn measure(&mut self) -> Option<Battery> {
        let slot = self.slot;
        self.slot += BATTERY_TICKS;
        fixed_input::input(slot).battery
    }
}

/// The table's magnetometer.
#[derive(Default)]
pub struct Magnetometer {
    slot: u32,
}

impl Magnetometer {
    /// The slot's sample, if it has one.
    pub fn run(&mut self) -> Option<MagSample> {
        let slot = self.slot;
        self.slot += MAGNETOMETER_TICKS;
        fixed_input::input(slot).mag
    }
}

/// Nothing restarts the emulator.
pub struct Watchdog;

impl Watchdog {
    /// Does nothing.
    pub fn feed(&mut self) {}
}

/// Instructions of the steps that had a sample.
#[derive(Default)]
struct Counts {
    steps: u32,
    total: u32,
    most: u32,
}

/// The record.
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
    /// Writes a step's words; after the table's last step, says what the steps cost, and exits with status 0.
    pub fn show(&mut self, step: &Step) {
        let (sent, driven) = sent();
        self.file.write(&fixed_input::words(step.time_us, driven, sent, step.attitude));
        self.steps += 1;
        let Counts { steps, total, most } = &mut self.counts;
        if step.sampled {
            let count = sample_to_motors();
            *steps += 1;
            *total += count;
            *most = count.max(*most);
        }
        if self.steps == STEPS {
            hprintln!("icount,sample to motors,{},{},{}", steps, total, most);
            debug::exit(EXIT_SUCCESS);
        }
    }
}

/// A file on the host, by semihosting.
struct WordFile {
    handle: usize,
}

impl WordFile {
    fn create() -> Self {
        // SAFETY: the name is terminated, and its length given.
        let handle = unsafe {
            syscall!(OPEN, WORDS_FILE.as_ptr(), nr::open::W_TRUNC_BINARY, WORDS_FILE.count_bytes())
        };
        assert_ne!(handle, usize::MAX, "the host does not let {WORDS_FILE:?} be written");
        Self { handle }
    }

    fn write(&mut self, words: &[u32; WORDS_PER_STEP]) {
        // SAFETY: the length is that of the words.
        let left = unsafe { syscall!(WRITE, self.handle, words.as_ptr(), size_of_val(words)) };
        assert_eq!(left, 0, "bytes that the host did not take");
    }
}
