//! The external interrupt controller, RM0090 rev 22 chapter 12, and the port selection of SYSCFG, chapter 9.
//!
//! A port announces each change of level on one of its pins as a request line of its own, numbered by the pin. Line
//! n of the controller listens to pin n of the port that `SYSCFG_EXTICR` selects, and to no other. An edge that
//! `RTSR` or `FTSR` asks for sets the line's pending bit, whether or not `IMR` lets it through; a written one in
//! `PR` clears it. Lines 16 and up come from other peripherals: 16 is the supply's voltage detector.
//!
//! | Lines | Vector |
//! |---|---|
//! | 0 to 4 | one each |
//! | 5 to 9, 10 to 15 | one for all of them |
//! | 16 | PVD |
//!
//! Left out: the event output (`EMR`), which wakes the core from `WFE`; lines 17 to 22, whose sources the board
//! does not use.

use rigless::device::{Device, DeviceContext, Level, RegisterFile, RequestChange};
use rigless::snapshot::store;
use rigless::soc::stm32f427::generated::{exti, syscfg};

/// The line of the programmable voltage detector.
pub const PVD_LINE: usize = 16;
/// Lines that have an edge detector here.
const LINES: usize = 17;

/// The request by which SYSCFG tells the controller what it selects: `line << 8 | port` is what it drives.
const SELECTION: usize = 0x1000;

/// Positions in the instance's list of interrupts: 2, 6 to 10, 23, 40 in ST's file, and 1 (PVD) added by the part.
const VECTORS: [usize; LINES] = {
    let mut vectors = [0; LINES];
    let mut line = 0;
    while line < LINES {
        vectors[line] = match line {
            0..=4 => 1 + line,
            5..=9 => 6,
            10..=15 => 7,
            _ => 8,
        };
        line += 1;
    }
    vectors
};

/// Interrupt numbers of the instance, in the order of [`VECTORS`]' positions (RM0090, table 62): TAMP_STAMP, EXTI0
/// to EXTI4, EXTI9_5, EXTI15_10, PVD.
pub const INTERRUPTS: [u16; 9] = [2, 6, 7, 8, 9, 10, 23, 40, 1];

/// The controller.
#[derive(Debug, Default, serde::Serialize, serde::Deserialize)]
pub struct Exti {
    /// The port that each of lines 0 to 15 listens to, 0 for port A.
    ports: [u8; 16],
    /// Levels of the pins of ports A to I, a bit a pin.
    pins: [u16; 9],
    /// Levels of the lines.
    lines: u32,
}

store!(Exti);

impl Exti {
    fn set_line(
        &mut self,
        line: usize,
        high: bool,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) {
        let bit = 1 << line;
        let was_high = self.lines & bit != 0;
        if high == was_high {
            return;
        }
        self.lines ^= bit;
        let wanted = if high { exti::Register::Rtsr } else { exti::Register::Ftsr };
        if registers.get(wanted) & u64::from(bit) != 0 {
            let pending = registers.get(exti::Register::Pr);
            registers.set(exti::Register::Pr, pending | u64::from(bit));
            Self::drive(registers, context);
        }
    }

    /// The level of a line that is no pin: the voltage detector's.
    pub fn drive_internal(
        &mut self,
        line: usize,
        high: bool,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) {
        self.set_line(line, high, registers, context);
    }

    fn drive(registers: &RegisterFile, context: &mut DeviceContext<'_>) {
        let up = registers.get(exti::Register::Pr) & registers.get(exti::Register::Imr);
        for position in 1..INTERRUPTS.len() {
            let lines = (0..LINES).filter(|&line| VECTORS[line] == position);
            let high = lines.into_iter().any(|line| up & 1 << line != 0);
            context.interrupt(position, Level::from(high));
        }
    }
}

impl Device for Exti {
    type Register = exti::Register;

    fn write(
        &mut self,
        register: exti::Register,
        value: u64,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) {
        match register {
            // The file's rule has cleared what was written as one.
            exti::Register::Swier => {
                // 12.3.5: a bit that goes from 0 to 1 while its line is unmasked sets the pending bit.
                let pending = registers.get(exti::Register::Pr) | value & registers.get(exti::Register::Imr);
                registers.set(exti::Register::Pr, pending);
            }
            exti::Register::Pr => {
                let software = registers.get(exti::Register::Swier);
                registers.set(exti::Register::Swier, software & !value);
            }
            _ => {}
        }
        Self::drive(registers, context);
    }

    fn on_request(
        &mut self,
        change: RequestChange,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) {
        if change.instance == "SYSCFG" && change.request >= SELECTION {
            let (line, port) = ((change.request - SELECTION) >> 8, change.request & 0xff);
            self.ports[line] = port as u8;
            let high = self.pins.get(port).is_some_and(|pins| pins & 1 << line != 0);
            // A line that is turned to another pin takes that pin's level without an edge.
            self.lines = self.lines & !(1 << line) | u32::from(high) << line;
            return;
        }
        let Some(port) = port_of(change.instance) else { return };
        let (line, high) = (change.request, change.level == Level::High);
        if line >= 16 {
            return;
        }
        let bit = 1 << line;
        self.pins[port] = if high { self.pins[port] | bit } else { self.pins[port] & !bit };
        if usize::from(self.ports[line]) == port {
            self.set_line(line, high, registers, context);
        }
    }

    fn reset(&mut self) {
        // The pins are where they are; what listens to them starts anew.
        let pins = self.pins;
        *self = Self { pins, ..Self::default() };
        for line in 0..16 {
            self.lines |= u32::from(pins[0] >> line & 1) << line;
        }
    }
}

/// The number of a port, 0 for `GPIOA`.
fn port_of(instance: &str) -> Option<usize> {
    let letter = instance.strip_prefix("GPIO")?.bytes().next()?;
    Some(usize::from(letter.checked_sub(b'A')?)).filter(|&port| port < 9)
}

/// The system configuration controller, as far as it selects ports for the [`Exti`].
#[derive(Debug, Default, serde::Serialize, serde::Deserialize)]
pub struct Syscfg;

store!(Syscfg);

impl Device for Syscfg {
    type Register = syscfg::Register;

    fn write(
        &mut self,
        register: syscfg::Register,
        _value: u64,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) {
        let first = match register {
            syscfg::Register::Exticr1 => 0,
            syscfg::Register::Exticr2 => 4,
            syscfg::Register::Exticr3 => 8,
            syscfg::Register::Exticr4 => 12,
            _ => {
                context.tell("MEMRMP/PMC", "only the external interrupts' port selection is modelled");
                return;
            }
        };
        let value = registers.get(register);
        for n in 0..4 {
            let port = value >> (4 * n) & 0xf;
            let request = SELECTION | (first + n) << 8 | port as usize;
            context.request(request, Level::High);
            context.request(request, Level::Low);
        }
    }
}
