//! What the sensors make of the truth: effects in a fixed order, then the chip's converter.
//!
//! ```text
//!  truth (f64, body axes) ──► effects that the scene names, in the order of `scene/effects.rs` ──► range, LSB ──► counts
//! ```

use flight_core::geometry::{Vec3, vec3};

use crate::effects::{BoxedSensorEffect, Moment};

/// A chip's 16-bit converter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Converter {
    /// SI units (magnetometer: µT) per count.
    pub per_count: f64,
}

impl Converter {
    /// Nearest count, the ends of the range included.
    #[inline(always)]
    fn convert(&self, reading: f64) -> i16 {
        // Adding and taking away 1.5 · 2⁵² rounds to the nearest integer, halves to even.
        const ROUNDER: f64 = 6_755_399_441_055_744.0;
        let counts = (reading / self.per_count).clamp(-32768.0, 32767.0);
        ((counts + ROUNDER) - ROUNDER) as i16
    }
}

/// A three-axis sensor: its errors, then its converter.
pub struct Sensor {
    effects: Vec<(&'static str, BoxedSensorEffect)>,
    converter: Converter,
}

impl Sensor {
    /// A sensor with these effects, which apply in the order given.
    pub fn new(effects: Vec<(&'static str, BoxedSensorEffect)>, converter: Converter) -> Self {
        Self { effects, converter }
    }

    /// The reading of a true value, before the converter.
    #[inline(always)]
    pub fn measure(&mut self, truth: Vec3<f64>, at: &Moment) -> Vec3<f64> {
        let mut reading = truth;
        for (_, effect) in &mut self.effects {
            effect.apply_to(&mut reading, at);
        }
        reading
    }

    /// The counts for a true value.
    #[inline(always)]
    pub fn sample(&mut self, truth: Vec3<f64>, at: &Moment) -> [i16; 3] {
        let Vec3 { x, y, z } = self.measure(truth, at);
        [self.converter.convert(x), self.converter.convert(y), self.converter.convert(z)]
    }

    /// What counts mean by the datasheet, in SI (magnetometer: µT).
    pub fn nominal(&self, counts: [i16; 3]) -> Vec3<f64> {
        let [x, y, z] = counts.map(f64::from);
        vec3(x, y, z) * self.converter.per_count
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::sensor::testing::at_rest;

    const GYRO: Converter = Converter { per_count: 1e-3 };

    #[test]
    fn without_effects_only_the_converter_acts() {
        let mut sensor = Sensor::new(vec![], GYRO);
        let truth = vec3(0.123_456, -1.0, 40.0);
        at_rest(|at| {
            assert_eq!(sensor.measure(truth, at), truth);
            assert_eq!(sensor.sample(truth, at), [123, -1000, i16::MAX]);
            assert_eq!(sensor.sample(vec3(-0.000_6, 0.000_4, -40.0), at), [-1, 0, i16::MIN]);
        });
    }
}
