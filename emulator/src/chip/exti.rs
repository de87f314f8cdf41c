//! The external interrupt controller, RM0090 rev 22 chapter 12, and the port selection of SYSCFG, chapter 9.
//!
//! A port reports each change of level at a pin on a request line with the pin's number. Line n of the controller
//! is connected to pin n of the one port that `SYSCFG_EXTICR` selects. An edge that `RTSR` or `FTSR` enables sets
//! the line's pending bit, independent of the mask in `IMR`; writing a one to `PR` clears it. Lines from 16 on come
//! from other peripherals: line 16 is the supply's voltage detector.
//!
//! | Lines | Vector |
//! |---|---|
//! | 0 to 4 | one for each line |
//! | 5 to 9 | one for the group |
//! | 10 to 15 | one for the group |
//! | 16 | PVD |
//!
//! Not modelled: the event output (`EMR`), which wakes the core from `WFE`; lines 17 to 22, whose sources the board
//! does not use.

use rigless::device::{Device, DeviceContext, Level, RegisterFile, RequestChange};
use rigless::snapshot::store;
use rigless::soc::stm32f427::generated::{exti, syscfg};

/// The line of the programmable voltage detector.
pub const PVD_LINE: usize = 16;
/// Number of modelled lines.
const LINES: usize = 17;

/// First of the requests by which SYSCFG passes its port selection to the controller: `SELECTION | line << 8 | port`.
const SELECTION: usize = 0x1000;

/// Position of each line's interrupt in [`INTERRUPTS`].
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

/// Interrupt numbers of the instance (RM0090, table 62): TAMP_STAMP, EXTI0 to EXTI4, EXTI9_5 and EXTI15_10 as in ST's
/// file, and PVD, which is added here.
pub const INTERRUPTS: [u16; 9] = [2, 6, 7, 8, 9, 10, 23, 40, 1];

/// The controller.
#[derive(Debug, Default, serde::Serialize, serde::Deserialize)]
pub struct Exti {
    /// Selected port of each of lines 0 to 15, 0 for port A.
    ports: [u8; 16],
    /// Levels of the pins of ports A to I, one bit for each pin.
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

    /// Sets the level of a line that is not a pin: the voltage detector's.
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
            // The register file's rule has already cleared the bits that were written as one.
            exti::Register::Swier => {
                // RM0090, 12.3.5: a bit that goes from 0 to 1 while its line is unmasked sets the pending bit.
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
            // A line that is switched to another pin takes that pin's level without an edge.
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
        // The pins keep their levels; the controller is reset.
        let pins = self.pins;
        *self = Self { pins, ..Self::default() };
        for line in 0..16 {
            self.lines |= u32::from(pins[0] >> line & 1) << line;
        }
    }
}

/// Returns the number of a port, 0 for `GPIOA`.
fn port_of(instance: &str) -> Option<usize> {
    let letter = instance.strip_prefix("GPIO")?.bytes().next()?;
    Some(usize::from(letter.checked_sub(b'A')?)).filter(|&port| port < 9)
}

/// The system configuration controller. Only the port selection for [`Exti`] is modelled.
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
