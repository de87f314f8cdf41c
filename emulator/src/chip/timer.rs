//! A timer whose model stops while it has no visible effect.
//!
//! The model needs an event at each overflow and compare match. A DShot timer that runs with compare values of zero
//! overflows 300,000 to 600,000 times a second without an effect: its outputs stay low, it raises no interrupt, and its
//! DMA request is already pending. After a few such overflows this module stops the model's clock. The next access starts
//! the clock again, with the count that the timer has reached by then.

use rigless::device::{Device, DeviceContext, Level, RegisterFile, RequestChange};
use rigless::soc::RegisterSpec;
use rigless::soc::stm32f427::generated::tim2::{ccmr1_output, cr1, dier};
use rigless::soc::stm32f427::generated::{tim1, tim2};
use rigless::soc::stm32f427::peripherals::tim::{Advanced, Channel, Family, General, Tim};
use rigless::time::{EventId, VirtualNanos};

/// Number of consecutive events without an effect after which the model stops: by then, preloaded values are active.
const QUIET_EVENTS: u32 = 8;

/// The registers of a timer family that this module uses. Their fields are at the same bits in both families.
pub trait TimerRegisters: Family {
    /// CR1.
    const CONTROL: Self::Register;
    /// DIER.
    const ENABLES: Self::Register;
    /// CCMR1 and CCMR2, of outputs.
    const MODES: [Self::Register; 2];
    /// CNT.
    const COUNT: Self::Register;
    /// PSC.
    const PRESCALER: Self::Register;
    /// ARR.
    const PERIOD: Self::Register;
    /// CCR1 to CCR4.
    const COMPARES: [Self::Register; 4];
}

macro_rules! timer_registers {
    ($family:ident, $layout:ident) => {
        impl TimerRegisters for $family {
            const CONTROL: Self::Register = $layout::Register::Cr1;
            const ENABLES: Self::Register = $layout::Register::Dier;
            const MODES: [Self::Register; 2] =
                [$layout::Register::Ccmr1Output, $layout::Register::Ccmr2Output];
            const COUNT: Self::Register = $layout::Register::Cnt;
            const PRESCALER: Self::Register = $layout::Register::Psc;
            const PERIOD: Self::Register = $layout::Register::Arr;
            const COMPARES: [Self::Register; 4] = [
                $layout::Register::Ccr1,
                $layout::Register::Ccr2,
                $layout::Register::Ccr3,
                $layout::Register::Ccr4,
            ];
        }
    };
}
timer_registers!(General, tim2);
timer_registers!(Advanced, tim1);

/// A timer that stops while it has no visible effect.
#[derive(Debug)]
pub struct Timer<F: Family> {
    inner: Tim<F>,
    clock_hz: u64,
    quiet_events: u32,
    /// Time and count at which the model was stopped; `None` while it runs.
    asleep: Option<(VirtualNanos, u64)>,
    /// Whether the model ran since the last [`Self::take_touched`]: its outputs may have changed.
    touched: bool,
}

impl<F: TimerRegisters> Timer<F> {
    /// Returns a timer with the model `inner` and this clock, Hz.
    pub fn new(inner: Tim<F>, clock_hz: u64) -> Self {
        Self { inner, clock_hz, quiet_events: 0, asleep: None, touched: true }
    }

    /// Returns the level that the timer drives on a pin of its channel `n` (1 to 4), if it drives it.
    pub fn output(&self, n: u8, complementary: bool, registers: &RegisterFile) -> Option<Level> {
        let channel = Channel::new(n)?;
        if complementary {
            self.inner.complementary_output(channel, registers)
        } else {
            self.inner.output(channel, registers)
        }
    }

    /// Returns whether the outputs can have changed since the last call.
    pub fn take_touched(&mut self) -> bool {
        std::mem::take(&mut self.touched)
    }

    /// Returns whether the timer has no visible effect with its present settings.
    fn is_quiet(&self, registers: &RegisterFile) -> bool {
        let interrupts = dier::UIE.mask()
            | dier::CC1IE.mask()
            | dier::CC2IE.mask()
            | dier::CC3IE.mask()
            | dier::CC4IE.mask()
            | dier::TIE.mask();
        registers.get(F::ENABLES) & interrupts == 0
            // In PWM mode 1 and in the frozen mode, the output stays low with a compare value of zero.
            && F::MODES.iter().all(|&register| {
                let value = registers.get(register);
                [ccmr1_output::OC1M, ccmr1_output::OC2M].iter().all(|mode| matches!(mode.get(value), 0 | 6))
            })
            && F::COMPARES.into_iter().all(|compare| registers.get(compare) == 0)
            && (1..=4).all(|n| {
                [false, true].into_iter().all(|pin| self.output(n, pin, registers) != Some(Level::High))
            })
    }
}

impl<F: TimerRegisters> Timer<F> {
    fn sleep(&mut self, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        let count = self.inner.read(F::COUNT, registers, context).unwrap_or(0);
        self.asleep = Some((context.now(), count));
        self.inner.on_clock(0, registers, context);
    }

    fn wake(&mut self, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        self.quiet_events = 0;
        self.touched = true;
        let Some((since, count)) = self.asleep.take() else { return };
        self.inner.on_clock(self.clock_hz, registers, context);
        let running = cr1::CEN.is_set(registers.get(F::CONTROL));
        let cycles = u128::from(context.now().0 - since.0) * u128::from(self.clock_hz) / 1_000_000_000;
        let counts = cycles / u128::from(registers.get(F::PRESCALER) + 1);
        let period = u128::from(registers.get(F::PERIOD) + 1);
        if running {
            let count = ((u128::from(count) + counts) % period) as u64;
            registers.set(F::COUNT, count);
            self.inner.write(F::COUNT, count, registers, context);
        }
    }
}

impl<F: TimerRegisters> Device for Timer<F> {
    type Register = F::Register;

    fn layout(&self) -> &'static [RegisterSpec] {
        self.inner.layout()
    }

    fn read(
        &mut self,
        register: F::Register,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) -> Option<u64> {
        self.wake(registers, context);
        self.inner.read(register, registers, context)
    }

    fn write(
        &mut self,
        register: F::Register,
        value: u64,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) {
        if self.asleep.is_some() {
            // The register file already holds the written value, but the timer must wake with the state before the write.
            let written = registers.get(register);
            self.wake(registers, context);
            registers.set(register, written);
        }
        self.quiet_events = 0;
        self.touched = true;
        self.inner.write(register, value, registers, context);
    }

    fn on_event(&mut self, event: EventId, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        if self.asleep.is_some() {
            return;
        }
        self.inner.on_event(event, registers, context);
        self.touched = true;
        self.quiet_events = if self.is_quiet(registers) { self.quiet_events + 1 } else { 0 };
        if self.quiet_events >= QUIET_EVENTS {
            self.sleep(registers, context);
        }
    }

    fn on_request(
        &mut self,
        change: RequestChange,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) {
        self.inner.on_request(change, registers, context);
    }

    fn on_clock(&mut self, hz: u64, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        self.wake(registers, context);
        self.clock_hz = hz;
        self.inner.on_clock(hz, registers, context);
    }

    fn on_access(
        &mut self,
        token: u64,
        value: u64,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) {
        self.inner.on_access(token, value, registers, context);
    }

    fn on_refused(&mut self, token: u64, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        self.inner.on_refused(token, registers, context);
    }

    fn reset(&mut self) {
        self.asleep = None;
        self.quiet_events = 0;
        self.touched = true;
        self.inner.reset();
    }

    fn reset_line(&mut self, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        self.wake(registers, context);
        self.inner.reset_line(registers, context);
    }
}
