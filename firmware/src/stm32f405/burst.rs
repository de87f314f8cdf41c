//! Bursts of the inertial sensor: SPI1, received by DMA2 stream 0 channel 3, sent by stream 3 channel 3.
//!
//! ```text
//!  PA4 low │ stream 3 feeds 16 bytes, stream 0 takes 16 bytes: 12.2 µs at 10.5 MHz │ DMA2_STREAM0 │ PA4 high
//! ```
//! The end of reception is the end of the burst. Stream 0 raises DMA2_STREAM0 then, and after an error of its
//! own; an error of the other stream shows as a burst that does not end.
//!
//! DMA2_STREAM0 is a level: it stays up as long as a flag of stream 0 is set whose interrupt is on, and only a
//! write to LIFCR takes a flag down. [`BurstBus::acknowledge`] is that write.
//!
//! For its set-up the sensor has the same bus byte by byte ([`ImuSpi`]), with the requests for DMA off. Who may use
//! it when is in [`crate::sampling`].
//!
//! # Why not `dma::Transfer`
//! What `stm32f4xx-hal` 0.23 has for this was tried out: a `Transfer` for each stream, started again by
//! `next_transfer_with`. The data-ready interrupt then takes 75 instructions for each burst instead of 49, and is 84
//! instructions longer; it has two panics (the option in which the buffer is kept), and a wait without a limit
//! (`stream_disable`), none of which the fast loop may have. Its check of streams and channel at compile time is
//! kept.

use core::sync::atomic::AtomicU8;

use embedded_hal::delay::DelayNs;
use embedded_hal::spi::{ErrorKind, ErrorType, Operation, SpiDevice};

use drivers::icm42688p::{BURST, FRAME_LEN, Frame};
use stm32f4xx_hal::dma::traits::{DMASet, Stream};
use stm32f4xx_hal::dma::{MemoryToPeripheral, PeripheralToMemory, Stream0, Stream3};
use stm32f4xx_hal::gpio::{Output, PA4};
use stm32f4xx_hal::pac::dma2::st::cr;
use stm32f4xx_hal::pac::{DMA2, GPIOA, SPI1, dma2, gpioa, spi1};
use stm32f4xx_hal::rcc::{Enable, Rcc};
use stm32f4xx_hal::spi::Spi;

use crate::board;
use crate::sampling::{BurstBus, FrameBuffer, Signal};

/// The streams. The flags of [`ImuBus::acknowledge`] and [`clear_flags`] are those of these two numbers.
type Rx = Stream0<DMA2>;
type Tx = Stream3<DMA2>;
const CHANNEL: u8 = 3;

/// Compiles only if the chip connects this peripheral to this stream and channel.
const fn connected<PERIPHERAL, STREAM, const CHANNEL: u8, DIRECTION>()
where
    PERIPHERAL: DMASet<STREAM, CHANNEL, DIRECTION>,
{
}
const _: () = {
    connected::<SPI1, Rx, CHANNEL, PeripheralToMemory>();
    connected::<SPI1, Tx, CHANNEL, MemoryToPeripheral>();
};

/// Looks at a stream that was told to stop: it finishes its byte first, a microsecond.
const STOP_LOOKS: u32 = 200;
/// Looks for a byte that is on its way, which takes 0.8 µs; a look takes some 10 cycles, so that this is 60 µs.
const BYTE_LOOKS: u32 = 1_000;

// A variable, so that it is in RAM: what DMA sends, it need not fetch from flash.
static SENT: [AtomicU8; FRAME_LEN] = {
    let mut sent = [const { AtomicU8::new(0) }; FRAME_LEN];
    let mut n = 0;
    while n < FRAME_LEN {
        sent[n] = AtomicU8::new(BURST[n]);
        n += 1;
    }
    sent
};
static RECEIVED: FrameBuffer = FrameBuffer::new();

fn dma() -> &'static dma2::RegisterBlock {
    // SAFETY: only this module uses DMA2.
    unsafe { &*DMA2::ptr() }
}

fn spi() -> &'static spi1::RegisterBlock {
    // SAFETY: of the two that use it, `ImuBus` and `ImuSpi`, one has the bus at a time (`crate::sampling`).
    unsafe { &*SPI1::ptr() }
}

/// The sensor's chip select; the register's bits are independent of each other.
fn select(selected: bool) {
    // SAFETY: a write to this register changes no other pin.
    let gpioa: &gpioa::RegisterBlock = unsafe { &*GPIOA::ptr() };
    if selected {
        gpioa.bsrr().write(|w| w.br4().set_bit());
    } else {
        gpioa.bsrr().write(|w| w.bs4().set_bit());
    }
}

/// Takes down the flags of both streams: those of the last burst, and those that a stopped stream sets.
fn clear_flags() {
    dma().lifcr().write(|w| {
        w.ctcif0().clear().chtif0().clear().cteif0().clear().cdmeif0().clear().cfeif0().clear();
        w.ctcif3().clear().chtif3().clear().cteif3().clear().cdmeif3().clear().cfeif3().clear()
    });
}

/// What both streams have: bytes, from or to a buffer, before anything else on DMA2; on.
fn both(w: &mut cr::W) -> &mut cr::W {
    w.chsel().set(CHANNEL).pl().very_high().minc().incremented().en().enabled()
}

/// Starts a burst. For the data-ready interrupt, when no burst runs.
pub fn start() {
    select(true);
    let (rx, tx) = (dma().st(Rx::NUMBER), dma().st(Tx::NUMBER));
    clear_flags();
    rx.ndtr().write(|w| w.ndt().set(FRAME_LEN as u16));
    tx.ndtr().write(|w| w.ndt().set(FRAME_LEN as u16));
    rx.cr().write(|w| both(w).dir().peripheral_to_memory().tcie().enabled().teie().enabled());
    tx.cr().write(|w| both(w).dir().memory_to_peripheral());
}

/// Whether a burst runs.
pub fn running() -> bool {
    dma().st(Rx::NUMBER).cr().read().en().bit_is_set()
}

/// What is still in the SPI's registers goes: data and status read in this order take an overrun away too.
fn drain() {
    spi().dr().read();
    spi().sr().read();
}

/// The bus, byte by byte, for the sensor's set-up.
pub struct ImuSpi {
    _spi: Spi<SPI1>,
    _select: PA4<Output>,
}

/// A byte did not come: the peripheral has no clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Hangs;

impl embedded_hal::spi::Error for Hangs {
    fn kind(&self) -> ErrorKind {
        ErrorKind::Other
    }
}

impl ImuSpi {
    /// Takes the peripheral, which has been set up, and the sensor's chip select, which is high.
    pub fn new(spi: Spi<SPI1>, select: PA4<Output>) -> Self {
        Self { _spi: spi, _select: select }
    }

    /// Begins to use the bus.
    pub fn claim(&mut self) {
        spi().cr2().modify(|_, w| w.rxdmaen().clear_bit().txdmaen().clear_bit());
    }

    /// Leaves it to bursts.
    pub fn hand_over(&mut self) {
        drain();
        spi().cr2().modify(|_, w| w.rxdmaen().set_bit().txdmaen().set_bit());
    }
}

/// A byte out, a byte in.
fn exchange(byte: u8) -> Result<u8, Hangs> {
    spi().dr().write(|w| w.dr().set(byte.into()));
    for _ in 0..BYTE_LOOKS {
        if spi().sr().read().rxne().bit_is_set() {
            return Ok(spi().dr().read().bits() as u8);
        }
    }
    Err(Hangs)
}

impl ErrorType for ImuSpi {
    type Error = Hangs;
}

impl SpiDevice for ImuSpi {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Hangs> {
        drain();
        select(true);
        let result = operations.iter_mut().try_for_each(|operation| match operation {
            Operation::Read(received) => received.iter_mut().try_for_each(|byte| {
                *byte = exchange(0)?;
                Ok(())
            }),
            Operation::Write(sent) => sent.iter().try_for_each(|byte| exchange(*byte).map(drop)),
            Operation::Transfer(received, sent) => {
                for n in 0..received.len().max(sent.len()) {
                    let answer = exchange(sent.get(n).copied().unwrap_or(0))?;
                    if let Some(byte) = received.get_mut(n) {
                        *byte = answer;
                    }
                }
                Ok(())
            }
            Operation::TransferInPlace(bytes) => bytes.iter_mut().try_for_each(|byte| {
                *byte = exchange(*byte)?;
                Ok(())
            }),
            Operation::DelayNs(ns) => {
                board::Wait.delay_ns(*ns);
                Ok(())
            }
        });
        select(false);
        result
    }
}

/// The bus for bursts.
pub struct ImuBus {
    _dma: DMA2,
}

impl ImuBus {
    /// Prepares the streams.
    pub fn new(dma2: DMA2, rcc: &mut Rcc) -> Self {
        DMA2::enable(rcc);
        let (rx, tx) = (dma2.st(Rx::NUMBER), dma2.st(Tx::NUMBER));
        let data = spi().dr().as_ptr() as u32;
        // SAFETY: a register, and two statics.
        unsafe {
            rx.par().write(|w| w.pa().bits(data));
            tx.par().write(|w| w.pa().bits(data));
            rx.m0ar().write(|w| w.m0a().bits(RECEIVED.address()));
            tx.m0ar().write(|w| w.m0a().bits(SENT.as_ptr() as u32));
        }
        Self { _dma: dma2 }
    }
}

impl BurstBus for ImuBus {
    const SETS_UP: bool = true;

    #[inline]
    fn acknowledge(&mut self) -> Signal {
        let flags = dma().lisr().read();
        // A flag that rises after the read stays, and raises the interrupt again.
        dma().lifcr().write(|w| {
            w.ctcif0().bit(flags.tcif0().is_complete()).chtif0().bit(flags.htif0().is_half());
            w.cteif0().bit(flags.teif0().is_error()).cdmeif0().bit(flags.dmeif0().is_error());
            w.cfeif0().bit(flags.feif0().is_error())
        });
        if flags.teif0().is_error() {
            Signal::Failed
        } else if flags.tcif0().is_complete() {
            Signal::Done
        } else {
            Signal::Nothing
        }
    }

    #[inline]
    fn finish(&mut self) -> Frame {
        select(false);
        RECEIVED.read()
    }

    #[cold]
    fn abort(&mut self) {
        for stream in [Rx::NUMBER, Tx::NUMBER] {
            let stream = dma().st(stream);
            stream.cr().modify(|_, w| w.en().clear_bit());
            for _ in 0..STOP_LOOKS {
                if stream.cr().read().en().bit_is_clear() {
                    break;
                }
            }
        }
        select(false);
        spi().cr1().modify(|_, w| w.spe().clear_bit());
        drain();
        spi().cr1().modify(|_, w| w.spe().set_bit());
        // A stream that is stopped says that it is done.
        clear_flags();
    }
}
