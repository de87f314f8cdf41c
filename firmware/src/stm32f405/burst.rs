//! Bursts of the IMU: one SPI, with one DMA stream for reception and one for transmission.
//!
//! ```text
//!  select low │ one stream sends 16 bytes, one receives 16 bytes: 12.2 µs at 10.5 MHz │ its vector │ select high
//! ```
//! The end of reception is the end of the burst. At that time the receiving stream raises its vector. It also does so
//! after an error of its own. An error of the sending stream shows as a burst that does not end.
//!
//! The vector is a level: it stays raised as long as a flag of the stream is set whose interrupt is enabled. Only a
//! write to LIFCR or HIFCR clears a flag. [`BurstBus::acknowledge`] does that write.
//!
//! During the set-up, the IMU is accessed byte by byte on the same bus ([`ImuSpi`]), with the DMA requests disabled.
//! [`tasks::sampling`] controls which of the two may use the bus.
//!
//! # Why not `dma::Transfer`
//! The `Transfer` of `stm32f4xx-hal` 0.23 was tried: one for each stream, started again by `next_transfer_with`. The
//! data-ready interrupt then takes 75 instructions for each burst instead of 49, and is 84 instructions longer. It also
//! has two panics (the option that holds the buffer) and a wait without a limit (`stream_disable`), which the fast loop
//! must not have. This driver keeps its compile-time check of streams and channels: the board's wiring has one.

use core::marker::PhantomData;
use core::sync::atomic::AtomicU8;

use embedded_hal::delay::DelayNs;
use embedded_hal::spi::{ErrorKind, ErrorType, Operation, SpiDevice};

use drivers::icm42688p::{BURST_READ, FRAME_LEN, Frame};
use stm32f4xx_hal::pac::dma2::st::cr;
use stm32f4xx_hal::pac::spi1;
use tasks::sampling::{BurstBus, FrameBuffer, Signal};

use super::deadline::Delay;
use super::dma::Stream;
use super::pin::Pin;

/// The IMU's connections.
#[derive(Clone, Copy)]
pub struct Wiring {
    /// The IMU's SPI.
    pub spi: *const spi1::RegisterBlock,
    /// DMA stream of received bytes.
    pub receive: Stream,
    /// DMA stream of sent bytes.
    pub send: Stream,
    /// The IMU's chip select.
    pub select: Pin,
}

/// A board's wiring as a type, so that its values are compile-time constants where they are used.
pub trait HasWiring {
    /// The wiring.
    const IMU: Wiring;
}

/// Polls for a byte, which takes 0.8 µs to transfer. A poll takes about 10 cycles: 1,000 polls are 60 µs.
const BYTE_POLLS: u32 = 1_000;

// An atomic, so that it is in RAM: DMA then does not read the sent bytes from flash.
static SENT: [AtomicU8; FRAME_LEN] = {
    let mut sent = [const { AtomicU8::new(0) }; FRAME_LEN];
    let mut n = 0;
    while n < FRAME_LEN {
        sent[n] = AtomicU8::new(BURST_READ[n]);
        n += 1;
    }
    sent
};
static RECEIVED: FrameBuffer = FrameBuffer::new();

impl Wiring {
    fn spi(&self) -> &'static spi1::RegisterBlock {
        // SAFETY: `ImuBus` and `ImuSpi` use it, and only one of them owns the bus at a time (`tasks::sampling`).
        unsafe { &*self.spi }
    }

    /// Drives the chip select.
    fn select(&self, selected: bool) {
        if selected {
            self.select.set_low();
        } else {
            self.select.set_high();
        }
    }

    /// Starts a burst. The data-ready interrupt calls this if no burst is running.
    pub fn start(&self) {
        self.select(true);
        // Clear the flags of the previous burst.
        self.receive.clear_all();
        self.send.clear_all();
        let (receive, send) = (self.receive.registers(), self.send.registers());
        receive.ndtr().write(|w| w.ndt().set(FRAME_LEN as u16));
        send.ndtr().write(|w| w.ndt().set(FRAME_LEN as u16));
        receive
            .cr()
            .write(|w| both(w, self.receive).dir().peripheral_to_memory().tcie().enabled().teie().enabled());
        send.cr().write(|w| both(w, self.send).dir().memory_to_peripheral());
    }

    /// Returns whether a burst is running.
    pub fn running(&self) -> bool {
        self.receive.runs()
    }

    /// Empties the SPI's receive register. Reading data and status in this order also clears an overrun.
    fn drain(&self) {
        self.spi().dr().read();
        self.spi().sr().read();
    }

    /// Sends a byte and returns the byte received meanwhile.
    fn exchange(&self, byte: u8) -> Result<u8, Timeout> {
        self.spi().dr().write(|w| w.dr().set(byte.into()));
        for _ in 0..BYTE_POLLS {
            if self.spi().sr().read().rxne().bit_is_set() {
                return Ok(self.spi().dr().read().bits() as u8);
            }
        }
        Err(Timeout)
    }
}

/// Settings of both streams: bytes, from or to a buffer, highest priority on the controller, enabled.
fn both(w: &mut cr::W, stream: Stream) -> &mut cr::W {
    w.chsel().set(stream.channel()).pl().very_high().minc().incremented().en().enabled()
}

/// The IMU's bus byte by byte, for the set-up.
pub struct ImuSpi<W>(PhantomData<W>);

/// A byte was not received in time: the SPI has no clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Timeout;

impl embedded_hal::spi::Error for Timeout {
    fn kind(&self) -> ErrorKind {
        ErrorKind::Other
    }
}

impl<W: HasWiring> ImuSpi<W> {
    /// Takes an SPI that is already set up, with the chip select high.
    pub const fn new() -> Self {
        Self(PhantomData)
    }

    /// Takes the bus from the bursts: disables the DMA requests.
    pub fn claim(&mut self) {
        W::IMU.spi().cr2().modify(|_, w| w.rxdmaen().clear_bit().txdmaen().clear_bit());
    }

    /// Gives the bus back to the bursts: enables the DMA requests.
    pub fn hand_over(&mut self) {
        W::IMU.drain();
        W::IMU.spi().cr2().modify(|_, w| w.rxdmaen().set_bit().txdmaen().set_bit());
    }
}

impl<W> ErrorType for ImuSpi<W> {
    type Error = Timeout;
}

impl<W: HasWiring> SpiDevice for ImuSpi<W> {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Timeout> {
        let wiring = W::IMU;
        wiring.drain();
        wiring.select(true);
        let result = operations.iter_mut().try_for_each(|operation| match operation {
            Operation::Read(received) => received.iter_mut().try_for_each(|byte| {
                *byte = wiring.exchange(0)?;
                Ok(())
            }),
            Operation::Write(sent) => sent.iter().try_for_each(|byte| wiring.exchange(*byte).map(drop)),
            Operation::Transfer(received, sent) => {
                for n in 0..received.len().max(sent.len()) {
                    let answer = wiring.exchange(sent.get(n).copied().unwrap_or(0))?;
                    if let Some(byte) = received.get_mut(n) {
                        *byte = answer;
                    }
                }
                Ok(())
            }
            Operation::TransferInPlace(bytes) => bytes.iter_mut().try_for_each(|byte| {
                *byte = wiring.exchange(*byte)?;
                Ok(())
            }),
            Operation::DelayNs(ns) => {
                Delay.delay_ns(*ns);
                Ok(())
            }
        });
        wiring.select(false);
        result
    }
}

/// The IMU's bus for bursts.
pub struct ImuBus<W>(PhantomData<W>);

impl<W: HasWiring> ImuBus<W> {
    /// Prepares the streams. The clock of their DMA controller must be running.
    pub fn new() -> Self {
        let wiring = W::IMU;
        let (receive, send) = (wiring.receive.registers(), wiring.send.registers());
        let data = wiring.spi().dr().as_ptr() as u32;
        // SAFETY: the addresses of a register and of two statics.
        unsafe {
            receive.par().write(|w| w.pa().bits(data));
            send.par().write(|w| w.pa().bits(data));
            receive.m0ar().write(|w| w.m0a().bits(RECEIVED.address()));
            send.m0ar().write(|w| w.m0a().bits(SENT.as_ptr() as u32));
        }
        Self(PhantomData)
    }
}

impl<W: HasWiring> BurstBus for ImuBus<W> {
    const SUPPORTS_SETUP: bool = true;

    #[inline]
    fn acknowledge(&mut self) -> Signal {
        let flags = W::IMU.receive.flags();
        // A flag that rises after the read stays set, and raises the interrupt again.
        W::IMU.receive.clear(flags);
        if flags.is_error() {
            Signal::Failed
        } else if flags.is_complete() {
            Signal::Done
        } else {
            Signal::Nothing
        }
    }

    #[inline]
    fn finish(&mut self) -> Frame {
        W::IMU.select(false);
        RECEIVED.read()
    }

    #[cold]
    fn abort(&mut self) {
        let wiring = W::IMU;
        wiring.send.stop();
        // The SPI still sends a byte that it already has. The byte that it receives meanwhile would become the first
        // byte of the next burst.
        for _ in 0..BYTE_POLLS {
            if wiring.spi().sr().read().bsy().bit_is_clear() {
                break;
            }
        }
        wiring.receive.stop();
        wiring.select(false);
        wiring.drain();
    }
}
