//! What the sensors make of the truth: effects in a fixed order, then the chip's converter.
//!
//! ```text
//!  truth (f64, body axes) ──► effects that the scene names, in the order of `scene/effects.rs` ──► range, LSB ──► counts
//! ```

use flight_core::geometry::{Vec3, vec3};
use flight_core::sample::{ImuSample, MagSample};
use wide::f64x4;

use crate::effects::delivery::{BoxedDelivery, Jitter};
use crate::effects::{BoxedSensorEffect, OPTIONAL, Snapshot};

/// A chip's 16-bit converter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Converter {
    per_count: f64,
    /// Its reciprocal: a division at every sample would cost more than the rest.
    counts_per_unit: f64,
}

impl Converter {
    /// A converter with so many SI units (magnetometer: µT) per count.
    pub fn new(per_count: f64) -> Self {
        Self { per_count, counts_per_unit: 1.0 / per_count }
    }

    /// SI units (magnetometer: µT) per count.
    pub fn per_count(&self) -> f64 {
        self.per_count
    }

    /// Nearest counts, the ends of the range included. The axes stand side by side in a vector, which a
    /// compiler does not make of them by itself.
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

    /// The effects, to be looked at by themselves.
    pub fn effects_mut(&mut self) -> &mut [(&'static str, BoxedSensorEffect)] {
        &mut self.effects
    }

    /// The reading of a true value, before the converter.
    #[inline(always)]
    pub fn measure(&mut self, truth: Vec3<f64>, at: &Snapshot) -> Vec3<f64> {
        let mut reading = truth;
        if OPTIONAL {
            for (_, effect) in &mut self.effects {
                effect.apply_to(&mut reading, at);
            }
        }
        reading
    }

    /// The counts for a true value.
    #[inline(always)]
    pub fn sample(&mut self, truth: Vec3<f64>, at: &Snapshot) -> [i16; 3] {
        let reading = self.measure(truth, at);
        self.converter.convert(reading)
    }

    /// What counts mean by the datasheet, in SI (magnetometer: µT).
    pub fn nominal(&self, counts: [i16; 3]) -> Vec3<f64> {
        let [x, y, z] = counts.map(f64::from);
        vec3(x, y, z) * self.converter.per_count()
    }
}

/// All sensors of a vehicle, and what befalls their samples on the way to the flight controller.
pub struct Sensors {
    /// rad/s.
    pub gyro: Sensor,
    /// m/s².
    pub accel: Sensor,
    /// µT.
    pub mag: Sensor,
    /// The Earth's field, north, east, down, µT.
    pub field_ut: Vec3<f64>,
    /// What moves the time at which gyroscope and accelerometer are sampled.
    pub jitter: Option<Jitter>,
    /// What befalls the samples of gyroscope and accelerometer.
    pub imu_delivery: Vec<BoxedDelivery<ImuSample>>,
    /// What befalls the samples of the magnetometer.
    pub mag_delivery: Vec<BoxedDelivery<MagSample>>,
}

impl Sensors {
    /// Whether gyroscope and accelerometer have no error and lose no sample: then
    /// [`Self::perfect_imu`] says it all.
    #[inline(always)]
    pub fn imu_is_perfect(&self) -> bool {
        let plain = self.gyro.effects.is_empty() && self.accel.effects.is_empty();
        plain && self.jitter.is_none() && self.imu_delivery.is_empty()
    }

    /// The sample of these true values, rad/s and m/s², but for the converters.
    #[inline(always)]
    pub fn perfect_imu(&self, rates: Vec3<f64>, specific_force: Vec3<f64>) -> ImuSample {
        ImuSample {
            gyro: self.gyro.converter.convert(rates),
            accel: self.accel.converter.convert(specific_force),
        }
    }

    /// What arrives of gyroscope and accelerometer. Called once a step.
    #[inline(always)]
    pub fn imu(&mut self, at: &Snapshot) -> Option<ImuSample> {
        let mut arrived = None;
        if !OPTIONAL || (self.jitter.is_none() && self.imu_delivery.is_empty()) {
            arrived = Some(self.imu_at(at));
        } else {
            self.imu_delivered(at, &mut arrived);
        }
        arrived
    }

    /// What arrives of the magnetometer. Called when it takes a sample.
    #[inline(always)]
    pub fn mag(&mut self, at: &Snapshot) -> Option<MagSample> {
        let field = at.state.attitude.to_matrix().transpose() * self.field_ut;
        let sample = MagSample { counts: self.mag.sample(field, at) };
        if !OPTIONAL || self.mag_delivery.is_empty() {
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

    /// Out of the way of scenes that name none of this: handing samples from effect to effect through memory
    /// would cost them more than their noise does.
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

/// Leaves of a sample, or of its absence, what these effects leave of it.
#[inline(never)]
pub fn deliver<T>(effects: &mut [BoxedDelivery<T>], sample: &mut Option<T>) {
    // To the end even when nothing is left: every effect counts its steps.
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
