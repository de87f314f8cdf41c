//! The sensors: from the truth through effects in a fixed order, then the chip's converter, to counts.
//!
//! ```text
//!  truth (f64, body axes) ──► effects that the scene names, in the order of `scene/effects.rs` ──► range, LSB ──► counts
//! ```

use flight_core::geometry::{Vec3, vec3};
use flight_core::sample::{ImuSample, MagSample};
use wide::f64x4;

use crate::effects::delivery::{BoxedDelivery, Jitter};
use crate::effects::{BoxedSensorEffect, OPTIONAL_EFFECTS, Snapshot};

/// A chip's 16-bit converter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Converter {
    per_count: f64,
    /// Reciprocal of `per_count`: a division at every sample would cost more than the rest.
    counts_per_unit: f64,
}

impl Converter {
    /// Creates a converter with this resolution, SI units (magnetometer: µT) per count.
    pub fn new(per_count: f64) -> Self {
        Self { per_count, counts_per_unit: 1.0 / per_count }
    }

    /// Returns the resolution, SI units (magnetometer: µT) per count.
    pub fn per_count(&self) -> f64 {
        self.per_count
    }

    /// Returns the nearest counts, limited to the range of 16 bits. The axes are lanes of a SIMD vector, because the
    /// compiler does not vectorise this by itself.
    #[inline(always)]
    fn convert(&self, Vec3 { x, y, z }: Vec3<f64>) -> [i16; 3] {
        const LOWEST: f64x4 = f64x4::splat(-32768.0);
        const HIGHEST: f64x4 = f64x4::splat(32767.0);
        // Adding 1.5 · 2⁵² rounds to the nearest integer, halves to even, and leaves it in the lowest bits.
        const ROUNDER: f64x4 = f64x4::splat(6_755_399_441_055_744.0);
        let counts = f64x4::new([x, y, z, 0.0]) * f64x4::splat(self.counts_per_unit);
        let [x, y, z, _] = (counts.fast_max(LOWEST).fast_min(HIGHEST) + ROUNDER).to_array();
        [x, y, z].map(|counts| counts.to_bits() as i16)
    }
}

/// A three-axis sensor: its errors and its converter.
pub struct Sensor {
    effects: Vec<(&'static str, BoxedSensorEffect)>,
    converter: Converter,
}

impl Sensor {
    /// Creates a sensor with these effects, which apply in the order given.
    pub fn new(effects: Vec<(&'static str, BoxedSensorEffect)>, converter: Converter) -> Self {
        Self { effects, converter }
    }

    /// Adds an effect after those that the sensor has. See the example `own_effect`.
    pub fn push(&mut self, name: &'static str, effect: BoxedSensorEffect) {
        self.effects.push((name, effect));
    }

    /// Returns the effects, to apply them one by one.
    pub fn effects_mut(&mut self) -> &mut [(&'static str, BoxedSensorEffect)] {
        &mut self.effects
    }

    /// Returns the reading for a true value, before the converter.
    #[inline(always)]
    pub fn measure(&mut self, truth: Vec3<f64>, at: &Snapshot) -> Vec3<f64> {
        let mut reading = truth;
        if OPTIONAL_EFFECTS {
            for (_, effect) in &mut self.effects {
                effect.apply_to(&mut reading, at);
            }
        }
        reading
    }

    /// Returns the counts for a true value.
    #[inline(always)]
    pub fn sample(&mut self, truth: Vec3<f64>, at: &Snapshot) -> [i16; 3] {
        let reading = self.measure(truth, at);
        self.converter.convert(reading)
    }

    /// Converts counts to SI units (magnetometer: µT) with the datasheet's sensitivity.
    pub fn nominal(&self, counts: [i16; 3]) -> Vec3<f64> {
        let [x, y, z] = counts.map(f64::from);
        vec3(x, y, z) * self.converter.per_count()
    }
}

/// All sensors of a vehicle, and the effects on their samples on the way to the flight controller.
pub struct Sensors {
    /// Gyroscope, rad/s.
    pub gyro: Sensor,
    /// Accelerometer, m/s².
    pub accel: Sensor,
    /// Magnetometer, µT.
    pub mag: Sensor,
    /// The Earth's field, north, east, down, µT.
    pub field_ut: Vec3<f64>,
    /// Jitter of the time at which gyroscope and accelerometer are sampled.
    pub jitter: Option<Jitter>,
    /// Delivery effects on the samples of gyroscope and accelerometer.
    pub imu_delivery: Vec<BoxedDelivery<ImuSample>>,
    /// Delivery effects on the samples of the magnetometer.
    pub mag_delivery: Vec<BoxedDelivery<MagSample>>,
}

impl Sensors {
    /// Returns true if gyroscope and accelerometer have no error and lose no sample, so that [`Self::perfect_imu`]
    /// gives the same result as [`Self::imu`].
    #[inline(always)]
    pub fn imu_is_perfect(&self) -> bool {
        let plain = self.gyro.effects.is_empty() && self.accel.effects.is_empty();
        plain && self.jitter.is_none() && self.imu_delivery.is_empty()
    }

    /// Returns the sample for these true values, rad/s and m/s², with no error but that of the converters.
    #[inline(always)]
    pub fn perfect_imu(&self, rates: Vec3<f64>, specific_force: Vec3<f64>) -> ImuSample {
        ImuSample {
            gyro: self.gyro.converter.convert(rates),
            accel: self.accel.converter.convert(specific_force),
        }
    }

    /// Returns the sample of gyroscope and accelerometer that arrives, if any. Called once per step.
    #[inline(always)]
    pub fn imu(&mut self, at: &Snapshot) -> Option<ImuSample> {
        let mut arrived = None;
        if !OPTIONAL_EFFECTS || (self.jitter.is_none() && self.imu_delivery.is_empty()) {
            arrived = Some(self.imu_at(at));
        } else {
            self.imu_delivered(at, &mut arrived);
        }
        arrived
    }

    /// Returns the sample of the magnetometer that arrives, if any. Called when the magnetometer takes a sample.
    #[inline(always)]
    pub fn mag(&mut self, at: &Snapshot) -> Option<MagSample> {
        let field = at.state.attitude.to_matrix().transpose() * self.field_ut;
        let sample = MagSample { counts: self.mag.sample(field, at) };
        if !OPTIONAL_EFFECTS || self.mag_delivery.is_empty() {
            Some(sample)
        } else {
            let mut arrived = Some(sample);
            deliver(&mut self.mag_delivery, &mut arrived);
            arrived
        }
    }

    #[inline(always)]
    fn imu_at(&mut self, at: &Snapshot) -> ImuSample {
        ImuSample {
            gyro: self.gyro.sample(at.state.rates, at),
            accel: self.accel.sample(at.specific_force, at),
        }
    }

    /// Samples with jitter and delivery effects. It is a separate function, because passing samples through memory would
    /// cost a scene without these effects more than its sensor noise.
    #[inline(never)]
    fn imu_delivered(&mut self, at: &Snapshot, arrived: &mut Option<ImuSample>) {
        let sample = match &mut self.jitter {
            None => self.imu_at(at),
            Some(jitter) => {
                let mut state = *at.state;
                let at = jitter.displaced(at, &mut state);
                self.imu_at(&at)
            }
        };
        *arrived = Some(sample);
        deliver(&mut self.imu_delivery, arrived);
    }
}

/// Passes an optional sample through the delivery effects.
#[inline(never)]
pub fn deliver<T>(effects: &mut [BoxedDelivery<T>], sample: &mut Option<T>) {
    // Every effect is called, even if the sample is already lost, because every effect counts its steps.
    for effect in effects {
        effect.pass(sample);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::sensor::testing::at_rest;

    #[test]
    fn without_effects_only_the_converter_acts() {
        let mut sensor = Sensor::new(vec![], Converter::new(1e-3));
        let truth = vec3(0.123_456, -1.0, 40.0);
        at_rest(|at| {
            assert_eq!(sensor.measure(truth, at), truth);
            assert_eq!(sensor.sample(truth, at), [123, -1000, i16::MAX]);
            assert_eq!(sensor.sample(vec3(-0.000_6, 0.000_4, -40.0), at), [-1, 0, i16::MIN]);
        });
    }
}
