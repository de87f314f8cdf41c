//! Quantization: y ← LSB · round(y/LSB), halves to even.
//!
//! This effect is for a step coarser than that of the chip's converter, which is always simulated. If the signal
//! moves over many steps, the error is uniform and white with the standard deviation LSB/√12: an Allan deviation
//! shows it as N = LSB √(Δt/12). The Q of IEEE Std 952-1997 (slope −1) is for a sensor that quantizes the angle
//! instead of the rate.

use flight_core::geometry::{Vec3, vec3};
use serde::Deserialize;

use super::DEG;
use crate::effects::{BoxedSensorEffect, BuildContext, EffectParams, SensorEffect, Snapshot};
use input::InputError;
use input::check;

/// `[effects.gyro.quantization]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GyroQuantization {
    /// Least significant bit, deg/s.
    pub lsb_deg_s: f64,
}

/// `[effects.accel.quantization]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AccelQuantization {
    /// Least significant bit, m/s².
    pub lsb_m_s2: f64,
}

impl EffectParams for GyroQuantization {
    type Effect = BoxedSensorEffect;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        check::key_in_range(key, "lsb_deg_s", self.lsb_deg_s, 1e-9, 1e3, "deg/s")
    }

    fn build(&self, _: &BuildContext) -> BoxedSensorEffect {
        Box::new(Steps::new(self.lsb_deg_s * DEG))
    }
}

impl EffectParams for AccelQuantization {
    type Effect = BoxedSensorEffect;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        check::key_in_range(key, "lsb_m_s2", self.lsb_m_s2, 1e-9, 100.0, "m/s²")
    }

    fn build(&self, _: &BuildContext) -> BoxedSensorEffect {
        Box::new(Steps::new(self.lsb_m_s2))
    }
}

struct Steps {
    lsb: f64,
    per_lsb: f64,
}

impl Steps {
    fn new(lsb: f64) -> Self {
        Self { lsb, per_lsb: 1.0 / lsb }
    }
}

impl SensorEffect for Steps {
    #[inline]
    fn apply_to(&mut self, reading: &mut Vec3<f64>, _: &Snapshot) {
        // Adding and subtracting 1.5 · 2⁵² rounds to the nearest integer, halves to even, below 2⁵¹ steps. At the
        // finest LSB allowed this is 2,000,000 in the unit of its key.
        const ROUNDER: f64 = 6_755_399_441_055_744.0;
        let rounded = |y: f64| ((y * self.per_lsb + ROUNDER) - ROUNDER) * self.lsb;
        *reading = vec3(rounded(reading.x), rounded(reading.y), rounded(reading.z));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::sensor::testing::{at_rest, build};

    #[test]
    fn rounds_to_the_nearest_step() {
        let mut effect = build(&AccelQuantization { lsb_m_s2: 0.25 }, 100.0);
        let got = at_rest(|at| effect.apply(vec3(0.26, -0.38, 1e6 + 0.1), at));
        assert_eq!(got, vec3(0.25, -0.5, 1e6));
    }

    #[test]
    fn quantization_error_is_uniform_over_a_step() {
        let mut effect = build(&GyroQuantization { lsb_deg_s: 1.0 }, 100.0);
        // The input sweeps slowly over a thousand steps, at a speed incommensurate with them. The error has mean
        // 0 and variance LSB²/12.
        let (mut sum, mut squares, count) = (0.0, 0.0, 200_000);
        at_rest(|at| {
            for k in 0..count {
                let truth = f64::from(k) * 0.005_000_37 * DEG;
                let error = effect.apply(vec3(truth, 0.0, 0.0), at).x - truth;
                sum += error / DEG;
                squares += (error / DEG).powi(2);
            }
        });
        let (mean, variance) = (sum / f64::from(count), squares / f64::from(count));
        assert!(mean.abs() < 1e-3 && (variance * 12.0 - 1.0).abs() < 1e-3, "{mean} {variance}");
    }
}
