//! Bursts of the inertial sensor: an SPI, received by one stream of DMA and sent by another.
//!
//! ```text
//!  select low │ a stream feeds 16 bytes, one takes 16 bytes: 12.2 µs at 10.5 MHz │ its vector │ select high
//! ```
//! The end of reception is the end of the burst. The receiving stream raises its vector then, and after an error of its
//! own; an error of the other stream shows as a burst that does not end.
//!
//! The vector is a level: it stays up as long as a flag of that stream is set whose interrupt is on, and only a write to
//! LIFCR or HIFCR takes a flag down. [`BurstBus::acknowledge`] is that write.
//!
//! For its set-up the sensor has the same bus byte by byte ([`ImuSpi`]), with the requests for DMA off. Who may use
//! it when is in [`tasks::sampling`].
//!
//! # Why not `dma::Transfer`
//! What `stm32f4xx-hal` 0.23 has for this was tried out: a `Transfer` for each stream, started again by
//! `next_transfer_with`. The data-ready interrupt then takes 75 instructions for each burst instead of 49, and is 84
//! instructions longer; it has two panics (the option in which the buffer is kept), and a wait without a limit
//! (`stream_disable`), none of which the fast loop may have. Its check of streams and channels at compile time is
//! kept: the board's wiring has one.

use core::marker::PhantomData;
use core::sync::atomic::AtomicU8;

use embedded_hal::delay::DelayNs;
use embedded_hal::spi::{ErrorKind, ErrorType, Operation, SpiDevice};

use drivers::icm42688p::{BURST_READ, FRAME_LEN, Frame};
use stm32f4xx_hal::pac::dma2::st::cr;
use stm32f4xx_hal::pac::spi1;
use tasks::sampling::{BurstBus, FrameBuffer, Signal};

use super::deadline::Wait;
use super::dma::Stream;
use super::pin::Pin;

/// How the sensor is connected.
#[derive(Clone, Copy)]
pub struct Wiring {
    /// Its SPI.
    pub spi: *const spi1::RegisterBlock,
    /// DMA of what comes.
    pub receive: Stream,
    /// DMA of what is sent.
    pub send: Stream,
    /// Its chip select.
    pub select: Pin,
}

/// A board's wiring as a type: so that all of it is constant where it is used.
pub trait HasWiring {
    /// It.
    const IMU: Wiring;
}

/// Looks for a byte that is on its way, which takes 0.8 µs; a look takes some 10 cycles, so that this is 60 µs.
const BYTE_LOOKS: u32 = 1_000;

// A variable, so that it is in RAM: what DMA sends, it need not fetch from flash.
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
        // SAFETY: of the two that use it, `ImuBus` and `ImuSpi`, one has the bus at a time (`tasks::sampling`).
        unsafe { &*self.spi }
    }

    /// The sensor listens, or does not.
    fn select(&self, selected: bool) {
        if selected {
            self.select.set_low();
        } else {
            self.select.set_high();
        }
    }

    /// Starts a burst. For the data-ready interrupt, when no burst runs.
    pub fn start(&self) {
        self.select(true);
        // Those of the last burst.
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

    /// Whether a burst runs.
    pub fn running(&self) -> bool {
        self.receive.runs()
    }

    /// What is still in the SPI's registers goes: data and status read in this order take an overrun away too.
    fn drain(&self) {
        self.spi().dr().read();
        self.spi().sr().read();
    }

    /// A byte out, a byte in.
    fn exchange(&self, byte: u8) -> Result<u8, Hangs> {
        self.spi().dr().write(|w| w.dr().set(byte.into()));
        for _ in 0..BYTE_LOOKS {
            if self.spi().sr().read().rxne().bit_is_set() {
                return Ok(self.spi().dr().read().bits() as u8);
            }
        }
        Err(Hangs)
    }
}

/// What both streams have: bytes, from or to a buffer, before anything else on their controller; on.
fn both(w: &mut cr::W, stream: Stream) -> &mut cr::W {
    w.chsel().set(stream.channel()).pl().very_high().minc().incremented().en().enabled()
}

/// The bus, byte by byte, for the sensor's set-up.
pub struct ImuSpi<W>(PhantomData<W>);

/// A byte did not come: the peripheral has no clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Hangs;

impl embedded_hal::spi::Error for Hangs {
    fn kind(&self) -> ErrorKind {
        ErrorKind::Other
    }
}

impl<W: HasWiring> ImuSpi<W> {
    /// The SPI has been set up, and the chip select is high.
    pub const fn new() -> Self {
        Self(PhantomData)
    }

    /// Begins to use the bus.
    pub fn claim(&mut self) {
        W::IMU.spi().cr2().modify(|_, w| w.rxdmaen().clear_bit().txdmaen().clear_bit());
    }

    /// Leaves it to bursts.
    pub fn hand_over(&mut self) {
        W::IMU.drain();
        W::IMU.spi().cr2().modify(|_, w| w.rxdmaen().set_bit().txdmaen().set_bit());
    }
}

impl<W> ErrorType for ImuSpi<W> {
    type Error = Hangs;
}

impl<W: HasWiring> SpiDevice for ImuSpi<W> {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Hangs> {
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
                Wait.delay_ns(*ns);
                Ok(())
            }
        });
        wiring.select(false);
        result
    }
}

/// The bus for bursts.
pub struct ImuBus<W>(PhantomData<W>);

impl<W: HasWiring> ImuBus<W> {
    /// Prepares the streams, whose controller's clock runs.
    pub fn new() -> Self {
        let wiring = W::IMU;
        let (receive, send) = (wiring.receive.registers(), wiring.send.registers());
        let data = wiring.spi().dr().as_ptr() as u32;
        // SAFETY: a register, and two statics.
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
    const SETS_UP: bool = true;

    #[inline]
    fn acknowledge(&mut self) -> Signal {
        let flags = W::IMU.receive.flags();
        // A flag that rises after the read stays, and raises the interrupt again.
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
        // What has been handed to the SPI still goes out, and what comes in for it would be the next burst's first byte.
        for _ in 0..BYTE_LOOKS {
            if wiring.spi().sr().read().bsy().bit_is_clear() {
                break;
            }
        }
        wiring.receive.stop();
        wiring.select(false);
        wiring.drain();
    }
}
