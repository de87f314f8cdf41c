//! QEMU's `netduinoplus2`: an STM32F405 without a sensor, a motor, or most of its peripherals.
//!
//! The same tasks run here as on a flight board. Their input is the table of `fixed-input`, the motors' pulses
//! and the attitude go, word by word, to a file on the host, and after the table's last step the emulator
//! exits with status 0. A panic or a fault exits with status 1.
//!
//! What the emulator lacks decides the rest (measured with 7.2): RCC reads as zero, so that the clock setup of
//! a flight board would wait for ever; SPI is a stub; of the timers, 2 to 5 count (at 1 GHz, whatever the clock
//! tree says) and interrupt at the end of their period, but have no compare interrupt, and restarting one puts
//! its next interrupt at a wrong time. So one timer ticks twice a millisecond, and plays both the sensor and the deadline:
//!
//! ```text
//!  tick          0     1     2     3     4     5     6
//!  sample due    0           1           2           3
//!  arrives       yes         no          no          yes
//!  flight wakes  sample            overdue     overdue sample
//! ```

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use cortex_m::peripheral::NVIC;
use cortex_m_semihosting::debug::{self, EXIT_FAILURE, EXIT_SUCCESS};
use cortex_m_semihosting::{nr, syscall};
use fixed_input::{STEPS, WORDS_FILE, WORDS_PER_STEP};
use flight_core::arming::MotorPermit;
use flight_core::esc::EscParams;
use flight_core::{Config, Input};
use stm32f4xx_hal::pac::{self, Interrupt, TIM2, TIM5, interrupt};

use super::{Board, OVERDUE_US, PERIOD_US, Step, WAKE_FLIGHT, listen};

/// The board's name.
pub const NAME: &str = "QEMU netduinoplus2";

/// The stop pulse, µs.
const STOP_US: f32 = EscParams::STANDARD.stop_us;

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

/// Starts the ticks.
pub fn init(mut core: cortex_m::Peripherals, device: pac::Peripherals) -> Board {
    // 1 GHz down to microseconds. Setting the period starts the alarm; before that, the count must be small.
    device.TIM5.psc().write(|w| w.psc().set(999));
    device.TIM5.cr1().write(|w| w.cen().set_bit());
    device.TIM2.psc().write(|w| w.psc().set(999));
    device.TIM2.egr().write(|w| w.ug().set_bit());
    device.TIM2.arr().write(|w| w.arr().set(TICK_US));
    device.TIM2.dier().write(|w| w.uie().set_bit());
    device.TIM2.cr1().write(|w| w.cen().set_bit());
    listen(&mut core.NVIC, Interrupt::TIM2);

    Board {
        sensors: Sensors { slot: 0 },
        outputs: Outputs(()),
        monitor: Monitor { file: WordFile::create(), steps: 0 },
    }
}

/// Free-running microseconds.
pub fn now_us() -> u32 {
    // SAFETY: nobody owns TIM5 after `init`, and its counter is only read.
    unsafe { &*TIM5::ptr() }.cnt().read().cnt().bits()
}

// What woke the flight task: written by the handler below, taken by `Sensors::take`.
static SAMPLE_READY: AtomicBool = AtomicBool::new(false);
static SAMPLE_OVERDUE: AtomicBool = AtomicBool::new(false);

// The handler's own.
static TICK: AtomicU32 = AtomicU32::new(0);
static SAMPLE_TICK: AtomicU32 = AtomicU32::new(0);

/// Half a period has passed.
#[interrupt]
fn TIM2() {
    // SAFETY: nobody owns TIM2 after `init`.
    unsafe { &*TIM2::ptr() }.sr().write(|w| w.uif().clear_bit());
    let tick = TICK.fetch_add(1, Ordering::Relaxed);
    assert!(tick < LAST_TICK, "the flight task fell behind the table");
    let due = tick.is_multiple_of(TICKS_PER_PERIOD);
    if due && fixed_input::sample_arrives(tick / TICKS_PER_PERIOD) {
        SAMPLE_TICK.store(tick, Ordering::Relaxed);
        SAMPLE_READY.store(true, Ordering::Release);
        NVIC::pend(WAKE_FLIGHT);
        return;
    }
    let late = tick - SAMPLE_TICK.load(Ordering::Relaxed);
    if late >= TICKS_TO_OVERDUE && (late - TICKS_TO_OVERDUE).is_multiple_of(TICKS_PER_PERIOD) {
        SAMPLE_OVERDUE.store(true, Ordering::Release);
        NVIC::pend(WAKE_FLIGHT);
    }
}

/// The table of inputs.
pub struct Sensors {
    slot: u32,
}

impl Sensors {
    /// The next step's input, or `None` if there is nothing to do.
    pub fn take(&mut self) -> Option<Input> {
        let ready = SAMPLE_READY.swap(false, Ordering::Acquire);
        let overdue = SAMPLE_OVERDUE.swap(false, Ordering::Acquire);
        if !ready && !overdue {
            return None;
        }
        let input = fixed_input::input(self.slot);
        // The table says which slots have a sample; the ticks must have come to the same.
        assert_eq!(input.imu.is_some(), ready, "slot {}", self.slot);
        self.slot += 1;
        Some(input)
    }
}

// The pulses last sent, µs as the bits of an f32, and whether with a permit: for the record.
static SENT: [AtomicU32; 4] = [const { AtomicU32::new(STOP_US.to_bits()) }; 4];
static DRIVEN: AtomicBool = AtomicBool::new(false);

fn send(driven: bool, pulses_us: [f32; 4]) {
    DRIVEN.store(driven, Ordering::Relaxed);
    for (sent, us) in SENT.iter().zip(pulses_us) {
        sent.store(us.to_bits(), Ordering::Relaxed);
    }
}

/// The motors' pulses, which go to the record.
pub struct Outputs(());

impl Outputs {
    /// Sends pulses of rotors 1 to 4.
    pub fn drive(&mut self, permit: MotorPermit, pulses_us: [f32; 4]) {
        send(true, permit.apply(pulses_us, STOP_US));
    }

    /// Sends the stop pulse to all four.
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

/// The record.
pub struct Monitor {
    file: WordFile,
    steps: u32,
}

impl Monitor {
    /// Writes a step's words; after the table's last step, exits with status 0.
    pub fn show(&mut self, step: &Step) {
        let sent = SENT.each_ref().map(|us| f32::from_bits(us.load(Ordering::Relaxed)));
        let driven = DRIVEN.load(Ordering::Relaxed);
        self.file.write(&fixed_input::words(step.time_us, driven, sent, step.attitude));
        self.steps += 1;
        if self.steps == STEPS {
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
