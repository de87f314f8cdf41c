//! What the sensors make of the truth: effects in a fixed order, then the chip's converter.
//!
//! ```text
//!  truth (f64, body axes) ──► effects that the scene names, in the order of `SensorEffect` ──► range, LSB ──► counts
//! ```

use flight_core::geometry::{Vec3, vec3};

use crate::random::NormalStreams;

/// One error of a three-axis sensor, in the sensor's SI unit (magnetometer: µT). The variants stand in the
/// order in which they apply.
#[derive(Clone, Debug)]
pub enum SensorEffect {
    /// Eq 17: a field that turns with the vehicle.
    HardIron(Vec3<f64>),
    /// Eq 16: y\[k\] = N/√Δt w\[k\].
    WhiteNoise {
        /// N/√Δt per axis.
        deviation: Vec3<f64>,
        /// w.
        streams: NormalStreams,
    },
}

impl SensorEffect {
    /// White noise of density N (unit/√Hz, two-sided: the noise of one-second means) on samples `interval_s`
    /// apart. `effect` names the stream.
    pub fn white_noise(n: Vec3<f64>, interval_s: f64, seed: u64, effect: &str) -> Self {
        Self::WhiteNoise {
            deviation: n * (1.0 / libm::sqrt(interval_s)),
            streams: NormalStreams::new(seed, effect),
        }
    }

    #[inline(always)]
    fn apply(&mut self, reading: Vec3<f64>) -> Vec3<f64> {
        match self {
            Self::HardIron(field) => reading + *field,
            Self::WhiteNoise { deviation, streams } => reading + deviation.scale_by(streams.draw()),
        }
    }
}

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
#[derive(Clone, Debug)]
pub struct Sensor {
    effects: Vec<SensorEffect>,
    converter: Converter,
}

impl Sensor {
    /// A sensor with these effects, which apply in the order given.
    pub fn new(effects: Vec<SensorEffect>, converter: Converter) -> Self {
        Self { effects, converter }
    }

    /// The reading of a true value, before the converter.
    #[inline(always)]
    pub fn measure(&mut self, truth: Vec3<f64>) -> Vec3<f64> {
        self.effects.iter_mut().fold(truth, |reading, effect| effect.apply(reading))
    }

    /// The counts for a true value.
    #[inline(always)]
    pub fn sample(&mut self, truth: Vec3<f64>) -> [i16; 3] {
        let Vec3 { x, y, z } = self.measure(truth);
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

    const GYRO: Converter = Converter { per_count: 1e-3 };

    #[test]
    fn without_effects_only_the_converter_acts() {
        let mut sensor = Sensor::new(vec![], GYRO);
        let truth = vec3(0.123_456, -1.0, 40.0);
        assert_eq!(sensor.measure(truth), truth);
        assert_eq!(sensor.sample(truth), [123, -1000, i16::MAX]);
        assert_eq!(sensor.sample(vec3(-0.000_6, 0.000_4, -40.0)), [-1, 0, i16::MIN]);
    }

    #[test]
    fn white_noise_has_the_density_that_went_in_at_any_rate() {
        for rate_hz in [100.0, 1000.0] {
            let n = vec3(0.032, 0.02, 0.01);
            let noise = SensorEffect::white_noise(n, 1.0 / rate_hz, 3, "test");
            let mut sensor = Sensor::new(vec![noise], GYRO);
            // The mean over T seconds has the variance N²/T: 20,000 means of 0.1 s.
            let (batches, length) = (20_000, (0.1 * rate_hz) as u32);
            let mut sums = Vec3::ZERO;
            for _ in 0..batches {
                let mut mean = Vec3::ZERO;
                for _ in 0..length {
                    mean += sensor.measure(Vec3::ZERO) * (1.0 / f64::from(length));
                }
                sums += mean.scale_by(mean);
            }
            for (sum, n) in <[f64; 3]>::from(sums).into_iter().zip(<[f64; 3]>::from(n)) {
                let got = libm::sqrt(sum / f64::from(batches) * 0.1);
                // Five standard errors of a deviation from 20,000 draws: 5/√40,000.
                assert!((got / n - 1.0).abs() < 0.025, "{got} for {n}");
            }
        }
    }

    #[test]
    fn hard_iron_adds_the_offset_of_eq_17() {
        let mut sensor = Sensor::new(
            vec![SensorEffect::HardIron(vec3(0.0, 200.0, 0.0))],
            Converter { per_count: 1.0 / 30.0 },
        );
        assert_eq!(sensor.sample(vec3(25.0, 2.0, 41.0)), [750, 6060, 1230]);
    }
}
