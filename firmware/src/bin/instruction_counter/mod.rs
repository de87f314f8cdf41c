//! Counts instructions on QEMU's Cortex-M4F.
//!
//! With `-icount shift=2` an instruction takes 4 ns of the emulator's virtual time, and its timer TIM2 counts
//! nanoseconds, so a difference of two readings is four times the instructions between them. These are
//! instructions, not cycles: loads from flash, taken branches, divisions and `vsqrt` cost more than one on a
//! chip. A thousand `nop`s calibrate away what the measurement takes itself.

use core::arch::asm;
use core::fmt::Display;
use core::hint::black_box;

use cortex_m_rt::{ExceptionFrame, exception};
use cortex_m_semihosting::debug::{self, EXIT_FAILURE, EXIT_SUCCESS};
use cortex_m_semihosting::hprintln;
use stm32f4xx_hal::pac::{Peripherals, TIM2};

#[exception]
unsafe fn HardFault(_frame: &ExceptionFrame) -> ! {
    loop {
        debug::exit(EXIT_FAILURE);
    }
}

/// Ends the emulator.
pub fn exit() -> ! {
    loop {
        debug::exit(EXIT_SUCCESS);
    }
}

/// The counter of instructions.
pub struct InstructionCounter {
    timer: TIM2,
    /// Instructions that a measurement of nothing reads.
    overhead: u32,
}

impl InstructionCounter {
    /// Lets TIM2 count nanoseconds, and calibrates the count.
    pub fn start() -> Self {
        let Peripherals { TIM2: timer, .. } = Peripherals::take().expect("taken once");
        timer.psc().write(|w| w.psc().set(0));
        // Its period stays 0, with which the emulator's timer never ends one.
        timer.cr1().write(|w| w.cen().set_bit());
        let mut counter = Self { timer, overhead: 0 };
        counter.calibrate();
        counter
    }

    /// Instructions that `work` takes.
    #[inline(always)]
    pub fn count<T>(&self, work: impl FnOnce() -> T) -> (T, u32) {
        let before = self.timer.cnt().read().bits();
        let result = black_box(work());
        let after = self.timer.cnt().read().bits();
        (result, (after.wrapping_sub(before) / 4).wrapping_sub(self.overhead))
    }

    fn calibrate(&mut self) {
        // In a loop as the one below, so that the compiler makes the same of both.
        let mut overhead = u32::MAX;
        for _ in 0..1_024 {
            // SAFETY: does nothing.
            overhead = overhead.min(self.count(|| unsafe { asm!("") }).1);
        }
        self.overhead = overhead;
        let mut total = Total::default();
        for _ in 0..1_024 {
            // SAFETY: does nothing, a thousand times.
            total.add(self.count(|| unsafe { asm!(".rept 1000", "nop", ".endr") }).1);
        }
        total.print("1000 nops");
    }

    /// Measures `stage` on each of `inputs`.
    pub fn stage<I, O>(
        &self,
        name: impl Display,
        inputs: impl Iterator<Item = I>,
        mut stage: impl FnMut(&I) -> O,
    ) {
        let mut total = Total::default();
        for input in inputs {
            let input = black_box(input);
            total.add(self.count(|| stage(black_box(&input))).1);
        }
        total.print(name);
    }
}

/// What a stage took over its inputs.
#[derive(Clone, Copy, Default)]
pub struct Total {
    /// Inputs.
    pub inputs: u32,
    /// Instructions in all.
    pub instructions: u32,
    /// Most instructions for one input.
    pub most: u32,
}

impl Total {
    /// One more input.
    pub fn add(&mut self, instructions: u32) {
        self.inputs += 1;
        self.instructions += instructions;
        self.most = self.most.max(instructions);
    }

    /// `icount,<name>,<inputs>,<instructions in all>,<most for one input>`
    pub fn print(&self, name: impl Display) {
        hprintln!("icount,{},{},{},{}", name, self.inputs, self.instructions, self.most);
    }
}
