//! Four ESC outputs: pads M1 and M2 on channels 1 and 2 of TIM4, M3 and M4 on channels 3 and 4 of TIM3.
//!
//! | protocol | timers | what a step does | without steps |
//! |---|---|---|---|
//! | PWM | run for ever | writes four compare values, taken at the next period | the last pulse goes on |
//! | OneShot125 | stand still | writes four compare values, starts one pulse | no pulses |
//! | DShot300 | one period a bit | writes two tables, from which DMA plays a frame | no frames, lines low |
//!
//! # All four at once
//! Both timers have the same clock, prescaler and period. With PWM they are started one right after the other and
//! never stopped, so that their periods begin within a microsecond of each other for ever. Compare values are
//! preloaded: a timer takes them when a period begins. What remains is that a period begins between two of the
//! four writes, and so nothing is written in the last [`GUARD_US`] of a period; the writes, their arithmetic and
//! what may interrupt them take half of that. So one step's four pulses always go out in the same period. TIM4
//! is started first: once TIM3, which is looked at, has begun a period, so has TIM4.
//!
//! With the other two the timers stand while they are written to, and are started afterwards.
//!
//! # DShot by DMA
//! At the end of each bit the timer asks for DMA, which writes the next two compare values through the timer's
//! DMAR register: `TIM3_UP` is DMA1 stream 2 channel 5, `TIM4_UP` stream 6 channel 2. The last two of the 18 are
//! zero, and the line stays low.

use core::sync::atomic::{AtomicU16, Ordering, fence};

use flight_core::esc::protocol::{
    DSHOT_SLOTS, DshotThrottle, Protocol, STOP_US, dshot_duties, oneshot125_counts, pwm_counts,
};
use stm32f4xx_hal::pac::{DMA1, TIM3, TIM4, dma2, tim3};

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
const DSHOT_BIT: u16 = 280;

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
            Protocol::DShot300 => (0, DSHOT_BIT),
        };
        Self { protocol, prescaler, period, per_us: CLOCK_MHZ / (prescaler as f32 + 1.0) }
    }

    /// Sets the timers up, and starts them with the stop pulse. Their clocks must run; the pins may be connected
    /// afterwards.
    pub fn start(&self) {
        let timers = [tim4(), tim3()];
        for timer in timers {
            timer.cr1().write(|w| w.arpe().set_bit().opm().bit(self.protocol == Protocol::OneShot125));
            timer.psc().write(|w| w.psc().set(self.prescaler));
            timer.arr().write(|w| w.arr().set(self.period - 1));
        }
        // PWM mode 1 is high up to the compare value, 2 from there on. OneShot125 takes the latter, so that the
        // line is low while the timer stands.
        let mode: u32 = if self.protocol == Protocol::OneShot125 { 0b0111_1000 } else { 0b0110_1000 };
        // SAFETY: two channels in one of these modes, with preload.
        tim4().ccmr1_output().write(|w| unsafe { w.bits(mode | mode << 8) });
        // SAFETY: likewise.
        tim3().ccmr2_output().write(|w| unsafe { w.bits(mode | mode << 8) });
        // SAFETY: channels 1 and 2 on, active high.
        tim4().ccer().write(|w| unsafe { w.bits(0x0011) });
        // SAFETY: channels 3 and 4 on, active high.
        tim3().ccer().write(|w| unsafe { w.bits(0x1100) });
        match self.protocol {
            Protocol::Pwm { .. } => {
                self.load_servo([STOP_US; 4]);
                timers.into_iter().for_each(take_preloaded);
                timers.into_iter().for_each(run);
            }
            Protocol::OneShot125 => {
                load([self.period; 4]);
                timers.into_iter().for_each(take_preloaded);
            }
            Protocol::DShot300 => {
                load([0; 4]);
                timers.into_iter().for_each(take_preloaded);
                // Two registers a request, from CCR3 (offset 0x3c) and from CCR1 (0x34) on.
                // SAFETY: registers of the timers.
                unsafe {
                    tim3().dcr().write(|w| w.dbl().bits(1).dba().bits(0x3c / 4));
                    tim4().dcr().write(|w| w.dbl().bits(1).dba().bits(0x34 / 4));
                }
                TIM3_TABLE.set_up();
                TIM4_TABLE.set_up();
            }
        }
    }

    #[inline]
    fn load_servo(&self, pulses_us: [f32; 4]) {
        load(pulses_us.map(|us| pwm_counts(us, self.per_us)));
    }

    /// Sends pulses of M1 to M4 (µs on the servo scale).
    #[inline]
    pub fn send(&self, pulses_us: [f32; 4]) {
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
                // Two steps within 260 µs, after a sample that was overdue: the pulses on their way are new
                // enough.
                if running(tim3()) || running(tim4()) {
                    return;
                }
                let counts = pulses_us.map(|us| oneshot125_counts(us, CLOCK_MHZ));
                load(counts.map(|counts| self.period.saturating_sub(counts)));
                let timers = [tim4(), tim3()];
                timers.into_iter().for_each(take_preloaded);
                timers.into_iter().for_each(run);
            }
            Protocol::DShot300 => {
                if TIM3_TABLE.playing() || TIM4_TABLE.playing() {
                    return;
                }
                let [m1, m2, m3, m4] =
                    pulses_us.map(|us| dshot_duties(DshotThrottle::from_pulse(us).frame(false), DSHOT_BIT));
                TIM4_TABLE.write(&m1, &m2);
                TIM3_TABLE.write(&m3, &m4);
                let timers = [tim4(), tim3()];
                timers.into_iter().for_each(rewind);
                TIM3_TABLE.play();
                TIM4_TABLE.play();
                for timer in timers {
                    timer.dier().write(|w| w.ude().set_bit());
                    run(timer);
                }
            }
        }
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
    timer.egr().write(|w| w.ug().set_bit());
}

#[inline(always)]
fn run(timer: Timer) {
    timer.cr1().modify(|_, w| w.cen().set_bit());
}

#[inline(always)]
fn running(timer: Timer) -> bool {
    timer.cr1().read().cen().bit_is_set()
}

/// Stops the timer before its first count, with no request for DMA left.
#[inline(always)]
fn rewind(timer: Timer) {
    timer.cr1().modify(|_, w| w.cen().clear_bit());
    timer.dier().write(|w| w.ude().clear_bit());
    timer.cnt().write(|w| w.cnt().set(0));
}

/// Compare values of two outputs, in turn, and the DMA stream that plays them. In RAM that DMA reaches: the linker
/// puts no variable into the core-coupled memory (memory.x).
struct Table {
    duties: [AtomicU16; 2 * DSHOT_SLOTS],
    timer: fn() -> Timer,
    stream: usize,
    channel: u32,
}

static TIM3_TABLE: Table =
    Table { duties: [const { AtomicU16::new(0) }; 2 * DSHOT_SLOTS], timer: tim3, stream: 2, channel: 5 };
static TIM4_TABLE: Table =
    Table { duties: [const { AtomicU16::new(0) }; 2 * DSHOT_SLOTS], timer: tim4, stream: 6, channel: 2 };

impl Table {
    fn dma() -> &'static dma2::RegisterBlock {
        // SAFETY: only this module uses DMA1.
        unsafe { &*DMA1::ptr() }
    }

    fn set_up(&self) {
        let stream = Self::dma().st(self.stream);
        // SAFETY: the table is static, the register the timer's.
        stream.par().write(|w| unsafe { w.pa().bits((self.timer)().dmar().as_ptr() as u32) });
        // SAFETY: likewise.
        stream.m0ar().write(|w| unsafe { w.m0a().bits(self.duties.as_ptr() as u32) });
    }

    fn write(&self, first: &[u16; DSHOT_SLOTS], second: &[u16; DSHOT_SLOTS]) {
        let pairs = first.iter().zip(second).flat_map(|(first, second)| [*first, *second]);
        for (slot, duty) in self.duties.iter().zip(pairs) {
            slot.store(duty, Ordering::Relaxed);
        }
        fence(Ordering::Release);
    }

    fn play(&self) {
        let dma = Self::dma();
        // All five flags of the stream; the register ignores zeros.
        // SAFETY: flags 16 to 21 of the lower register are stream 2's, of the upper one stream 6's.
        unsafe {
            if self.stream < 4 {
                dma.lifcr().write(|w| w.bits(0x3d << 16));
            } else {
                dma.hifcr().write(|w| w.bits(0x3d << 16));
            }
        }
        let stream = dma.st(self.stream);
        stream.ndtr().write(|w| w.ndt().set(2 * DSHOT_SLOTS as u16));
        // Channel; high priority; 16 bits on both sides; memory incremented; memory to peripheral; on.
        let settings = self.channel << 25 | 2 << 16 | 1 << 13 | 1 << 11 | 1 << 10 | 1 << 6 | 1;
        // SAFETY: these are its fields.
        stream.cr().write(|w| unsafe { w.bits(settings) });
    }

    fn playing(&self) -> bool {
        Self::dma().st(self.stream).cr().read().en().bit_is_set()
    }
}
