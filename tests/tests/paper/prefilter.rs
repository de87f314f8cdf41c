//! The 30 Hz Butterworth filter of section 3, and its effect on white noise.
//!
//! White noise of the two-sided density N through a filter of unit gain has the variance 2 N² B, where B is
//! the filter's equivalent noise bandwidth ∫₀^∞ |H|² df. For the analogue 2nd-order Butterworth |H|² is
//! 1/(1 + (f/f_c)⁴) and B = π/(2√2) f_c = 1.1107 f_c, so the deviation is √(60 · 1.1107) N = 8.1635 N.
//!
//! The bilinear filter with prewarping has the same |H|² over Ω = tan(π f/f_s)/K with K = tan(π f_c/f_s), so
//! its bandwidth is the integral of 1/((1 + Ω⁴)(1 + K²Ω²)), by partial fractions:
//! Σh² = K [(1 − K²)/√2 + K³]/(1 + K⁴). Its deviation is 0.24 % below the analogue one at 1 kHz and tends to it
//! with rising rate.

use flight_core::geometry::{Vec3, vec3};
use flight_core::prefilter::{Biquad, Prefilter};
use sim_host::flight::{Flight, Observer, StepView};
use sim_host::scene::Scene;

use crate::allan::OverlappingAllan;
use crate::spread::Spread;
use crate::still::{STILL, white_noise};

const CUTOFF_HZ: f64 = 30.0;
/// Decay of the filter's step response, 1/s: ω_c/√2.
const DECAY: f64 = std::f64::consts::TAU * CUTOFF_HZ * std::f64::consts::FRAC_1_SQRT_2;

fn filter(rate_hz: f32) -> Prefilter {
    Prefilter::new(Some(Biquad::butterworth(CUTOFF_HZ as f32, rate_hz).unwrap_or_else(|e| panic!("{e}"))))
}

/// Returns the deviation after the filter over N, by the closed form.
fn noise_gain(rate_hz: f64) -> f64 {
    let k = libm::tan(std::f64::consts::PI * CUTOFF_HZ / rate_hz);
    let energy = k * ((1.0 - k * k) * std::f64::consts::FRAC_1_SQRT_2 + k * k * k) / (1.0 + k * k * k * k);
    libm::sqrt(rate_hz * energy)
}

fn narrow(v: Vec3<f64>) -> Vec3<f32> {
    vec3(v.x as f32, v.y as f32, v.z as f32)
}

#[test]
fn noise_gain_tends_to_8_16() {
    let limit = libm::sqrt(2.0 * CUTOFF_HZ * std::f64::consts::PI / (2.0 * std::f64::consts::SQRT_2));
    assert!((limit - 8.1635).abs() < 1e-4);
    for (rate_hz, expected) in [(100.0_f32, 7.6966), (1000.0, 8.1436), (8000.0, 8.1632)] {
        // This is the energy of the impulse response of the flight code's filter, in f32.
        let mut filter = filter(rate_hz);
        filter.step(Vec3::ZERO);
        let mut energy = 0.0;
        for k in 0..(rate_hz as u32) {
            let y = f64::from(filter.step(vec3(if k == 0 { 1.0 } else { 0.0 }, 0.0, 0.0)).x);
            energy += y * y;
        }
        let gain = libm::sqrt(f64::from(rate_hz) * energy);
        let closed_form = noise_gain(f64::from(rate_hz));
        println!("{rate_hz} Hz: {gain:.6} {closed_form:.6}");
        assert!((closed_form - expected).abs() < 1e-4);
        // f32: at 8 kHz 1 + a₁ + a₂ is 5e-4, of which the rounding of a₁ is 1e-4.
        assert!((gain / closed_form - 1.0).abs() < 2e-4, "{gain} {closed_form}");
    }
    assert!((noise_gain(1e6) / limit - 1.0).abs() < 1e-8);
}

#[test]
fn filtered_noise_has_8_14_n_at_1_khz() {
    let n = 0.03228;
    let mut sensor = white_noise(n, 1000.0, 5, "paper.prefilter");
    let mut filter = filter(1000.0);
    let mut spreads = [Spread::default(); 3];
    for k in 0..5_000_000 {
        let y = filter.step(narrow(sensor.measure(Vec3::ZERO, &STILL)));
        if k > 200 {
            let axes = [y.x, y.y, y.z].map(f64::from);
            spreads.iter_mut().zip(axes).for_each(|(spread, y)| spread.add(y));
        }
    }
    for spread in spreads {
        spread.assert_deviation(8.1436 * n, samples_per_independent_square());
    }
}

/// Returns Σρ² at 1 kHz. ρ(u) = e^(−au)(cos au + sin au) with a = [`DECAY`], and ∫ρ² = 3/(2a): 11 ms.
fn samples_per_independent_square() -> f64 {
    1000.0 * 1.5 / DECAY
}

/// Records the spread of the flight controller's rates on the bench with the noise of table 2, °/s.
struct Rates([Spread; 3]);

impl Observer for Rates {
    fn step(&mut self, view: &StepView) {
        // After 20 s the gyroscope's zero, a mean over up to 10 s, hardly changes any more.
        if view.time_us >= 20_000_000 {
            let rates = view.output.rates_rad_s.unwrap();
            let axes = [rates.x, rates.y, rates.z].map(f64::from);
            self.0.iter_mut().zip(axes).for_each(|(spread, rate)| spread.add(rate.to_degrees()));
        }
    }
}

#[test]
fn chain_at_rest_has_the_filtered_noise_of_table_2() {
    let mut scene = Scene::load("static").unwrap_or_else(|error| panic!("{error}"));
    scene.duration_s = 600.0;
    let mut rates = Rates([Spread::default(); 3]);
    Flight::new(&scene, scene.seed).run(&mut rates);
    // The standard deviation is 0.263 °/s about x and 0.168 °/s about y and z.
    for (spread, deg_per_sqrt_h) in rates.0.iter().zip([1.9368, 1.239, 1.239]) {
        spread.assert_deviation(8.1436 * deg_per_sqrt_h / 60.0, samples_per_independent_square());
    }
}

/// An average over τ sees mostly low frequencies, but it begins and ends sharply, and the filter rounds these
/// ends. With r the autocorrelation of h and D = ∫|u| r(u) du = 1/(√2 ω_c), the variance
/// of a mean loses D/τ of itself and the covariance of neighbours gains D/2τ of it, so the Allan variance
/// loses 3D/2τ and the deviation half of that: ¾/(√2 · 2π · 30 Hz · 1 s) = 0.281 %.
#[test]
fn filter_lowers_the_allan_deviation_at_1_s_by_0_28_percent() {
    let expected = -0.75 / (std::f64::consts::SQRT_2 * std::f64::consts::TAU * CUTOFF_HZ);
    assert!((-0.003..-0.002).contains(&expected) && (expected + 0.002_813).abs() < 1e-6);
    // The same noise with and without the filter, so that only the filter's effect on the ends of the means differs;
    // overlapping means, so that there is an end at every sample. The scatter of the change between independent records
    // gives its error.
    let mut changes = Spread::default();
    for seed in 0..32 {
        let mut sensor = white_noise(0.03, 1000.0, seed, "paper.prefilter");
        let mut filter = filter(1000.0);
        let mut pairs: [_; 3] =
            std::array::from_fn(|_| [OverlappingAllan::new(1000), OverlappingAllan::new(1000)]);
        for k in 0..200_000 {
            let raw = narrow(sensor.measure(Vec3::ZERO, &STILL));
            let smooth = filter.step(raw);
            if k < 200 {
                continue;
            }
            for ([before, after], (raw, smooth)) in
                pairs.iter_mut().zip([(raw.x, smooth.x), (raw.y, smooth.y), (raw.z, smooth.z)])
            {
                before.add(f64::from(raw));
                after.add(f64::from(smooth));
            }
        }
        for [before, after] in &pairs {
            changes.add(after.deviation() / before.deviation() - 1.0);
        }
    }
    let error = changes.deviation() / libm::sqrt(changes.count());
    println!("ADEV(1 s) changes by {:.4} ± {:.4} %", 100.0 * changes.mean(), 100.0 * error);
    assert!(error < 0.000_2, "too few records: {error}");
    assert!((changes.mean() - expected).abs() < 5.0 * error, "{} ± {error}", changes.mean());
}
