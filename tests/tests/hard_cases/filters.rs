//! The prefilter in f32, compared with the same filter in f64.

use std::f64::consts::{PI, SQRT_2};

use flight_core::prefilter::{Biquad, Section};

/// A 2nd-order Butterworth low-pass in f64, in direct form I, which is a different structure.
struct Exact {
    b0: f64,
    a: [f64; 2],
    x: [f64; 2],
    y: [f64; 2],
}

impl Exact {
    fn new(cutoff_hz: f32, rate_hz: f32, x: f64) -> Self {
        let k = (PI * f64::from(cutoff_hz) / f64::from(rate_hz)).tan();
        let d = 1.0 + SQRT_2 * k + k * k;
        let a = [2.0 * (k * k - 1.0) / d, (1.0 - SQRT_2 * k + k * k) / d];
        Self { b0: k * k / d, a, x: [x; 2], y: [x; 2] }
    }

    fn step(&mut self, x: f64) -> f64 {
        let y = self.b0 * (x + 2.0 * self.x[0] + self.x[1]) - self.a[0] * self.y[0] - self.a[1] * self.y[1];
        (self.x, self.y) = ([x, self.x[0]], [y, self.y[0]]);
        y
    }
}

/// Returns the largest difference from f64 over these samples, with both filters settled on the first one.
fn max_difference(cutoff_hz: f32, rate_hz: f32, samples: impl Iterator<Item = f32>) -> f64 {
    let design = Biquad::butterworth(cutoff_hz, rate_hz).unwrap();
    let mut samples = samples.peekable();
    let first = *samples.peek().unwrap();
    let (mut ours, mut exact) =
        (Section::settled(&design, first), Exact::new(cutoff_hz, rate_hz, first.into()));
    samples
        .map(|x| {
            let (y, exact) = (ours.step(&design, x), exact.step(x.into()));
            assert!(y.is_finite(), "{cutoff_hz} Hz at {rate_hz} Hz");
            (f64::from(y) - exact).abs()
        })
        .fold(0.0, f64::max)
}

/// Returns the error that rounding may leave, as a share of the largest input. The gain error of the rounded
/// coefficients is 9e-8 divided by 1 + a₁ + a₂ = (2π f/f_s)². The rounding errors of a step, 4 ε, are divided by the
/// same number.
fn rounding_share(cutoff_hz: f32, rate_hz: f32) -> f64 {
    (9e-8 + 4.0 * f64::from(f32::EPSILON)) / (2.0 * PI * f64::from(cutoff_hz) / f64::from(rate_hz)).powi(2)
        + 1e-6
}

#[test]
fn prefilter_of_30_hz_at_8_and_32_khz_matches_f64() {
    for rate_hz in [8_000.0, 32_000.0] {
        // The input is a step of full scale, and the output is followed for a second.
        let samples = (0..rate_hz as u32).map(|k| if k < 10 { -2_000.0 } else { 2_000.0 });
        let max_difference = max_difference(30.0, rate_hz, samples);
        assert!(max_difference < 4_000.0 * rounding_share(30.0, rate_hz), "{rate_hz} Hz: {max_difference}");
    }
}

#[test]
fn cutoff_of_0_01_hz_is_refused_and_the_lowest_keeps_gain() {
    let error = Biquad::butterworth(0.01, 1_000.0).unwrap_err();
    assert_eq!(error.to_string(), "prefilter.cutoff_hz = 0.01: must be above 0.5 and below 499.5");
    let max_difference =
        max_difference(0.5001, 1_000.0, (0..60_000).map(|k| if k < 10 { 0.0 } else { 2_000.0 }));
    assert!(max_difference < 0.06 * 2_000.0, "{max_difference}");
    // Settled on a constant, the gain at zero frequency is that of the rounded coefficients, and within 1 %.
    let design = Biquad::butterworth(0.5001, 1_000.0).unwrap();
    let mut section = Section::settled(&design, 2_000.0);
    for _ in 0..100_000 {
        let y = section.step(&design, 2_000.0);
        assert!((y - 2_000.0).abs() < 20.0, "{y}");
    }
}

#[test]
fn cutoff_near_nyquist_is_refused_and_the_highest_filters() {
    // The filter's double pole nearly cancels its double zero at half the sample rate. What remains of the response to
    // a step alternates for a long time.
    let just_below = f32::from_bits(500.0_f32.to_bits() - 1);
    for cutoff_hz in [just_below, 499.999, 499.9, 500.0, f32::NAN] {
        let error = Biquad::butterworth(cutoff_hz, 1_000.0).unwrap_err();
        assert!(error.to_string().ends_with("must be above 0.5 and below 499.5"), "{error}");
    }
    for cutoff_hz in [490.0, 499.0, 499.4] {
        let samples = (0..100_000_u32).map(|k| if k.is_multiple_of(7) { 2_000.0 } else { -2_000.0 });
        let max_difference = max_difference(cutoff_hz, 1_000.0, samples);
        // The bound is the same as for low cutoffs, measured from half the rate.
        assert!(
            max_difference < 4_000.0 * rounding_share(500.0 - cutoff_hz, 1_000.0),
            "{cutoff_hz} Hz: {max_difference}"
        );
    }
}

#[test]
fn prefilter_keeps_a_constant_for_three_hours() {
    // The test runs for three hours at 1 kHz. The loss of a step stays the same once the states repeat.
    let design = Biquad::butterworth(30.0, 1_000.0).unwrap();
    for x in [9.80665_f32, -2_000.0, 1e-3, 0.0] {
        let mut section = Section::settled(&design, x);
        let first = section.step(&design, x);
        let last = (0..10_800_000).fold(first, |_, _| section.step(&design, x));
        assert!((last - x).abs() <= x.abs() * 2e-5 && (last - first).abs() <= x.abs() * 1e-5, "{x}: {last}");
    }
}

#[test]
fn prefilter_decays_to_zero_or_denormals() {
    // The decay ends at zero or at the smallest numbers. On the board denormals cost nothing: the FPU computes them in
    // hardware (Cortex-M4 TRM, 7.1), and the test on QEMU counts as many instructions as for other numbers.
    let design = Biquad::butterworth(30.0, 1_000.0).unwrap();
    let mut section = Section::settled(&design, 2_000.0);
    let last = (0..20_000).fold(f32::MAX, |_, _| section.step(&design, 0.0));
    assert!(last.abs() < 1e-37, "{last:e}");
}
