//! Every interrupt handler serves its source: no vector is entered again while its source has been asserted ever since
//! it was entered before.
//!
//! A peripheral's interrupt is a level. A handler that returns without taking it down is entered again at once, and
//! everything below its priority starves.

use rigless::mcu::Mcu as _;
use rigless::soc::stm32f427::generated::{dma2, exti, tim2, usart6};

use crate::board::Machine;
use crate::firmware::Firmware;

/// A vector whose source can be looked at.
struct Vector {
    name: &'static str,
    entry: u64,
    /// First address and length of the registers by which the source is served.
    registers: (u64, u64),
    asserted: fn(&Machine) -> bool,
    /// It was asserted when the handler was entered last, and has been since.
    unserved: bool,
    entered_again: u64,
    first_ns: u64,
}

/// Table 62 of RM0090: number, name, registers, and whether the line is up.
type Row = (u16, &'static str, (u64, u64), fn(&Machine) -> bool);

const SOURCES: [Row; 4] = [
    (10, "EXTI4", (0x4001_3c00, 0x400), |machine| {
        let Some(exti) = machine.bus().registers("EXTI") else { return false };
        exti.get(exti::Register::Pr) & exti.get(exti::Register::Imr) & 1 << 4 != 0
    }),
    (38, "USART2", (0x4000_4400, 0x400), |machine| {
        let Some(usart) = machine.bus().registers("USART2") else { return false };
        let received = usart6::sr::RXNE.mask() | usart6::sr::ORE.mask();
        usart6::cr1::RXNEIE.is_set(usart.get(usart6::Register::Cr1))
            && usart.get(usart6::Register::Sr) & received != 0
    }),
    (50, "TIM5", (0x4000_0c00, 0x400), |machine| {
        let Some(tim5) = machine.bus().registers("TIM5") else { return false };
        tim5.get(tim2::Register::Sr) & tim5.get(tim2::Register::Dier) & 0x5f != 0
    }),
    (56, "DMA2_STREAM0", (0x4002_6400, 0x400), |machine| {
        let Some(dma) = machine.bus().registers("DMA2") else { return false };
        let (status, control) = (dma.get(dma2::Register::Lisr), dma.get(dma2::Register::S0cr));
        (dma2::lisr::TCIF0.is_set(status) && dma2::s0cr::TCIE.is_set(control))
            || (dma2::lisr::HTIF0.is_set(status) && dma2::s0cr::HTIE.is_set(control))
            || (dma2::lisr::TEIF0.is_set(status) && dma2::s0cr::TEIE.is_set(control))
            || (dma2::lisr::DMEIF0.is_set(status) && dma2::s0cr::DMEIE.is_set(control))
    }),
];

/// All vectors that are watched.
pub struct Vectors(Vec<Vector>);

impl Vectors {
    /// The vectors of an image.
    pub fn new(firmware: &Firmware) -> Self {
        let vector = |(number, name, registers, asserted): Row| {
            let entry = firmware.handler(16 + number)?;
            Some(Vector { name, entry, registers, asserted, unserved: false, entered_again: 0, first_ns: 0 })
        };
        Self(SOURCES.into_iter().filter_map(vector).collect())
    }

    /// A handler is entered.
    pub fn entered(&mut self, machine: &Machine, address: u64, now_ns: u64) {
        let Some(vector) = self.0.iter_mut().find(|vector| vector.entry == address) else { return };
        if vector.unserved {
            if vector.entered_again == 0 {
                vector.first_ns = now_ns;
            }
            vector.entered_again += 1;
        }
        vector.unserved = (vector.asserted)(machine);
    }

    /// The firmware has accessed a register.
    pub fn accessed(&mut self, machine: &Machine, address: u64) {
        for vector in &mut self.0 {
            let (from, bytes) = vector.registers;
            if vector.unserved && (from..from + bytes).contains(&address) && !(vector.asserted)(machine) {
                vector.unserved = false;
            }
        }
    }

    /// Whether anything was wrong so far.
    pub fn is_unserved(&self) -> bool {
        self.0.iter().any(|vector| vector.entered_again > 0)
    }

    /// What was wrong.
    pub fn into_complaints(self) -> Vec<String> {
        let again = self.0.into_iter().filter(|vector| vector.entered_again > 0);
        again
            .map(|vector| {
                format!(
                    "{} was entered again {} times while its source was unserved, first at {:.6} s",
                    vector.name,
                    vector.entered_again,
                    vector.first_ns as f64 * 1e-9
                )
            })
            .collect()
    }
}
