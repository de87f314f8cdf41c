//! A check that each interrupt handler serves its source: a vector must not be entered again while its source has stayed
//! asserted since the last entry.
//!
//! A peripheral's interrupt is a level. If a handler returns without clearing it, the handler is entered again at once, and
//! code of lower priority never runs.

use rigless::mcu::Mcu as _;
use rigless::soc::stm32f427::generated::{dma2, exti, tim2, usart6};

use crate::board::{Machine, Wiring};
use crate::firmware::Firmware;
use crate::timing::Handler;

/// A source of interrupts.
enum Source {
    /// A line of EXTI.
    Line(u8),
    /// The receiver's serial port.
    Serial(String),
    /// The deadline timer.
    Deadline,
    /// The DMA stream of the IMU's burst.
    Burst,
}

impl Source {
    /// Returns the peripheral whose registers serve the source.
    fn instance(&self) -> &str {
        match self {
            Self::Line(_) => "EXTI",
            Self::Serial(name) => name,
            Self::Deadline => "TIM5",
            Self::Burst => "DMA2",
        }
    }

    /// Returns whether the source is asserted: an interrupt is enabled and its flag is set (RM0090).
    fn asserted(&self, machine: &Machine) -> bool {
        let Some(registers) = machine.bus().registers(self.instance()) else { return false };
        match self {
            Self::Line(line) => {
                registers.get(exti::Register::Pr) & registers.get(exti::Register::Imr) & 1 << line != 0
            }
            Self::Serial(_) => {
                let received = usart6::sr::RXNE.mask() | usart6::sr::ORE.mask();
                usart6::cr1::RXNEIE.is_set(registers.get(usart6::Register::Cr1))
                    && registers.get(usart6::Register::Sr) & received != 0
            }
            Self::Deadline => {
                registers.get(tim2::Register::Sr) & registers.get(tim2::Register::Dier) & 0x5f != 0
            }
            Self::Burst => {
                let (status, control) =
                    (registers.get(dma2::Register::Lisr), registers.get(dma2::Register::S0cr));
                (dma2::lisr::TCIF0.is_set(status) && dma2::s0cr::TCIE.is_set(control))
                    || (dma2::lisr::HTIF0.is_set(status) && dma2::s0cr::HTIE.is_set(control))
                    || (dma2::lisr::TEIF0.is_set(status) && dma2::s0cr::TEIE.is_set(control))
                    || (dma2::lisr::DMEIF0.is_set(status) && dma2::s0cr::DMEIE.is_set(control))
            }
        }
    }
}

/// A vector whose source is observed.
struct Vector {
    name: &'static str,
    entry: u64,
    source: Source,
    /// Whether the source has been asserted since the last entry of the handler.
    unserved: bool,
    entered_again: u64,
    first_ns: u64,
}

/// All observed vectors.
pub struct Vectors(Vec<Vector>);

impl Vectors {
    /// Returns the observed vectors of an image for a board.
    pub fn new(firmware: &Firmware, wiring: &Wiring) -> Self {
        let [ready, receive, overdue, flight, ..] = wiring.handlers;
        let vector = |handler: Handler, source| {
            let entry = firmware.handler(handler.exception)?;
            let name = handler.vector;
            Some(Vector { name, entry, source, unserved: false, entered_again: 0, first_ns: 0 })
        };
        let serial = wiring.board.receiver.peripheral.clone();
        let all = [
            vector(ready, Source::Line(wiring.board.imu.ready.number)),
            vector(receive, Source::Serial(serial)),
            vector(overdue, Source::Deadline),
            vector(flight, Source::Burst),
        ];
        Self(all.into_iter().flatten().collect())
    }

    /// Checks the vector whose handler is entered at `address`.
    pub fn on_entry(&mut self, machine: &Machine, address: u64, now_ns: u64) {
        let Some(vector) = self.0.iter_mut().find(|vector| vector.entry == address) else { return };
        if vector.unserved {
            if vector.entered_again == 0 {
                vector.first_ns = now_ns;
            }
            vector.entered_again += 1;
        }
        vector.unserved = vector.source.asserted(machine);
    }

    /// Updates the state of the sources after an access to a register.
    pub fn on_access(&mut self, machine: &Machine, address: u64) {
        for vector in &mut self.0 {
            if vector.unserved
                && machine.part.addresses(vector.source.instance()).contains(&address)
                && !vector.source.asserted(machine)
            {
                vector.unserved = false;
            }
        }
    }

    /// Returns whether a vector was entered again with an unserved source.
    pub fn is_unserved(&self) -> bool {
        self.0.iter().any(|vector| vector.entered_again > 0)
    }

    /// Returns the violations, one line each.
    pub fn into_violations(self) -> Vec<String> {
        let again = self.0.into_iter().filter(|vector| vector.entered_again > 0);
        again
            .map(|vector| {
                format!(
                    "{}: entered again {} times with an unserved source, first at {:.6} s",
                    vector.name,
                    vector.entered_again,
                    vector.first_ns as f64 * 1e-9
                )
            })
            .collect()
    }
}
