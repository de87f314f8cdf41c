//! The battery's voltage by ADC1, measured against the chip's internal reference.
//!
//! Each run reads the conversions that the previous run has started, and starts the next ones: no task waits. The
//! reference voltage (VREFINT) is converted together with the battery, so that the board's 3.3 V supply need not be
//! exact: the factory has stored the reference's count at 3.3 V.

use flight_core::sample::Battery;
use stm32f4xx_hal::pac::{ADC_COMMON, ADC1};
use stm32f4xx_hal::rcc::{Enable, Rcc};
use stm32f4xx_hal::signature::VrefCal;

/// ADC channel of the reference.
const VREFINT: u8 = 17;
/// Supply voltage at which the factory measured the reference, V.
const CALIBRATED_AT_V: f32 = 3.3;
/// Plausible counts of the reference: 1.18 to 1.24 V (datasheet, table 71) at a supply of 2.4 to 3.6 V, with a margin.
/// A measurement outside is dropped.
const PLAUSIBLE: core::ops::RangeInclusive<u16> = 1_300..=2_150;

/// The battery measurement.
pub struct BatteryAdc {
    adc: ADC1,
    /// Voltage at the pin for full scale, times the divider ratio and the reference's calibration count, V.
    scale_v: f32,
}

impl BatteryAdc {
    /// Sets up the measurement of `channel`, which is behind a divider of `ratio`.
    pub fn new(adc: ADC1, common: &ADC_COMMON, channel: u8, ratio: f32, rcc: &mut Rcc) -> Self {
        ADC1::enable(rcc);
        // The clock is APB2's 84 MHz divided by 4, 21 MHz; the limit is 36 MHz. The temperature sensor and the
        // reference are on.
        // SAFETY: the value 1 means "divided by 4".
        common.ccr().write(|w| unsafe { w.adcpre().bits(0b01) }.tsvrefe().set_bit());
        // 480 cycles (23 µs) for each: the reference needs at least 10 µs.
        // SAFETY: sets the fields of all channels.
        adc.smpr1().write(|w| unsafe { w.bits(0x07ff_ffff) });
        // Two injected conversions; the third and fourth place of the sequence hold their channels.
        // SAFETY: JL is 1, JSQ3 at bit 10, JSQ4 at bit 15.
        adc.jsqr()
            .write(|w| unsafe { w.bits(1 << 20 | u32::from(channel) << 10 | u32::from(VREFINT) << 15) });
        adc.cr1().write(|w| w.scan().set_bit());
        adc.cr2().write(|w| w.adon().set_bit());
        let calibration = f32::from(VrefCal::get().read());
        Self { adc, scale_v: CALIBRATED_AT_V * calibration * ratio / 4_095.0 }
    }

    /// Returns the voltage at the time of the previous call, if it was measured.
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
