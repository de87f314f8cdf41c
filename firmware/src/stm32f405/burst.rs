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

use core::sync::atomic::AtomicU8;

use drivers::icm42688p::{BURST, FRAME_LEN, Frame};
use stm32f4xx_hal::dma::traits::{DMASet, Stream};
use stm32f4xx_hal::dma::{MemoryToPeripheral, PeripheralToMemory, Stream0, Stream3};
use stm32f4xx_hal::pac::dma2::st::cr;
use stm32f4xx_hal::pac::{DMA2, GPIOA, SPI1, dma2, gpioa, spi1};
use stm32f4xx_hal::rcc::{Enable, Rcc};

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
    // SAFETY: the sensor's driver has handed the bus over.
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

/// The bus, handed over by the sensor's driver (`None` if it has not found the sensor) for good.
pub struct ImuBus<SPI> {
    _spi: Option<SPI>,
}

impl<SPI> ImuBus<SPI> {
    /// Prepares the streams.
    pub fn new(spi_device: Option<SPI>, dma2: DMA2, rcc: &mut Rcc) -> Self {
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
        spi().cr2().modify(|_, w| w.rxdmaen().set_bit().txdmaen().set_bit());
        Self { _spi: spi_device }
    }
}

impl<SPI> BurstBus for ImuBus<SPI> {
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
        // What is still in the SPI's registers goes: data and status read in this order take an overrun away too.
        spi().cr1().modify(|_, w| w.spe().clear_bit());
        spi().dr().read();
        spi().sr().read();
        spi().cr1().modify(|_, w| w.spe().set_bit());
        // A stream that is stopped says that it is done.
        clear_flags();
    }
}
