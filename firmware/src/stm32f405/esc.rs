//! Four ESC outputs: pads M1 and M2 on channels 1 and 2 of TIM4, M3 and M4 on channels 3 and 4 of TIM3.
//!
//! | protocol | timers | what a step does | without steps |
//! |---|---|---|---|
//! | PWM | run for ever | writes four compare values, taken at the next period | the last pulse goes on |
//! | OneShot125 | stand still | writes four compare values, starts one pulse | no pulses |
//! | DShot300, DShot600 | one period a bit | writes two tables, from which DMA plays a frame | no frames, lines low |
//!
//! # All four at once
//! Both timers have the same clock, prescaler and period. With PWM they are started one right after the other and
//! never stopped, so that their periods begin within a microsecond of each other for ever. Compare values are
//! preloaded: a timer takes them when a period begins. What remains is that a period begins between two of the
//! four writes, and so nothing is written in the last [`GUARD_US`] of a period; the writes, their arithmetic and
//! what may interrupt them take half of that. So one step's four pulses always go out in the same period. TIM4
//! is started first: once TIM3, which is looked at, has begun a period, so has TIM4.
//!
//! With the others the timers stand while they are written to, and are started afterwards.
//!
//! # DShot by DMA
//! At the end of each bit the timer asks for DMA, which writes the next two compare values through the timer's
//! DMAR register: `TIM3_UP` is DMA1 stream 2 channel 5, `TIM4_UP` stream 6 channel 2. The values are preloaded, so
//! that those of the first request, one bit time after the start, are on the line from two bit times after the start
//! on:
//! ```text
//!  bit times        0         1         2         3   ...   17        18        19
//!  on the line      low       low       bit 15    bit 14    bit 0     low       low
//!  DMA writes                 bit 15    bit 14    bit 13    zero      zero; ends
//! ```
//! A frame ends 18 bit times after its start: 60 µs with DShot300, 30 µs with DShot600. The last two of the 18 pairs
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
use stm32f4xx_hal::pac::{DMA1, TIM3, TIM4, dma2, tim3};
use stm32f4xx_hal::rcc::{Enable, Reset};

#[cfg(not(feature = "unwired"))]
mod end;

/// Clock of both timers, counts a microsecond and a second: twice APB1's.
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

/// The outputs, speaking one protocol. A constant of the board: a fault must find it without anybody's help.
#[derive(Clone, Copy)]
pub struct Lines {
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
    pub const fn new(protocol: Protocol) -> Self {
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
        Self { protocol, prescaler, period, per_us: CLOCK_MHZ / (prescaler as f32 + 1.0) }
    }

    /// Sets the timers up, and starts them with the stop pulse. They and DMA1 are as after a reset, and their clocks
    /// run; the pins may be connected afterwards.
    #[inline(never)]
    pub fn start(&self) {
        let timers = [tim4(), tim3()];
        let one_pulse = self.protocol == Protocol::OneShot125;
        for timer in timers {
            // Only the end of a period asks for DMA, not the update that this module makes.
            timer.cr1().write(|w| w.arpe().enabled().opm().bit(one_pulse).urs().counter_only());
            timer.psc().write(|w| w.psc().set(self.prescaler));
            timer.arr().write(|w| w.arr().set(self.period - 1));
        }
        // Mode 1 is high up to the compare value, 2 from there on. OneShot125 takes the latter, so that the line is low
        // while the timer stands.
        if one_pulse {
            tim4().ccmr1_output().write(|w| {
                w.oc1m().pwm_mode2().oc1pe().enabled();
                w.oc2m().pwm_mode2().oc2pe().enabled()
            });
            tim3().ccmr2_output().write(|w| {
                w.oc3m().pwm_mode2().oc3pe().enabled();
                w.oc4m().pwm_mode2().oc4pe().enabled()
            });
        } else {
            tim4().ccmr1_output().write(|w| {
                w.oc1m().pwm_mode1().oc1pe().enabled();
                w.oc2m().pwm_mode1().oc2pe().enabled()
            });
            tim3().ccmr2_output().write(|w| {
                w.oc3m().pwm_mode1().oc3pe().enabled();
                w.oc4m().pwm_mode1().oc4pe().enabled()
            });
        }
        // Compare values at which the lines stay low, before the outputs are switched on.
        load(if one_pulse { [self.period; 4] } else { [0; 4] });
        timers.into_iter().for_each(take_preloaded);
        tim4().ccer().write(|w| w.cc1e().set_bit().cc2e().set_bit());
        tim3().ccer().write(|w| w.cc3e().set_bit().cc4e().set_bit());
        match self.protocol {
            Protocol::Pwm { .. } => {
                // They run before a pad is high: a pulse that begins while its timer stands is too long.
                timers.into_iter().for_each(run);
                self.load_servo([STOP_US; 4]);
                timers.into_iter().for_each(take_preloaded);
            }
            Protocol::OneShot125 => {}
            Protocol::DShot300 | Protocol::DShot600 => {
                // Two registers a request: from CCR3 on, which has the offset 0x3c, and from CCR1 on, 0x34.
                // SAFETY: one register more than one, of those that the timer has.
                tim3().dcr().write(|w| unsafe { w.dbl().bits(1) }.dba().set(0x3c / 4));
                // SAFETY: as above.
                tim4().dcr().write(|w| unsafe { w.dbl().bits(1) }.dba().set(0x34 / 4));
                TIM3_TABLE.set_up(tim3(), 5);
                TIM4_TABLE.set_up(tim4(), 2);
            }
        }
    }

    #[inline]
    fn load_servo(&self, pulses_us: [f32; 4]) {
        load(pulses_us.map(|us| pwm_counts(us, self.per_us)));
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
                for _ in 0..GUARD_LOOKS {
                    if tim3().cnt().read().cnt().bits() < guard {
                        break;
                    }
                }
                self.load_servo(pulses_us);
            }
            Protocol::OneShot125 => {
                let counts = pulses_us.map(|us| oneshot125_counts(us, CLOCK_MHZ));
                load(counts.map(|counts| self.period.saturating_sub(counts)));
                let timers = [tim4(), tim3()];
                timers.into_iter().for_each(take_preloaded);
                timers.into_iter().for_each(run);
            }
            Protocol::DShot300 | Protocol::DShot600 => {
                let [m1, m2, m3, m4] = pulses_us.map(|us| DshotThrottle::from_pulse(us).frame(false));
                TIM4_TABLE.write(dshot_duty_pairs([m1, m2], self.period));
                TIM3_TABLE.write(dshot_duty_pairs([m3, m4], self.period));
                let timers = [tim4(), tim3()];
                timers.into_iter().for_each(rewind);
                load([0; 4]);
                timers.into_iter().for_each(take_preloaded);
                TIM3_TABLE.play();
                TIM4_TABLE.play();
                for timer in timers {
                    timer.dier().write(|w| w.ude().enabled());
                    run(timer);
                }
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
            reset();
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
            Protocol::OneShot125 => running(tim3()) || running(tim4()),
            Protocol::DShot300 | Protocol::DShot600 => TIM3_TABLE.playing() || TIM4_TABLE.playing(),
        }
    }

    /// Whether the last frame ended before all of it was played: DMA found an error, and the timer goes on with the
    /// last bit.
    #[inline]
    fn was_cut(&self) -> bool {
        match self.protocol {
            Protocol::Pwm { .. } | Protocol::OneShot125 => false,
            Protocol::DShot300 | Protocol::DShot600 => TIM3_TABLE.left() > 0 || TIM4_TABLE.left() > 0,
        }
    }
}

/// Resets timers and DMA, and lets their clocks run. The pads fall: a timer in reset does not drive them, and they are
/// pulled down.
#[cold]
#[inline(never)]
fn reset() {
    // SAFETY: only this module uses the three, and nothing of it is under way: this is the flight task, or a fault
    // that does not return to it.
    unsafe {
        TIM3::enable_unchecked();
        TIM4::enable_unchecked();
        DMA1::enable_unchecked();
        TIM3::reset_unchecked();
        TIM4::reset_unchecked();
        DMA1::reset_unchecked();
    }
}

type Timer = &'static tim3::RegisterBlock;

fn tim3() -> Timer {
    // SAFETY: after `init` nobody owns the timer, and only this module writes to it: the flight task, or a fault
    // that does not return to it.
    unsafe { &*TIM3::ptr() }
}

fn tim4() -> Timer {
    // SAFETY: as TIM3.
    unsafe { &*TIM4::ptr() }
}

#[inline(always)]
fn load([m1, m2, m3, m4]: [u16; 4]) {
    tim4().ccr1().write(|w| w.ccr().set(m1));
    tim4().ccr2().write(|w| w.ccr().set(m2));
    tim3().ccr3().write(|w| w.ccr().set(m3));
    tim3().ccr4().write(|w| w.ccr().set(m4));
}

/// The timer takes its preloaded prescaler, period and compare values, and begins a period.
#[inline(always)]
fn take_preloaded(timer: Timer) {
    timer.egr().write(|w| w.ug().update());
}

#[inline(always)]
fn run(timer: Timer) {
    timer.cr1().modify(|_, w| w.cen().enabled());
}

#[inline(always)]
fn running(timer: Timer) -> bool {
    timer.cr1().read().cen().is_enabled()
}

/// Stops the timer, with no request for DMA left.
#[inline(always)]
fn rewind(timer: Timer) {
    timer.cr1().modify(|_, w| w.cen().disabled());
    timer.dier().write(|w| w.ude().disabled());
}

/// Compare values of two outputs, in turn, and the stream of DMA1 that plays them. In RAM that DMA reaches: the linker
/// puts no variable into the core-coupled memory (memory.x).
struct Table<const STREAM: usize>([AtomicU32; DSHOT_SLOTS]);

static TIM3_TABLE: Table<2> = Table([const { AtomicU32::new(0) }; DSHOT_SLOTS]);
static TIM4_TABLE: Table<6> = Table([const { AtomicU32::new(0) }; DSHOT_SLOTS]);

fn dma() -> &'static dma2::RegisterBlock {
    // SAFETY: only this module uses DMA1.
    unsafe { &*DMA1::ptr() }
}

impl<const STREAM: usize> Table<STREAM> {
    #[inline(always)]
    fn registers(&self) -> &'static dma2::ST {
        dma().st(STREAM)
    }

    /// What is the same in all frames: `timer` asks on `channel`. The stream is off.
    fn set_up(&self, timer: Timer, channel: u8) {
        let stream = self.registers();
        // SAFETY: a register of the timer, which takes 16 bits.
        stream.par().write(|w| unsafe { w.pa().bits(timer.dmar().as_ptr() as u32) });
        // SAFETY: a static that has 2 · DSHOT_SLOTS halfwords, and that nothing but this module writes to.
        stream.m0ar().write(|w| unsafe { w.m0a().bits(self.0.as_ptr() as u32) });
        stream.cr().write(|w| {
            w.chsel().set(channel).pl().high();
            w.dir().memory_to_peripheral().minc().incremented().msize().bits16().psize().bits16()
        });
    }

    #[inline(always)]
    fn write(&self, duties: [u32; DSHOT_SLOTS]) {
        for (slot, pair) in self.0.iter().zip(duties) {
            slot.store(pair, Ordering::Relaxed);
        }
        fence(Ordering::Release);
    }

    #[inline(always)]
    fn play(&self) {
        const { assert!(STREAM == 2 || STREAM == 6, "the flags of the others have other names") };
        if STREAM == 2 {
            dma().lifcr().write(|w| {
                w.cfeif2().clear().cdmeif2().clear().cteif2().clear().chtif2().clear().ctcif2().clear()
            });
        } else {
            dma().hifcr().write(|w| {
                w.cfeif6().clear().cdmeif6().clear().cteif6().clear().chtif6().clear().ctcif6().clear()
            });
        }
        let stream = self.registers();
        stream.ndtr().write(|w| w.ndt().set(2 * DSHOT_SLOTS as u16));
        stream.cr().modify(|_, w| w.en().enabled());
    }

    #[inline(always)]
    fn playing(&self) -> bool {
        self.registers().cr().read().en().is_enabled()
    }

    /// Halfwords that are still to be played.
    #[inline(always)]
    fn left(&self) -> u16 {
        self.registers().ndtr().read().ndt().bits()
    }
}
