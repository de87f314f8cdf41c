//! Bursts of the inertial sensor: SPI1, received by DMA2 stream 0 channel 3, sent by stream 3 channel 3.
//!
//! ```text
//!  PA4 low │ stream 3 feeds 16 bytes, stream 0 takes 16 bytes: 12.2 µs at 10.5 MHz │ DMA2_STREAM0 │ PA4 high
//! ```
//! The end of reception is the end of the burst. Stream 0 raises DMA2_STREAM0 then, and after an error of its
//! own; an error of the other stream shows as a burst that does not end.

use core::sync::atomic::AtomicU8;

use drivers::icm42688p::{BURST, FRAME_LEN};
use stm32f4xx_hal::pac::{DMA2, GPIOA, SPI1, dma2, gpioa, spi1};
use stm32f4xx_hal::rcc::{Enable, Rcc};

use crate::sampling::{Burst, BurstBus, FrameBuffer};

/// Flags of streams 0 and 3 in the lower interrupt registers.
const RX_DONE: u32 = 1 << 5;
const RX_FAILED: u32 = 1 << 3;
const ALL_FLAGS: u32 = 0x3d | 0x3d << 22;

/// Channel 3; very high priority; memory incremented; and a stream's direction and interrupts.
const COMMON: u32 = 3 << 25 | 3 << 16 | 1 << 10;
/// Transfer complete and transfer error interrupt; peripheral to memory; on.
const RX: u32 = COMMON | 1 << 4 | 1 << 2 | 1;
/// Memory to peripheral; on.
const TX: u32 = COMMON | 1 << 6 | 1;

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

/// Starts a burst. For the data-ready interrupt, when no burst runs.
pub fn start() {
    select(true);
    let (rx, tx) = (dma().st(0), dma().st(3));
    // SAFETY: the register ignores zeros.
    dma().lifcr().write(|w| unsafe { w.bits(ALL_FLAGS) });
    rx.ndtr().write(|w| w.ndt().set(FRAME_LEN as u16));
    tx.ndtr().write(|w| w.ndt().set(FRAME_LEN as u16));
    // SAFETY: the streams' fields; where they point was set in `new`.
    unsafe {
        rx.cr().write(|w| w.bits(RX));
        tx.cr().write(|w| w.bits(TX));
    }
}

/// Whether a burst runs.
pub fn running() -> bool {
    dma().st(0).cr().read().en().bit_is_set()
}

/// The bus, handed over by the sensor's driver (`None` if it has not found the sensor) for good.
pub struct ImuBus<SPI> {
    _spi: Option<SPI>,
}

impl<SPI> ImuBus<SPI> {
    /// Prepares the streams.
    pub fn new(spi_device: Option<SPI>, dma2: DMA2, rcc: &mut Rcc) -> Self {
        DMA2::enable(rcc);
        let (rx, tx) = (dma2.st(0), dma2.st(3));
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
    fn look(&mut self) -> Burst {
        let flags = dma().lisr().read().bits();
        if flags & RX_FAILED != 0 {
            self.abort();
            return Burst::Failed;
        }
        if flags & RX_DONE == 0 {
            return Burst::Running;
        }
        select(false);
        Burst::Done(RECEIVED.read())
    }

    #[cold]
    fn abort(&mut self) {
        for stream in [0, 3] {
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
        // SAFETY: the register ignores zeros.
        dma().lifcr().write(|w| unsafe { w.bits(ALL_FLAGS) });
    }
}
