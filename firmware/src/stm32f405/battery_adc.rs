//! The battery's voltage by ADC1, against the chip's own reference.
//!
//! Each run takes what the last one has started, and starts the next conversions: nobody waits. The reference
//! voltage (VREFINT) is measured along with it, so that the 3.3 V of the board need not be exact: ST has measured
//! it at 3.3 V in the factory.

use flight_core::sample::Battery;
use stm32f4xx_hal::pac::{ADC_COMMON, ADC1};
use stm32f4xx_hal::rcc::{Enable, Rcc};
use stm32f4xx_hal::signature::VrefCal;

/// The reference's channel.
const VREFINT: u8 = 17;
/// Voltage at which the factory measured the reference, V.
const CALIBRATED_AT_V: f32 = 3.3;
/// Reads of the reference, in counts: 1.18 to 1.24 V (datasheet, table 71) at 2.4 to 3.6 V, and some room.
/// Anything else is no measurement.
const PLAUSIBLE: core::ops::RangeInclusive<u16> = 1_300..=2_150;

/// The measurement.
pub struct BatteryAdc {
    adc: ADC1,
    /// V at the pin for full scale, times the divider and the reference's calibration.
    scale_v: f32,
}

impl BatteryAdc {
    /// Measures `channel`, behind a divider of `ratio`.
    pub fn new(adc: ADC1, common: &ADC_COMMON, channel: u8, ratio: f32, rcc: &mut Rcc) -> Self {
        ADC1::enable(rcc);
        // APB2's 84 MHz over 4: 21 MHz, of at most 36. Temperature and reference on.
        // SAFETY: 1 is "over 4".
        common.ccr().write(|w| unsafe { w.adcpre().bits(0b01) }.tsvrefe().set_bit());
        // 480 cycles (23 µs) for each: the reference needs 10 µs at least.
        // SAFETY: the fields of all channels.
        adc.smpr1().write(|w| unsafe { w.bits(0x07ff_ffff) });
        // Two injected conversions, of which the third and fourth place say which.
        // SAFETY: JL is 1, JSQ3 at bit 10, JSQ4 at bit 15.
        adc.jsqr()
            .write(|w| unsafe { w.bits(1 << 20 | u32::from(channel) << 10 | u32::from(VREFINT) << 15) });
        adc.cr1().write(|w| w.scan().set_bit());
        adc.cr2().write(|w| w.adon().set_bit());
        let calibration = f32::from(VrefCal::get().read());
        Self { adc, scale_v: CALIBRATED_AT_V * calibration * ratio / 4_095.0 }
    }

    /// The voltage when this was last called, if there is one.
    pub fn measure(&mut self) -> Option<Battery> {
        let done = self.adc.sr().read().jeoc().bit_is_set();
        let pin = self.adc.jdr1().read().jdata().bits();
        let reference = self.adc.jdr2().read().jdata().bits();
        self.adc.sr().write(|w| w.jeoc().clear_bit());
        self.adc.cr2().modify(|_, w| w.jswstart().set_bit());
        let plausible = done && PLAUSIBLE.contains(&reference);
        plausible.then(|| Battery { voltage_v: self.scale_v * f32::from(pin) / f32::from(reference) })
    }
}
