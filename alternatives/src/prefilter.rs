//! Low-pass filters to compare with the second-order Butterworth filter of the flight code.

use core::f64::consts::PI;

use flight_core::geometry::Vec3;
use flight_core::prefilter::Biquad;

/// A first-order low-pass for three axes: y += k (x − y). Other flight stacks call it PT1.
#[derive(Clone, Copy, Debug)]
pub struct Pt1 {
    gain: f32,
    y: Vec3<f32>,
}

impl Pt1 {
    /// Creates a filter with its −3 dB point at `cutoff_hz`, above 0 and below half the rate.
    ///
    /// |H|² = k²/(1 + (1 − k)² − 2(1 − k) cos ω) is 1/2 at k = √(v(2 + v)) − v with v = 1 − cos ω. The
    /// common k = Δt/(Δt + 1/ω_c) is an approximation of it.
    pub fn new(cutoff_hz: f64, rate_hz: f64) -> Self {
        let half = libm::sin(PI * cutoff_hz / rate_hz);
        let v = 2.0 * half * half;
        Self { gain: (libm::sqrt(v * (2.0 + v)) - v) as f32, y: Vec3::ZERO }
    }

    /// Filters one sample.
    #[inline(always)]
    pub fn step(&mut self, x: Vec3<f32>) -> Vec3<f32> {
        self.y += (x - self.y) * self.gain;
        self.y
    }
}

/// Returns the two sections of a fourth-order Butterworth low-pass with its −3 dB point at `cutoff_hz`, above 0 and
/// below half the rate. Their poles lie at 22.5° and 67.5° from the real axis; 1/Q is twice the cosine of that angle.
pub fn butterworth_4(cutoff_hz: f64, rate_hz: f64) -> [Biquad; 2] {
    [PI / 8.0, 3.0 * PI / 8.0].map(|angle| {
        let k = libm::tan(PI * cutoff_hz / rate_hz);
        let damping = 2.0 * libm::cos(angle) * k;
        let d = 1.0 + damping + k * k;
        Biquad {
            b0: (k * k / d) as f32,
            a: [(2.0 * (k * k - 1.0) / d) as f32, ((1.0 - damping + k * k) / d) as f32],
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use flight_core::geometry::vec3;
    use flight_core::prefilter::Prefilter;

    /// Returns the amplitude of the settled output for a sine of amplitude 1.
    fn gain(hz: f64, rate_hz: f64, mut filter: impl FnMut(Vec3<f32>) -> Vec3<f32>) -> f64 {
        let w = 2.0 * PI * hz / rate_hz;
        let (mut i, mut q) = (0.0, 0.0);
        let turns = 200.0 * rate_hz / hz;
        for k in 0..(2.0 * turns) as u32 {
            let (s, c) = (w * f64::from(k)).sin_cos();
            let y = f64::from(filter(vec3(s as f32, 0.0, 0.0)).x);
            if f64::from(k) >= turns {
                i += y * s;
                q += y * c;
            }
        }
        2.0 * i.hypot(q) / turns
    }

    #[test]
    fn filters_have_half_power_at_cutoff_and_their_slope_beyond() {
        for (cutoff, rate) in [(50.0, 1000.0), (100.0, 1000.0), (200.0, 8000.0)] {
            let mut pt1 = Pt1::new(cutoff, rate);
            let amplitude = gain(cutoff, rate, |x| pt1.step(x));
            assert!((amplitude - 0.5_f64.sqrt()).abs() < 1e-4, "PT1 {cutoff} of {rate}: {amplitude}");
            for (factor, expected) in [
                (1.0, 0.5_f64.sqrt()),
                // The bilinear transform maps the frequency f to tan(πf/fs), so the expected gain is that of a
                // Butterworth filter at the ratio of these tangents.
                (
                    2.0,
                    (1.0 + ((2.0 * PI * cutoff / rate).tan() / (PI * cutoff / rate).tan()).powi(8))
                        .sqrt()
                        .recip(),
                ),
            ] {
                let mut stages = butterworth_4(cutoff, rate).map(|section| Prefilter::new(Some(section)));
                let amplitude =
                    gain(factor * cutoff, rate, |x| stages.iter_mut().fold(x, |x, stage| stage.step(x)));
                assert!((amplitude / expected - 1.0).abs() < 1e-3, "{factor} × {cutoff}: {amplitude}");
            }
        }
    }
}
