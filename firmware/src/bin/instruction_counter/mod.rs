//! Counts instructions on QEMU's Cortex-M4F.
//!
//! With `-icount shift=2` an instruction takes 4 ns of QEMU's virtual time. QEMU's timer TIM2 counts
//! nanoseconds, so the difference of two readings is four times the number of instructions between them. Instructions
//! are not cycles: on a chip, loads from flash, taken branches, divisions and `vsqrt` take more than one cycle. The
//! calibration removes the instructions of the measurement itself; a thousand `nop`s check it.

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

/// Ends QEMU with status 0.
pub fn exit() -> ! {
    loop {
        debug::exit(EXIT_SUCCESS);
    }
}

/// The instruction counter.
pub struct InstructionCounter {
    timer: TIM2,
    /// Count of an empty measurement.
    overhead: u32,
}

impl InstructionCounter {
    /// Starts TIM2, which counts nanoseconds, and calibrates the count.
    pub fn start() -> Self {
        let Peripherals { TIM2: timer, .. } = Peripherals::take().expect("taken once");
        timer.psc().write(|w| w.psc().set(0));
        // The period stays 0, because with a period of 0 QEMU's timer never ends a period.
        timer.cr1().write(|w| w.cen().set_bit());
        let mut counter = Self { timer, overhead: 0 };
        counter.calibrate();
        counter
    }

    /// Runs `work`, and returns its result and its instructions.
    #[inline(always)]
    pub fn count<T>(&self, work: impl FnOnce() -> T) -> (T, u32) {
        let before = self.timer.cnt().read().bits();
        let result = black_box(work());
        let after = self.timer.cnt().read().bits();
        (result, (after.wrapping_sub(before) / 4).wrapping_sub(self.overhead))
    }

    fn calibrate(&mut self) {
        // A loop like the one below, so that the compiler generates the same code for both.
        let mut overhead = u32::MAX;
        for _ in 0..1_024 {
            // SAFETY: the assembly is empty.
            overhead = overhead.min(self.count(|| unsafe { asm!("") }).1);
        }
        self.overhead = overhead;
        let mut total = Total::default();
        for _ in 0..1_024 {
            // SAFETY: the assembly is a thousand `nop`s.
            total.add(self.count(|| unsafe { asm!(".rept 1000", "nop", ".endr") }).1);
        }
        total.print("1000 nops");
    }

    /// Counts `stage` on each of `inputs`, and prints the totals.
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

/// Instruction counts of a stage over its inputs.
#[derive(Clone, Copy, Default)]
pub struct Total {
    /// Number of inputs.
    pub inputs: u32,
    /// Sum over all inputs.
    pub instructions: u32,
    /// Largest count for one input.
    pub max: u32,
}

impl Total {
    /// Adds the count of one input.
    pub fn add(&mut self, instructions: u32) {
        self.inputs += 1;
        self.instructions += instructions;
        self.max = self.max.max(instructions);
    }

    /// Prints `icount,<name>,<inputs>,<instructions in all>,<most for one input>`.
    pub fn print(&self, name: impl Display) {
        hprintln!("icount,{},{},{},{}", name, self.inputs, self.instructions, self.max);
    }
}
