//! The receiver's port: a serial port, which only listens.
//!
//! Each byte is taken by an interrupt, with the time, and waits in a queue until the next tick (1 ms). At CRSF's
//! speed that is up to 42 bytes. The port has no room for a second byte, so its interrupt comes before the flight
//! task; it takes some twenty instructions.
//!
//! The interrupt's vector depends on the board, and so its handler is the board's and no task of RTIC's, which hands its
//! tasks what they have. The handler finds its end of the queue in a static.

use core::cell::UnsafeCell;
use core::marker::PhantomData;

use heapless::spsc::{Consumer, Producer, Queue};
use receiver::Line;
use receiver::search::Received;
use stm32f4xx_hal::pac::usart1;

use super::deadline::now_us;

/// Where the receiver's bytes come in.
#[derive(Clone, Copy)]
pub struct Wiring {
    /// The serial port. USART1's registers are those of all: what UART4 and UART5 lack is not used (RM0090, 30.6).
    pub serial: *const usart1::RegisterBlock,
    /// Its clock is that of APB2.
    pub on_apb2: bool,
}

/// A board's wiring as a type: so that all of it is constant where it is used.
pub trait HasWiring {
    /// It.
    const RECEIVER: Wiring;
}

impl Wiring {
    fn regs(&self) -> &'static usart1::RegisterBlock {
        // SAFETY: of its two sides one only reads status and data, the other only writes the control registers.
        unsafe { &*self.serial }
    }
}

/// Bytes that wait, and their times (µs).
pub type Bytes = Queue<(u32, Received), 64>;

/// The interrupt's end of the queue, once the port is open.
struct ToQueue(UnsafeCell<Option<Producer<'static, (u32, Received)>>>);

// SAFETY: it is written to once, before the port's interrupt is let in, and then only that interrupt's handler has it.
unsafe impl Sync for ToQueue {}

static TO_QUEUE: ToQueue = ToQueue(UnsafeCell::new(None));

/// Takes the byte that has come: for the port's interrupt.
#[inline]
pub fn take_byte<W: HasWiring>() {
    let at_us = now_us();
    // Reading the status, then the data, clears both.
    let status = W::RECEIVER.regs().sr().read();
    let byte = W::RECEIVER.regs().dr().read().bits() as u8;
    let damaged = status.pe().bit_is_set()
        || status.fe().bit_is_set()
        || status.nf().bit_is_set()
        || status.ore().bit_is_set();
    let received = if damaged { Received::Damaged } else { Received::Byte(byte) };
    // SAFETY: see `ToQueue`. The handler does not interrupt itself.
    if let Some(queue) = unsafe { &mut *TO_QUEUE.0.get() } {
        // A queue that is full loses a byte, and with it a frame, whose checksum or length is wrong then.
        queue.enqueue((at_us, received)).ok();
    }
}

/// The tick's side.
pub struct Port<W> {
    bytes: Consumer<'static, (u32, Received)>,
    clock_hz: u32,
    wiring: PhantomData<W>,
}

impl<W: HasWiring> Port<W> {
    /// Listens as `line` says, at a port whose pin is connected, with the clocks of APB1 and APB2.
    pub fn open(bytes: &'static mut Bytes, line: Line, [apb1_hz, apb2_hz]: [u32; 2]) -> Self {
        let (producer, consumer) = bytes.split();
        // SAFETY: see `ToQueue`: the interrupt has not been let in yet.
        unsafe { *TO_QUEUE.0.get() = Some(producer) };
        let clock_hz = if W::RECEIVER.on_apb2 { apb2_hz } else { apb1_hz };
        let mut port = Self { bytes: consumer, clock_hz, wiring: PhantomData };
        port.set(line);
        port
    }

    /// The next byte that waits, and when it came (µs).
    pub fn next(&mut self) -> Option<(u32, Received)> {
        self.bytes.dequeue()
    }

    /// Listens as `line` says from now on. What waits is forgotten. The line's polarity is up to the board: this
    /// chip cannot turn it.
    pub fn set(&mut self, line: Line) {
        let regs = W::RECEIVER.regs();
        regs.cr1().reset();
        while self.bytes.dequeue().is_some() {}
        // With 16-fold oversampling the register is the clock over the speed, in sixteenths: to the nearest one.
        let divider = (self.clock_hz + line.baud / 2) / line.baud.max(1);
        // SAFETY: 100 or 200 for CRSF, 420 or 840 for SBUS: within the register.
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
