//! Four ESC outputs: the motor pads M1 to M4, by the timers and DMA streams that the board's file gives them.
//!
//! | protocol | timers | what a step does | without steps |
//! |---|---|---|---|
//! | PWM | run for ever | writes four compare values, taken at the next period | the last pulse goes on |
//! | OneShot125 | stand still | writes four compare values, starts one pulse | no pulses |
//! | DShot300, DShot600 | one period a bit | writes the frames' tables, which DMA plays | no frames, lines low |
//!
//! # All four at once
//! All timers count 84 MHz: those of APB2, TIM1 and TIM8, divide their 168 MHz by two. They have the same prescaler and
//! period. With PWM they are started one right after the other and never stopped, so that their periods begin within a
//! microsecond of each other for ever. Compare values are preloaded: a timer takes them when a period begins. What remains
//! is that a period begins between two of the four writes, and so nothing is written in the last [`GUARD_US`] of a period;
//! the writes, their arithmetic and what may interrupt them take half of that. So one step's four pulses always go out in
//! the same period. The last timer is the one that is looked at: once it has begun a period, so have the others.
//!
//! With the others the timers stand while they are written to, and are started afterwards.
//!
//! # DShot by DMA
//! At the end of each bit a timer asks for DMA, which writes the next compare values through the timer's DMAR register: of
//! two channels side by side, or of all four. The values are preloaded, so that those of the first request, one bit time
//! after the start, are on the line from two bit times after the start on:
//! ```text
//!  bit times        0         1         2         3   ...   17        18        19
//!  on the line      low       low       bit 15    bit 14    bit 0     low       low
//!  DMA writes                 bit 15    bit 14    bit 13    zero      zero; ends
//! ```
//! A frame ends 18 bit times after its start: 60 µs with DShot300, 30 µs with DShot600. The last two of the 18 values
//! are zero, and the line stays low.
//!
//! # What is not sent
//! A step may come within microseconds of the one before, when a sample that was overdue comes after all. It finds the
//! last pulse or frame on its way, and sends nothing: what is on its way is new enough. [`Sent::Dropped`] says so. Three
//! steps in a row take 985 µs at least. So a pulse or frame that is on its way in two steps in a row hangs, and a frame
//! of which DMA has not played the end was cut. Timers and DMA are then set up anew, and [`Sent::Recovered`] says so.
//!
//! What a fault does to the outputs is in `esc/end.rs`.

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering, fence};

use flight_core::esc::protocol::{
    DSHOT_SLOTS, DshotThrottle, Protocol, STOP_US, dshot_duty_pairs, oneshot125_counts, pwm_counts,
};
use stm32f4xx_hal::pac::tim1;

use super::dma::Stream;
#[cfg(feature = "flight-board")]
use super::pin::Pin;

#[cfg(feature = "flight-board")]
mod end;

/// Clock of all timers, counts a microsecond and a second: twice APB1's.
const CLOCK_MHZ: f32 = 84.0;
const CLOCK_HZ: f32 = 84.0e6;

/// PWM: nothing is written so shortly before a period begins, µs.
const GUARD_US: f32 = 3.0;
/// Looks at the counter that last longer than that: each takes more than 5 cycles.
const GUARD_LOOKS: u32 = 120;

/// OneShot125: from the start of the timers to full speed's pulse, counts. It must not be zero, or that pulse
/// would begin before the timer does.
const ONESHOT_LEAD: u16 = 84;
const ONESHOT_PERIOD: u16 = 250 * 84 + ONESHOT_LEAD;

/// DShot300: counts of a bit, 3⅓ µs.
const DSHOT300_BIT: u16 = 280;
/// DShot600: counts of a bit, 1⅔ µs.
const DSHOT600_BIT: u16 = 140;

/// What has become of pulses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[must_use = "a pulse that is not sent must be counted"]
pub enum Sent {
    /// They go out.
    Whole,
    /// They do not: the last ones are on their way.
    Dropped,
    /// They go out; the last ones hung, or were cut.
    Recovered,
}

/// A timer with motor pads.
#[derive(Clone, Copy)]
pub struct Timer {
    /// Its registers. TIM1's are those of all: what the others lack is used with TIM1 and TIM8 only (RM0090, 17.4 and
    /// 18.4).
    pub registers: *const tim1::RegisterBlock,
    /// It is TIM1 or TIM8: twice the clock, and outputs that must be let out.
    pub advanced: bool,
    /// DMA that plays frames.
    pub stream: Stream,
    /// First channel that DMA writes to, counted from 0.
    pub first: u8,
    /// How many pairs of channels DMA writes to, from there on: 1 or 2.
    pub pairs: u8,
}

// SAFETY: an address of registers, and numbers.
unsafe impl Sync for Timer {}

/// A motor pad.
#[derive(Clone, Copy)]
pub struct Pad {
    /// Its pin.
    #[cfg(feature = "flight-board")]
    pub pin: Pin,
    /// The pin's alternate function, by which it is the timer's.
    #[cfg(feature = "flight-board")]
    pub function: u8,
    /// Its timer's registers, as one of [`Outputs::timers`] has them.
    pub timer: *const tim1::RegisterBlock,
    /// Channel, counted from 0.
    pub channel: u8,
    /// It is the channel's complementary output.
    pub complementary: bool,
}

// SAFETY: an address of registers, and numbers.
unsafe impl Sync for Pad {}

impl Pad {
    #[inline(always)]
    fn registers(&self) -> Registers {
        // SAFETY: as a timer's.
        unsafe { &*self.timer }
    }
}

/// The pads of a board, and what drives them.
#[derive(Clone, Copy)]
pub struct Outputs {
    /// The timers, in the order in which they are started.
    pub timers: &'static [Timer],
    /// M1 to M4.
    pub pads: &'static [Pad; 4],
    /// Lets the clocks of timers and DMA run.
    pub enable: unsafe fn(),
    /// Resets the timers.
    pub reset: unsafe fn(),
}

/// The outputs, speaking one protocol. A constant of the board: a fault must find it without anybody's help.
#[derive(Clone, Copy)]
pub struct Lines {
    outputs: Outputs,
    protocol: Protocol,
    prescaler: u16,
    /// Counts.
    period: u16,
    /// Counts of servo pulses a microsecond.
    per_us: f32,
}

/// The last step's pulses were dropped.
static DROPPED: AtomicBool = AtomicBool::new(false);

impl Lines {
    /// Outputs that speak `protocol`.
    pub const fn new(outputs: Outputs, protocol: Protocol) -> Self {
        assert!(outputs.timers.len() <= TABLES.len());
        let (prescaler, period) = match protocol {
            Protocol::Pwm { rate_hz } => {
                assert!(rate_hz >= 50.0 && rate_hz <= 400.0);
                let counts = (CLOCK_HZ / rate_hz) as u32;
                let prescaler = counts >> 16;
                (prescaler as u16, (counts / (prescaler + 1)) as u16)
            }
            Protocol::OneShot125 => (0, ONESHOT_PERIOD),
            Protocol::DShot300 => (0, DSHOT300_BIT),
            Protocol::DShot600 => (0, DSHOT600_BIT),
        };
        Self { outputs, protocol, prescaler, period, per_us: CLOCK_MHZ / (prescaler as f32 + 1.0) }
    }

    /// Sets the timers up, and starts them with the stop pulse. They are as after a reset, their streams of DMA are off,
    /// and the clocks run; the pins may be connected afterwards.
    #[inline(never)]
    pub fn start(&self) {
        let one_pulse = self.protocol == Protocol::OneShot125;
        for timer in self.outputs.timers {
            let registers = timer.registers();
            // Only the end of a period asks for DMA, not the update that this module makes.
            registers.cr1().write(|w| w.arpe().enabled().opm().bit(one_pulse).urs().counter_only());
            registers.psc().write(|w| w.psc().set(timer.prescaler(self.prescaler)));
            registers.arr().write(|w| w.arr().set(self.period - 1));
        }
        for pad in self.outputs.pads {
            let registers = pad.registers();
            // Mode 1 is high up to the compare value, 2 from there on. OneShot125 takes the latter, so that the line is
            // low while the timer stands.
            let n = pad.channel % 2;
            if pad.channel < 2 {
                registers.ccmr1_output().modify(|_, w| {
                    if one_pulse {
                        w.ocm(n).pwm_mode2()
                    } else {
                        w.ocm(n).pwm_mode1()
                    };
                    w.ocpe(n).enabled()
                });
            } else {
                registers.ccmr2_output().modify(|_, w| {
                    if one_pulse {
                        w.ocm(n).pwm_mode2()
                    } else {
                        w.ocm(n).pwm_mode1()
                    };
                    w.ocpe(n).enabled()
                });
            }
        }
        // Compare values at which the lines stay low, before the outputs are switched on.
        self.load(if one_pulse { [self.period; 4] } else { [0; 4] });
        self.each(take_preloaded);
        for pad in self.outputs.pads {
            // A complementary output alone is the same as the other one: it is not turned (RM0090, table 95).
            pad.registers().ccer().modify(|_, w| {
                if pad.complementary { w.ccne(pad.channel).set_bit() } else { w.cce(pad.channel).set_bit() }
            });
        }
        for timer in self.outputs.timers {
            if timer.advanced {
                timer.registers().bdtr().write(|w| w.moe().enabled());
            }
        }
        match self.protocol {
            Protocol::Pwm { .. } => {
                // They run before a pad is high: a pulse that begins while its timer stands is too long.
                self.each(run);
                self.load_servo([STOP_US; 4]);
                self.each(take_preloaded);
            }
            Protocol::OneShot125 => {}
            Protocol::DShot300 | Protocol::DShot600 => {
                for (timer, table) in self.outputs.timers.iter().zip(&TABLES) {
                    timer.set_up_dma(table);
                }
            }
        }
    }

    #[inline(always)]
    fn each(&self, act: impl Fn(Registers)) {
        self.outputs.timers.iter().for_each(|timer| act(timer.registers()));
    }

    /// Writes the compare values of the four pads.
    #[inline(always)]
    fn load(&self, counts: [u16; 4]) {
        for (pad, counts) in self.outputs.pads.iter().zip(counts) {
            pad.registers().ccr(pad.channel as usize).write(|w| w.ccr().set(counts));
        }
    }

    #[inline]
    fn load_servo(&self, pulses_us: [f32; 4]) {
        self.load(pulses_us.map(|us| pwm_counts(us, self.per_us)));
    }

    /// Sends pulses of M1 to M4 (µs on the servo scale).
    #[inline]
    pub fn send(&self, pulses_us: [f32; 4]) -> Sent {
        let sent = self.make_way();
        if sent == Sent::Dropped {
            return sent;
        }
        match self.protocol {
            Protocol::Pwm { .. } => {
                let guard = self.period - (GUARD_US * self.per_us) as u16;
                if let Some(last) = self.outputs.timers.last() {
                    for _ in 0..GUARD_LOOKS {
                        if last.registers().cnt().read().cnt().bits() < guard {
                            break;
                        }
                    }
                }
                self.load_servo(pulses_us);
            }
            Protocol::OneShot125 => {
                let counts = pulses_us.map(|us| oneshot125_counts(us, CLOCK_MHZ));
                self.load(counts.map(|counts| self.period.saturating_sub(counts)));
                self.each(take_preloaded);
                self.each(run);
            }
            Protocol::DShot300 | Protocol::DShot600 => {
                let frames = pulses_us.map(|us| DshotThrottle::from_pulse(us).frame(false));
                for (timer, table) in self.outputs.timers.iter().zip(&TABLES) {
                    // A channel without a pad plays a frame that nobody sees.
                    let frame = |channel: u8| {
                        let pads = self.outputs.pads.iter().zip(frames);
                        pads.fold(0, |found, (pad, frame)| {
                            if pad.timer == timer.registers && pad.channel == channel { frame } else { found }
                        })
                    };
                    for pair in 0..timer.pairs {
                        let channel = timer.first + 2 * pair;
                        let duties = dshot_duty_pairs([frame(channel), frame(channel + 1)], self.period);
                        table.write(pair as usize, timer.pairs as usize, duties);
                    }
                }
                fence(Ordering::Release);
                self.each(rewind);
                self.load([0; 4]);
                self.each(take_preloaded);
                self.outputs.timers.iter().for_each(Timer::play);
                self.each(|registers| {
                    registers.dier().write(|w| w.ude().enabled());
                    run(registers);
                });
            }
        }
        sent
    }

    /// Whether the next pulses can be sent.
    #[inline]
    fn make_way(&self) -> Sent {
        if let Protocol::Pwm { .. } = self.protocol {
            return Sent::Whole;
        }
        let hangs = if self.busy() {
            if !DROPPED.load(Ordering::Relaxed) {
                DROPPED.store(true, Ordering::Relaxed);
                return Sent::Dropped;
            }
            true
        } else {
            self.was_cut()
        };
        DROPPED.store(false, Ordering::Relaxed);
        if hangs {
            self.reset();
            self.start();
            return Sent::Recovered;
        }
        Sent::Whole
    }

    /// Whether a pulse or a frame is on its way. PWM's always is, and takes the next one while it is.
    #[inline]
    fn busy(&self) -> bool {
        match self.protocol {
            Protocol::Pwm { .. } => false,
            Protocol::OneShot125 => self.outputs.timers.iter().any(|timer| running(timer.registers())),
            Protocol::DShot300 | Protocol::DShot600 => {
                self.outputs.timers.iter().any(|timer| timer.stream.runs())
            }
        }
    }

    /// Whether the last frame ended before all of it was played: DMA found an error, and the timer goes on with the
    /// last bit.
    #[inline]
    fn was_cut(&self) -> bool {
        match self.protocol {
            Protocol::Pwm { .. } | Protocol::OneShot125 => false,
            Protocol::DShot300 | Protocol::DShot600 => self
                .outputs
                .timers
                .iter()
                .any(|timer| timer.stream.registers().ndtr().read().ndt().bits() > 0),
        }
    }

    /// Resets the timers, ends their DMA, and lets the clocks run. The pads fall: a timer in reset does not drive them,
    /// and they are pulled down. The streams are ended one by one: the inertial sensor may have others of the same
    /// controller.
    #[cold]
    #[inline(never)]
    fn reset(&self) {
        // SAFETY: only this module uses the timers, and nothing of it is under way: this is the control loop, or a fault
        // that does not return to it.
        unsafe {
            (self.outputs.enable)();
            (self.outputs.reset)();
        }
        self.outputs.timers.iter().for_each(|timer| timer.stream.stop());
    }
}

type Registers = &'static tim1::RegisterBlock;

/// The timer takes its preloaded prescaler, period and compare values, and begins a period.
#[inline(always)]
fn take_preloaded(registers: Registers) {
    registers.egr().write(|w| w.ug().update());
}

#[inline(always)]
fn run(registers: Registers) {
    registers.cr1().modify(|_, w| w.cen().enabled());
}

#[inline(always)]
fn running(registers: Registers) -> bool {
    registers.cr1().read().cen().is_enabled()
}

/// Stops the timer, with no request for DMA left.
#[inline(always)]
fn rewind(registers: Registers) {
    registers.cr1().modify(|_, w| w.cen().disabled());
    registers.dier().write(|w| w.ude().disabled());
}

/// Offset of CCR1 among a timer's registers, counted in registers, as DCR counts.
const FIRST_COMPARE: u8 = 0x34 / 4;

impl Timer {
    #[inline(always)]
    fn registers(&self) -> Registers {
        // SAFETY: after `init` nobody owns the timer, and only this module writes to it: the control loop, or a fault
        // that does not return to it.
        unsafe { &*self.registers }
    }

    /// What makes it count 84 MHz over `prescaler` and one.
    fn prescaler(&self, prescaler: u16) -> u16 {
        if self.advanced { 2 * prescaler + 1 } else { prescaler }
    }

    /// What is the same in all frames. The stream is off.
    fn set_up_dma(&self, table: &'static Table) {
        let registers = self.registers();
        // SAFETY: so many registers less one, which begin with a compare value, and end with CCR4 at the latest.
        registers
            .dcr()
            .write(|w| unsafe { w.dbl().bits(2 * self.pairs - 1).dba().bits(FIRST_COMPARE + self.first) });
        let stream = self.stream.registers();
        // SAFETY: a register of the timer, which takes 16 bits.
        stream.par().write(|w| unsafe { w.pa().bits(registers.dmar().as_ptr() as u32) });
        // SAFETY: a static that has twice as many halfwords for each pair, and that nothing but this module writes to.
        stream.m0ar().write(|w| unsafe { w.m0a().bits(table.0.as_ptr() as u32) });
        stream.cr().write(|w| {
            w.chsel().set(self.stream.channel()).pl().high();
            w.dir().memory_to_peripheral().minc().incremented().msize().bits16().psize().bits16()
        });
    }

    /// Plays its table with the next bits.
    #[inline(always)]
    fn play(&self) {
        self.stream.clear_all();
        let stream = self.stream.registers();
        stream.ndtr().write(|w| w.ndt().set(2 * u16::from(self.pairs) * DSHOT_SLOTS as u16));
        stream.cr().modify(|_, w| w.en().enabled());
    }
}

/// Compare values of a timer's channels, in turn, which DMA plays: for each bit one or two pairs. In RAM that DMA
/// reaches: the linker puts no variable into the core-coupled memory (memory.x).
struct Table([AtomicU32; 2 * DSHOT_SLOTS]);

/// One for each timer: four pads have four at most.
static TABLES: [Table; 4] = [const { Table([const { AtomicU32::new(0) }; 2 * DSHOT_SLOTS]) }; 4];

impl Table {
    /// Writes the compare values of a pair, of so many.
    #[inline(always)]
    fn write(&self, pair: usize, pairs: usize, duties: [u32; DSHOT_SLOTS]) {
        for (slot, value) in self.0.iter().skip(pair).step_by(pairs).zip(duties) {
            slot.store(value, Ordering::Relaxed);
        }
    }
}
