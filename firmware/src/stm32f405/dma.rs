//! A stream of DMA by its number: the registers' description has a field of another name for each stream's flags.

use stm32f4xx_hal::pac::dma2;

/// A stream, and the channel by which its peripheral asks for it.
#[derive(Clone, Copy)]
pub struct Stream {
    controller: *const dma2::RegisterBlock,
    number: u8,
    channel: u8,
}

// SAFETY: an address of registers, and two numbers.
unsafe impl Sync for Stream {}

/// Flags of a stream, as they lie in its six bits of LISR and HISR, and of LIFCR and HIFCR (RM0090, 10.5.1 to 10.5.4).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Flags(u32);

impl Flags {
    /// FEIF, DMEIF, TEIF, HTIF and TCIF; bit 1 is reserved.
    const ALL: Self = Self(0b11_1101);
    const TRANSFER_ERROR: u32 = 1 << 3;
    const COMPLETE: u32 = 1 << 5;

    /// The transfer ended with an error.
    #[inline(always)]
    #[cfg_attr(feature = "simulated", expect(dead_code, reason = "no sensor is wired there"))]
    pub fn is_error(self) -> bool {
        self.0 & Self::TRANSFER_ERROR != 0
    }

    /// The transfer is complete.
    #[inline(always)]
    #[cfg_attr(feature = "simulated", expect(dead_code, reason = "no sensor is wired there"))]
    pub fn is_complete(self) -> bool {
        self.0 & Self::COMPLETE != 0
    }
}

/// Looks at a stream that was told to stop: it finishes its item first, a microsecond.
const STOP_LOOKS: u32 = 200;

impl Stream {
    /// Stream `number` of a controller, on `channel`.
    pub const fn new(controller: *const dma2::RegisterBlock, number: u8, channel: u8) -> Self {
        assert!(number < 8 && channel < 8);
        Self { controller, number, channel }
    }

    fn dma(&self) -> &'static dma2::RegisterBlock {
        // SAFETY: a controller's registers. Each stream has one user (the board's file gives no stream away twice), and
        // flags are cleared by writing ones, so that no other stream is touched.
        unsafe { &*self.controller }
    }

    /// Its registers.
    #[inline(always)]
    pub fn registers(&self) -> &'static dma2::ST {
        self.dma().st(usize::from(self.number))
    }

    /// Its channel, for CHSEL.
    #[inline(always)]
    pub fn channel(&self) -> u8 {
        self.channel
    }

    /// First bit of its flags, of those that it shares a register with.
    #[inline(always)]
    const fn shift(&self) -> u32 {
        [0, 6, 16, 22][self.number as usize % 4]
    }

    /// Its flags.
    #[inline(always)]
    #[cfg_attr(feature = "simulated", expect(dead_code, reason = "no sensor is wired there"))]
    pub fn flags(&self) -> Flags {
        let bits =
            if self.number < 4 { self.dma().lisr().read().bits() } else { self.dma().hisr().read().bits() };
        Flags(bits >> self.shift() & Flags::ALL.0)
    }

    /// Takes down these flags, and no others.
    #[inline(always)]
    pub fn clear(&self, flags: Flags) {
        let bits = flags.0 << self.shift();
        // SAFETY: a written one takes a flag down, and a zero does nothing; the reserved bits are zero.
        if self.number < 4 {
            self.dma().lifcr().write(|w| unsafe { w.bits(bits) });
        } else {
            // SAFETY: as above.
            self.dma().hifcr().write(|w| unsafe { w.bits(bits) });
        }
    }

    /// Takes down all its flags.
    #[inline(always)]
    pub fn clear_all(&self) {
        self.clear(Flags::ALL);
    }

    /// Whether a transfer is under way.
    #[inline(always)]
    pub fn runs(&self) -> bool {
        self.registers().cr().read().en().is_enabled()
    }

    /// Ends a transfer, and takes the flags down with which a stream says that it has been stopped.
    pub fn stop(&self) {
        self.registers().cr().modify(|_, w| w.en().clear_bit());
        for _ in 0..STOP_LOOKS {
            if !self.runs() {
                break;
            }
        }
        self.clear_all();
    }
}
