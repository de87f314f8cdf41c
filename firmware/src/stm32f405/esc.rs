//! Four ESC outputs: the motor pads M1 to M4, by the timers and DMA streams that the board's file assigns.
//!
//! | protocol | timers | each step | without steps |
//! |---|---|---|---|
//! | PWM | run continuously | writes four compare values, used from the next period on | the last pulse is repeated |
//! | OneShot125 | stopped between pulses | writes four compare values, starts one pulse | no pulses |
//! | DShot300, DShot600 | one period for each bit | writes the frames' tables, which DMA sends | no frames, lines low |
//!
//! # Four outputs in the same period
//! All timers count 84 MHz: TIM1 and TIM8 on APB2 divide their 168 MHz by two. All have the same prescaler and period.
//! With PWM they are started directly one after the other and never stopped, so their periods always begin within a
//! microsecond of each other. Compare values are preloaded: a timer uses them from the start of the next period. A
//! period could still begin between two of the four writes, so no compare value is written in the last [`GUARD_US`] of
//! a period. The writes, their arithmetic and possible interrupts take half of that. Therefore one step's four pulses
//! always start in the same period. The last timer's counter is polled: once it has begun a period, so have the others.
//!
//! With the other protocols the timers are stopped while they are written, and started afterwards.
//!
//! # DShot by DMA
//! At the end of each bit a timer requests DMA, which writes the next compare values through the timer's DMAR register:
//! of two neighbouring channels, or of all four. The values are preloaded: those of the first request, one bit time
//! after the start, are on the line from two bit times after the start:
//! ```text
//!  bit times        0         1         2         3   ...   17        18        19
//!  on the line      low       low       bit 15    bit 14    bit 0     low       low
//!  DMA writes                 bit 15    bit 14    bit 13    zero      zero; ends
//! ```
//! A frame ends 18 bit times after its start: 60 µs with DShot300, 30 µs with DShot600. The last two of the 18 values
//! are zero, and the line stays low.
//!
//! # Dropped and recovered pulses
//! A step may follow the previous one within microseconds, when an overdue sample arrives after all. The last pulse or
//! frame is then still being sent. The step sends nothing, because that pulse or frame is new enough, and reports
//! [`SendResult::Dropped`]. Three consecutive steps take at least 985 µs. Therefore a pulse or frame that is still
//! being sent in two consecutive steps hangs. A frame that DMA has not sent completely was cut short. In both cases
//! timers and DMA are set up again, and the step reports [`SendResult::Recovered`].
//!
//! `esc/end.rs` describes the outputs after a fault.

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

/// Clock of all timers, counts per microsecond and per second: twice APB1's clock.
const CLOCK_MHZ: f32 = 84.0;
const CLOCK_HZ: f32 = 84.0e6;

/// PWM: time before the start of a period in which no compare value is written, µs.
const GUARD_US: f32 = 3.0;
/// Number of polls of the counter that take longer than that time, because each poll takes more than 5 cycles.
const GUARD_POLLS: u32 = 120;

/// OneShot125: counts from the start of the timers to the start of the full-throttle pulse. It must not be zero, or
/// that pulse would begin before the timer does.
const ONESHOT_LEAD: u16 = 84;
const ONESHOT_PERIOD: u16 = 250 * 84 + ONESHOT_LEAD;

/// DShot300: counts for each bit, 3⅓ µs.
const DSHOT300_BIT: u16 = 280;
/// DShot600: counts for each bit, 1⅔ µs.
const DSHOT600_BIT: u16 = 140;

/// Result of sending a step's pulses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[must_use = "a pulse that is not sent must be counted"]
pub enum SendResult {
    /// The pulses are being sent.
    Sent,
    /// The pulses were dropped, because the last ones are still being sent.
    Dropped,
    /// The outputs were restarted, because the last pulses hung or were cut short. The new pulses are being sent.
    Recovered,
}

/// A timer with motor pads.
#[derive(Clone, Copy)]
pub struct Timer {
    /// The timer's registers. TIM1's layout is used for all timers; the registers that the others lack are used with
    /// TIM1 and TIM8 only (RM0090, 17.4 and 18.4).
    pub registers: *const tim1::RegisterBlock,
    /// Whether it is TIM1 or TIM8: twice the clock, and a main output enable.
    pub advanced: bool,
    /// DMA stream that sends frames.
    pub stream: Stream,
    /// First channel that DMA writes to, counted from 0.
    pub first: u8,
    /// Number of channel pairs that DMA writes to, from there on: 1 or 2.
    pub pairs: u8,
}

// SAFETY: the type holds an address of registers, and numbers.
unsafe impl Sync for Timer {}

/// A motor pad.
#[derive(Clone, Copy)]
pub struct Pad {
    /// The pad's pin.
    #[cfg(feature = "flight-board")]
    pub pin: Pin,
    /// The pin's alternate function for the timer.
    #[cfg(feature = "flight-board")]
    pub function: u8,
    /// The registers of the pad's timer: one of [`Outputs::timers`].
    pub timer: *const tim1::RegisterBlock,
    /// The channel, counted from 0.
    pub channel: u8,
    /// Whether it is the channel's complementary output.
    pub complementary: bool,
}

// SAFETY: the type holds an address of registers, and numbers.
unsafe impl Sync for Pad {}

impl Pad {
    #[inline(always)]
    fn registers(&self) -> Registers {
        // SAFETY: see `Timer::registers`.
        unsafe { &*self.timer }
    }
}

/// A board's motor pads, with their timers.
#[derive(Clone, Copy)]
pub struct Outputs {
    /// The timers, in the order in which they are started.
    pub timers: &'static [Timer],
    /// The pads M1 to M4.
    pub pads: &'static [Pad; 4],
    /// Enables the clocks of timers and DMA.
    pub enable: unsafe fn(),
    /// Resets the timers.
    pub reset: unsafe fn(),
}

/// The outputs with one protocol. A constant of the board, so that a fault handler can use it without other state.
#[derive(Clone, Copy)]
pub struct Lines {
    outputs: Outputs,
    protocol: Protocol,
    prescaler: u16,
    /// Timer period, counts.
    period: u16,
    /// Counts per microsecond of the servo scale.
    per_us: f32,
}

/// Whether the last step's pulses were dropped.
static DROPPED: AtomicBool = AtomicBool::new(false);

impl Lines {
    /// Returns the outputs with `protocol`.
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

    /// Sets up the timers, and starts them with the stop pulse. The timers must be in their reset state, with their DMA
    /// streams off and their clocks enabled. The pins may be connected afterwards.
    #[inline(never)]
    pub fn start(&self) {
        let one_pulse = self.protocol == Protocol::OneShot125;
        for timer in self.outputs.timers {
            let registers = timer.registers();
            // Only the end of a period requests DMA, not the update events that this module generates.
            registers.cr1().write(|w| w.arpe().enabled().opm().bit(one_pulse).urs().counter_only());
            registers.psc().write(|w| w.psc().set(timer.prescaler(self.prescaler)));
            registers.arr().write(|w| w.arr().set(self.period - 1));
        }
        for pad in self.outputs.pads {
            let registers = pad.registers();
            // Mode 1 is high below the compare value, mode 2 from the compare value on. OneShot125 uses mode 2, so that
            // the line is low while the timer is stopped.
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
        // Set compare values that keep the lines low, before the outputs are enabled.
        self.load(if one_pulse { [self.period; 4] } else { [0; 4] });
        self.each(generate_update);
        for pad in self.outputs.pads {
            // A complementary output alone has the polarity of the normal output: it is not inverted (RM0090, table
            // 95).
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
                // Start them before a pad is high: a pulse that begins while its timer is stopped would be too long.
                self.each(run);
                self.load_servo([STOP_US; 4]);
                self.each(generate_update);
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
    pub fn send(&self, pulses_us: [f32; 4]) -> SendResult {
        let sent = self.prepare_to_send();
        if sent == SendResult::Dropped {
            return sent;
        }
        match self.protocol {
            Protocol::Pwm { .. } => {
                let guard = self.period - (GUARD_US * self.per_us) as u16;
                if let Some(last) = self.outputs.timers.last() {
                    for _ in 0..GUARD_POLLS {
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
                self.each(generate_update);
                self.each(run);
            }
            Protocol::DShot300 | Protocol::DShot600 => {
                let frames = pulses_us.map(|us| DshotThrottle::from_pulse(us).frame(false));
                for (timer, table) in self.outputs.timers.iter().zip(&TABLES) {
                    // A channel without a pad gets a frame that leads nowhere.
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
                self.each(stop_timer);
                self.load([0; 4]);
                self.each(generate_update);
                self.outputs.timers.iter().for_each(Timer::start_dma);
                self.each(|registers| {
                    registers.dier().write(|w| w.ude().enabled());
                    run(registers);
                });
            }
        }
        sent
    }

    /// Checks whether the next pulses can be sent, and restarts outputs that hang.
    #[inline]
    fn prepare_to_send(&self) -> SendResult {
        if let Protocol::Pwm { .. } = self.protocol {
            return SendResult::Sent;
        }
        let hangs = if self.busy() {
            if !DROPPED.load(Ordering::Relaxed) {
                DROPPED.store(true, Ordering::Relaxed);
                return SendResult::Dropped;
            }
            true
        } else {
            self.was_cut()
        };
        DROPPED.store(false, Ordering::Relaxed);
        if hangs {
            self.reset();
            self.start();
            return SendResult::Recovered;
        }
        SendResult::Sent
    }

    /// Returns whether a pulse or a frame is being sent. Never true for PWM, which accepts new values at any time.
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

    /// Returns whether the last frame ended early. It does if DMA finds an error; the timer then repeats the last bit.
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

    /// Resets the timers, stops their DMA, and enables the clocks. The pads fall: a timer in reset does not drive them,
    /// and they have pull-downs. The streams are stopped one by one, because the IMU may use others of the same
    /// controller.
    #[cold]
    #[inline(never)]
    fn reset(&self) {
        // SAFETY: only this module uses the timers, and none of its functions is in progress: the caller is the control
        // loop, or a fault handler that does not return to it.
        unsafe {
            (self.outputs.enable)();
            (self.outputs.reset)();
        }
        self.outputs.timers.iter().for_each(|timer| timer.stream.stop());
    }
}

type Registers = &'static tim1::RegisterBlock;

/// Generates an update event: the timer loads its preloaded prescaler, period and compare values, and begins a period.
#[inline(always)]
fn generate_update(registers: Registers) {
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

/// Stops the timer, and disables its DMA request.
#[inline(always)]
fn stop_timer(registers: Registers) {
    registers.cr1().modify(|_, w| w.cen().disabled());
    registers.dier().write(|w| w.ude().disabled());
}

/// Offset of CCR1 in a timer's registers, counted in registers, as DCR counts.
const FIRST_COMPARE: u8 = 0x34 / 4;

impl Timer {
    #[inline(always)]
    fn registers(&self) -> Registers {
        // SAFETY: after `init` no code owns the timer, and only this module writes to it: from the control loop, or
        // from a fault handler that does not return to it.
        unsafe { &*self.registers }
    }

    /// Returns the prescaler with which the timer counts 84 MHz / (`prescaler` + 1).
    fn prescaler(&self, prescaler: u16) -> u16 {
        if self.advanced { 2 * prescaler + 1 } else { prescaler }
    }

    /// Sets up DMA with the settings common to all frames. The stream must be off.
    fn set_up_dma(&self, table: &'static Table) {
        let registers = self.registers();
        // SAFETY: the burst length less one; the burst begins at a compare value, and ends at CCR4 at the latest.
        registers
            .dcr()
            .write(|w| unsafe { w.dbl().bits(2 * self.pairs - 1).dba().bits(FIRST_COMPARE + self.first) });
        let stream = self.stream.registers();
        // SAFETY: a register of the timer, which takes 16 bits.
        stream.par().write(|w| unsafe { w.pa().bits(registers.dmar().as_ptr() as u32) });
        // SAFETY: a static with two halfwords for each value of a pair, which only this module writes to.
        stream.m0ar().write(|w| unsafe { w.m0a().bits(table.0.as_ptr() as u32) });
        stream.cr().write(|w| {
            w.chsel().set(self.stream.channel()).pl().high();
            w.dir().memory_to_peripheral().minc().incremented().msize().bits16().psize().bits16()
        });
    }

    /// Starts DMA of the table.
    #[inline(always)]
    fn start_dma(&self) {
        self.stream.clear_all();
        let stream = self.stream.registers();
        stream.ndtr().write(|w| w.ndt().set(2 * u16::from(self.pairs) * DSHOT_SLOTS as u16));
        stream.cr().modify(|_, w| w.en().enabled());
    }
}

/// The timer compare values that DMA writes to the timer's registers: for each bit of a frame, the values of one or two
/// pairs of channels. They must be in RAM that DMA can reach. They are, because the linker puts no variable into the
/// core-coupled memory (memory.x).
struct Table([AtomicU32; 2 * DSHOT_SLOTS]);

/// One table for each timer: four pads have at most four timers.
static TABLES: [Table; 4] = [const { Table([const { AtomicU32::new(0) }; 2 * DSHOT_SLOTS]) }; 4];

impl Table {
    /// Writes the compare values of pair `pair`, of `pairs` in the table.
    #[inline(always)]
    fn write(&self, pair: usize, pairs: usize, duties: [u32; DSHOT_SLOTS]) {
        for (slot, value) in self.0.iter().skip(pair).step_by(pairs).zip(duties) {
            slot.store(value, Ordering::Relaxed);
        }
    }
}
