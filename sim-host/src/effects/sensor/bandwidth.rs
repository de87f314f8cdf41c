//! Bandwidth of the sensor chip: a 2nd-order Butterworth low-pass.
//!
//! H(s) = ω_c²/(s² + √2 ω_c s + ω_c²) with the −3 dB point at f_c, by the bilinear transform with prewarping
//! (Oppenheim and Schafer, *Discrete-Time Signal Processing*, 7.1): with K = tan(π f_c/f_s) and
//! D = 1 + √2 K + K², b = (K², 2K², K²)/D and a = (2(K² − 1), 1 − √2 K + K²)/D.
//!
//! The filter acts on the samples, so a vibration above half the sample rate passes at the frequency of its alias. As
//! f_c approaches half the rate, H tends to 1. From half the rate on there is no filter.

use flight_core::geometry::Vec3;
use serde::Deserialize;

use crate::effects::{BoxedSensorEffect, BuildContext, EffectParams, SensorEffect, Snapshot};
use input::InputError;
use input::check;

/// `[effects.gyro.bandwidth]` and `[effects.accel.bandwidth]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Bandwidth {
    /// Cutoff frequency f_c, Hz.
    pub cutoff_hz: f64,
}

impl EffectParams for Bandwidth {
    type Effect = BoxedSensorEffect;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        check::key_in_range(key, "cutoff_hz", self.cutoff_hz, 0.1, 1e5, "Hz")
    }

    fn build(&self, context: &BuildContext) -> BoxedSensorEffect {
        Box::new(LowPass::new(self.cutoff_hz, context.rate_hz))
    }
}

/// A low-pass filter in direct form II transposed. The numerator is b₀ (1 + z⁻¹)².
struct LowPass {
    b0: f64,
    a1: f64,
    a2: f64,
    /// Filter states; `None` before the first sample.
    states: Option<[Vec3<f64>; 2]>,
}

impl LowPass {
    fn new(cutoff_hz: f64, rate_hz: f64) -> Self {
        if cutoff_hz >= 0.5 * rate_hz {
            return Self { b0: 1.0, a1: 2.0, a2: 1.0, states: None };
        }
        let k = libm::tan(std::f64::consts::PI * cutoff_hz / rate_hz);
        let (k2, root2_k) = (k * k, std::f64::consts::SQRT_2 * k);
        let d = 1.0 + root2_k + k2;
        Self { b0: k2 / d, a1: 2.0 * (k2 - 1.0) / d, a2: (1.0 - root2_k + k2) / d, states: None }
    }
}

impl SensorEffect for LowPass {
    #[inline]
    fn apply_to(&mut self, reading: &mut Vec3<f64>, _: &Snapshot) {
        let fed = *reading * self.b0;
        // Start in the steady state for the first reading, so that there is no transient.
        let [s1, s2] = self.states.unwrap_or_else(|| [*reading - fed, fed - *reading * self.a2]);
        let read = fed + s1;
        self.states = Some([fed * 2.0 - read * self.a1 + s2, fed - read * self.a2]);
        *reading = read;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::sensor::testing::{at_rest, build};
    use flight_core::geometry::vec3;

    /// Returns the gain for a sine of this frequency, from quadrature sums over whole periods after the transient.
    fn gain(cutoff_hz: f64, frequency_hz: f64, rate_hz: f64) -> f64 {
        let mut effect = build(&Bandwidth { cutoff_hz }, rate_hz);
        let (mut real, mut imaginary) = (0.0, 0.0);
        at_rest(|at| {
            for k in 0..20_000 {
                let angle = std::f64::consts::TAU * frequency_hz * f64::from(k) / rate_hz;
                let got = effect.apply(vec3(angle.sin(), 0.0, 0.0), at).x;
                if k >= 10_000 {
                    real += got * angle.sin() / 5000.0;
                    imaginary += got * angle.cos() / 5000.0;
                }
            }
        });
        real.hypot(imaginary)
    }

    #[test]
    fn bandwidth_has_the_gain_of_a_butterworth_filter() {
        for (cutoff_hz, rate_hz) in [(100.0, 1000.0), (30.0, 1000.0), (20.0, 100.0)] {
            for ratio in [0.2, 1.0, 2.0] {
                let frequency_hz = ratio * cutoff_hz;
                // The gain is 1/√(1 + (Ω/Ω_c)⁴) at the frequencies that the bilinear transform maps to.
                let warped = |hz: f64| (std::f64::consts::PI * hz / rate_hz).tan();
                let want = (1.0 + (warped(frequency_hz) / warped(cutoff_hz)).powi(4)).sqrt().recip();
                let got = gain(cutoff_hz, frequency_hz, rate_hz);
                assert!((got - want).abs() < 1e-9, "{frequency_hz} Hz: {got} {want}");
            }
        }
    }

    #[test]
    fn constant_input_passes_from_the_first_sample() {
        for cutoff_hz in [5.0, 499.0, 2000.0] {
            let mut effect = build(&Bandwidth { cutoff_hz }, 1000.0);
            let truth = vec3(1.0, -2.0, 9.81);
            at_rest(|at| {
                for _ in 0..1000 {
                    assert!((effect.apply(truth, at) - truth).norm() < 1e-10);
                }
            });
        }
    }

    #[test]
    fn cutoff_above_half_the_rate_filters_nothing() {
        for cutoff_hz in [50.0, 1e4] {
            for frequency_hz in [5.0, 45.0] {
                assert!((gain(cutoff_hz, frequency_hz, 100.0) - 1.0).abs() < 1e-9);
            }
        }
    }
}
