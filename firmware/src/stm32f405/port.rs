//! The receiver's serial port, receive only.
//!
//! An interrupt reads each byte, stores it with its time in a queue, and the next tick (1 ms) processes it. With CRSF
//! that is up to 42 bytes. The port cannot buffer a second byte, so its interrupt has a higher priority than the
//! control loop; it takes about twenty instructions.
//!
//! The interrupt's vector depends on the board, so its handler is not an RTIC task, and RTIC cannot give it resources.
//! The handler gets its end of the queue from a static.

use core::cell::UnsafeCell;
use core::marker::PhantomData;

use heapless::spsc::{Consumer, Producer, Queue};
use receiver::Line;
use receiver::search::Received;
use stm32f4xx_hal::pac::usart1;

use super::deadline::now_us;

/// Connection of the receiver.
#[derive(Clone, Copy)]
pub struct Wiring {
    /// The serial port. USART1's register layout is used for all; the registers that UART4 and UART5 lack are not used
    /// (RM0090, 30.6).
    pub serial: *const usart1::RegisterBlock,
    /// Whether its clock is that of APB2.
    pub on_apb2: bool,
}

/// A board's wiring as a type, so that its values are compile-time constants where they are used.
pub trait HasWiring {
    /// The wiring.
    const RECEIVER: Wiring;
}

impl Wiring {
    fn regs(&self) -> &'static usart1::RegisterBlock {
        // SAFETY: the interrupt handler only reads status and data, the task only writes the control registers.
        unsafe { &*self.serial }
    }
}

/// Received bytes with their times, µs.
pub type Bytes = Queue<(u32, Received), 64>;

/// The interrupt's end of the queue, after the port is open.
struct ToQueue(UnsafeCell<Option<Producer<'static, (u32, Received)>>>);

// SAFETY: it is written once, before the port's interrupt is enabled; after that only the interrupt's handler uses it.
unsafe impl Sync for ToQueue {}

static TO_QUEUE: ToQueue = ToQueue(UnsafeCell::new(None));

/// Stores the received byte with its time. For the port's interrupt.
#[inline]
pub fn take_byte<W: HasWiring>() {
    let at_us = now_us();
    // Reading the status and then the data clears both.
    let status = W::RECEIVER.regs().sr().read();
    let byte = W::RECEIVER.regs().dr().read().bits() as u8;
    let damaged = status.pe().bit_is_set()
        || status.fe().bit_is_set()
        || status.nf().bit_is_set()
        || status.ore().bit_is_set();
    let received = if damaged { Received::Damaged } else { Received::Byte(byte) };
    // SAFETY: see `ToQueue`. The handler cannot interrupt itself.
    if let Some(queue) = unsafe { &mut *TO_QUEUE.0.get() } {
        // A full queue drops a byte. The frame is then invalid by its checksum or length.
        queue.enqueue((at_us, received)).ok();
    }
}

/// The task's end of the port.
pub struct Port<W> {
    bytes: Consumer<'static, (u32, Received)>,
    clock_hz: u32,
    wiring: PhantomData<W>,
}

impl<W: HasWiring> Port<W> {
    /// Opens the port with the settings in `line`. The pin must be connected. The two clocks are those of APB1 and
    /// APB2, Hz.
    pub fn open(bytes: &'static mut Bytes, line: Line, [apb1_hz, apb2_hz]: [u32; 2]) -> Self {
        let (producer, consumer) = bytes.split();
        // SAFETY: see `ToQueue`: the interrupt is not enabled yet.
        unsafe { *TO_QUEUE.0.get() = Some(producer) };
        let clock_hz = if W::RECEIVER.on_apb2 { apb2_hz } else { apb1_hz };
        let mut port = Self { bytes: consumer, clock_hz, wiring: PhantomData };
        port.set(line);
        port
    }

    /// Returns the next byte in the queue and the time when it came, µs.
    pub fn next(&mut self) -> Option<(u32, Received)> {
        self.bytes.dequeue()
    }

    /// Changes the settings to those in `line`, and discards the bytes in the queue. The polarity of the line is fixed
    /// by the board: this chip cannot invert it.
    pub fn set(&mut self, line: Line) {
        let regs = W::RECEIVER.regs();
        regs.cr1().reset();
        while self.bytes.dequeue().is_some() {}
        // With 16-fold oversampling, the register holds the clock divided by the baud rate, rounded to an
        // integer. Its last four bits are sixteenths.
        let divider = (self.clock_hz + line.baud / 2) / line.baud.max(1);
        // SAFETY: the divider is 100 or 200 for CRSF, 420 or 840 for SBUS, so it is within the register's range.
        regs.brr().write(|w| unsafe { w.bits(divider as u16) });
        let two_stop_bits = if line.stop_bits == 2 { 0b10 } else { 0b00 };
        // SAFETY: both values are valid.
        regs.cr2().write(|w| unsafe { w.stop().bits(two_stop_bits) });
        // The parity bit counts as a ninth data bit.
        regs.cr1().write(|w| {
            w.m().bit(line.even_parity).pce().bit(line.even_parity);
            w.rxneie().set_bit().re().set_bit().ue().set_bit()
        });
    }
}
