//! The receiver's port: USART2, which only listens.
//!
//! Each byte is taken by an interrupt, with the time, and waits in a queue until the next tick (1 ms). At CRSF's
//! speed that is up to 42 bytes. The port has no room for a second byte, so its interrupt comes before the flight
//! task; it takes some thirty instructions.

use heapless::spsc::{Consumer, Producer, Queue};
use receiver::Line;
use stm32f4xx_hal::pac::{USART2, usart1};
use stm32f4xx_hal::rcc::{Enable, Rcc};

use crate::board;
use crate::pilot::Heard;

/// Bytes that wait, and their times (µs).
pub type Bytes = Queue<(u32, Heard), 64>;

fn regs() -> &'static usart1::RegisterBlock {
    // SAFETY: `open` has taken the peripheral; of its two sides one only reads status and data, the other only
    // writes the control registers.
    unsafe { &*USART2::ptr() }
}

/// The interrupt's side.
pub struct Ear {
    bytes: Producer<'static, (u32, Heard)>,
}

impl Ear {
    /// Takes the byte that has come.
    #[inline]
    pub fn hear(&mut self) {
        let at_us = board::now_us();
        // Reading the status, then the data, clears both.
        let status = regs().sr().read();
        let byte = regs().dr().read().bits() as u8;
        let damaged = status.pe().bit_is_set()
            || status.fe().bit_is_set()
            || status.nf().bit_is_set()
            || status.ore().bit_is_set();
        let heard = if damaged { Heard::Damaged } else { Heard::Byte(byte) };
        // A queue that is full loses a byte, and with it a frame, whose checksum or length is wrong then.
        self.bytes.enqueue((at_us, heard)).ok();
    }
}

/// The tick's side.
pub struct Port {
    bytes: Consumer<'static, (u32, Heard)>,
    apb1_hz: u32,
}

/// Takes the port, and listens as `line` says.
pub fn open(_usart: USART2, bytes: &'static mut Bytes, line: Line, rcc: &mut Rcc) -> (Ear, Port) {
    USART2::enable(rcc);
    let (producer, consumer) = bytes.split();
    let mut port = Port { bytes: consumer, apb1_hz: rcc.clocks.pclk1().raw() };
    port.set(line);
    (Ear { bytes: producer }, port)
}

impl Port {
    /// The next byte that waits, and when it came (µs).
    pub fn next(&mut self) -> Option<(u32, Heard)> {
        self.bytes.dequeue()
    }

    /// Listens as `line` says from now on. What waits is forgotten. The line's polarity is up to the board: this
    /// chip cannot turn it.
    pub fn set(&mut self, line: Line) {
        let regs = regs();
        regs.cr1().reset();
        while self.bytes.dequeue().is_some() {}
        // With 16-fold oversampling the register is the clock over the speed, in sixteenths: to the nearest one.
        let divider = (self.apb1_hz + line.baud / 2) / line.baud.max(1);
        // SAFETY: 100 for CRSF, 420 for SBUS: within the register.
        regs.brr().write(|w| unsafe { w.bits(divider as u16) });
        let two_stop_bits = if line.stop_bits == 2 { 0b10 } else { 0b00 };
        // SAFETY: both values are valid.
        regs.cr2().write(|w| unsafe { w.stop().bits(two_stop_bits) });
        // A parity bit counts as a ninth data bit.
        regs.cr1().write(|w| {
            w.m().bit(line.even_parity).pce().bit(line.even_parity);
            w.rxneie().set_bit().re().set_bit().ue().set_bit()
        });
    }
}
