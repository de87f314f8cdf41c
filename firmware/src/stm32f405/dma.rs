//! A DMA stream by its number: the register description has a differently named field for each stream's flags.

use stm32f4xx_hal::pac::dma2;

/// A stream, with the request channel of its peripheral.
#[derive(Clone, Copy)]
pub struct Stream {
    controller: *const dma2::RegisterBlock,
    number: u8,
    channel: u8,
}

// SAFETY: the type holds an address of registers and two numbers.
unsafe impl Sync for Stream {}

/// Flags of a stream, in the order of its six bits in LISR and HISR, and in LIFCR and HIFCR (RM0090, 10.5.1 to 10.5.4).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Flags(u32);

impl Flags {
    /// FEIF, DMEIF, TEIF, HTIF and TCIF; bit 1 is reserved.
    const ALL: Self = Self(0b11_1101);
    const TRANSFER_ERROR: u32 = 1 << 3;
    const COMPLETE: u32 = 1 << 5;

    /// Returns whether the transfer ended with an error.
    #[inline(always)]
    #[cfg_attr(feature = "simulated", expect(dead_code, reason = "no sensor is wired there"))]
    pub fn is_error(self) -> bool {
        self.0 & Self::TRANSFER_ERROR != 0
    }

    /// Returns whether the transfer is complete.
    #[inline(always)]
    #[cfg_attr(feature = "simulated", expect(dead_code, reason = "no sensor is wired there"))]
    pub fn is_complete(self) -> bool {
        self.0 & Self::COMPLETE != 0
    }
}

/// Maximum number of polls until a stream has stopped. It first finishes its current item, which takes a microsecond.
const STOP_POLLS: u32 = 200;

impl Stream {
    /// Returns stream `number` of a controller, on `channel`.
    pub const fn new(controller: *const dma2::RegisterBlock, number: u8, channel: u8) -> Self {
        assert!(number < 8 && channel < 8);
        Self { controller, number, channel }
    }

    fn dma(&self) -> &'static dma2::RegisterBlock {
        // SAFETY: the registers of a controller. Each stream has one user (the board's file assigns no stream twice),
        // and flags are cleared by writing ones, so that no other stream is affected.
        unsafe { &*self.controller }
    }

    /// Returns the stream's registers.
    #[inline(always)]
    pub fn registers(&self) -> &'static dma2::ST {
        self.dma().st(usize::from(self.number))
    }

    /// Returns the channel, for CHSEL.
    #[inline(always)]
    pub fn channel(&self) -> u8 {
        self.channel
    }

    /// Returns the position of the stream's flags in their shared register.
    #[inline(always)]
    const fn shift(&self) -> u32 {
        [0, 6, 16, 22][self.number as usize % 4]
    }

    /// Returns the stream's flags.
    #[inline(always)]
    #[cfg_attr(feature = "simulated", expect(dead_code, reason = "no sensor is wired there"))]
    pub fn flags(&self) -> Flags {
        let bits =
            if self.number < 4 { self.dma().lisr().read().bits() } else { self.dma().hisr().read().bits() };
        Flags(bits >> self.shift() & Flags::ALL.0)
    }

    /// Clears these flags and no others.
    #[inline(always)]
    pub fn clear(&self, flags: Flags) {
        let bits = flags.0 << self.shift();
        // SAFETY: writing one clears a flag, writing zero has no effect; the reserved bits are zero.
        if self.number < 4 {
            self.dma().lifcr().write(|w| unsafe { w.bits(bits) });
        } else {
            // SAFETY: as above.
            self.dma().hifcr().write(|w| unsafe { w.bits(bits) });
        }
    }

    /// Clears all flags of the stream.
    #[inline(always)]
    pub fn clear_all(&self) {
        self.clear(Flags::ALL);
    }

    /// Returns whether a transfer is running.
    #[inline(always)]
    pub fn runs(&self) -> bool {
        self.registers().cr().read().en().is_enabled()
    }

    /// Stops a transfer, and clears the flags that the stop sets.
    pub fn stop(&self) {
        self.registers().cr().modify(|_, w| w.en().clear_bit());
        for _ in 0..STOP_POLLS {
            if !self.runs() {
                break;
            }
        }
        self.clear_all();
    }
}
