//! The prefilter in f32, against the same one in f64.

use std::f64::consts::{PI, SQRT_2};

use flight_core::prefilter::{Biquad, Section};

/// A Butterworth low-pass of 2nd order in f64, in direct form I: another structure.
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

/// Largest difference from f64 over these samples, and from the first on settled.
fn apart(cutoff_hz: f32, rate_hz: f32, samples: impl Iterator<Item = f32>) -> f64 {
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

/// What rounding may leave, as a share of the largest input: the gain of the rounded coefficients is off by 9e-8 over
/// 1 + a₁ + a₂ = (2π f/f_s)², and a step's 4 ε of rounding come through with the same gain.
fn share_lost(cutoff_hz: f32, rate_hz: f32) -> f64 {
    (9e-8 + 4.0 * f64::from(f32::EPSILON)) / (2.0 * PI * f64::from(cutoff_hz) / f64::from(rate_hz)).powi(2)
        + 1e-6
}

#[test]
fn thirty_hertz_at_8_and_32_khz() {
    for rate_hz in [8_000.0, 32_000.0] {
        // A step of full scale, and a second of it.
        let samples = (0..rate_hz as u32).map(|k| if k < 10 { -2_000.0 } else { 2_000.0 });
        let apart = apart(30.0, rate_hz, samples);
        assert!(apart < 4_000.0 * share_lost(30.0, rate_hz), "{rate_hz} Hz: {apart}");
    }
}

#[test]
fn a_hundredth_of_a_hertz_at_1_khz_is_refused_and_the_lowest_that_is_not_keeps_its_gain() {
    let error = Biquad::butterworth(0.01, 1_000.0).unwrap_err();
    assert_eq!(error.to_string(), "prefilter.cutoff_hz = 0.01: must be above 0.5 and below 499.5");
    let apart = apart(0.5001, 1_000.0, (0..60_000).map(|k| if k < 10 { 0.0 } else { 2_000.0 }));
    assert!(apart < 0.06 * 2_000.0, "{apart}");
    // The gain at zero frequency is that of the rounded coefficients, and within 1 %: settled on a constant.
    let design = Biquad::butterworth(0.5001, 1_000.0).unwrap();
    let mut section = Section::settled(&design, 2_000.0);
    for _ in 0..100_000 {
        let y = section.step(&design, 2_000.0);
        assert!((y - 2_000.0).abs() < 20.0, "{y}");
    }
}

#[test]
fn a_hair_below_nyquist_is_refused_and_the_highest_that_is_not_filters() {
    // Its double pole all but meets its double zero at half the rate, and what is left of a step alternates for long.
    let just_below = f32::from_bits(500.0_f32.to_bits() - 1);
    for cutoff_hz in [just_below, 499.999, 499.9, 500.0, f32::NAN] {
        let error = Biquad::butterworth(cutoff_hz, 1_000.0).unwrap_err();
        assert!(error.to_string().ends_with("must be above 0.5 and below 499.5"), "{error}");
    }
    for cutoff_hz in [490.0, 499.0, 499.4] {
        let samples = (0..100_000_u32).map(|k| if k.is_multiple_of(7) { 2_000.0 } else { -2_000.0 });
        let apart = apart(cutoff_hz, 1_000.0, samples);
        // The same arithmetic as for low cutoffs, seen from half the rate.
        assert!(apart < 4_000.0 * share_lost(500.0 - cutoff_hz, 1_000.0), "{cutoff_hz} Hz: {apart}");
    }
}

#[test]
fn hours_of_a_constant_stay_where_they_are() {
    // Three hours at 1 kHz. What a step loses is the same in every step once the states repeat.
    let design = Biquad::butterworth(30.0, 1_000.0).unwrap();
    for x in [9.80665_f32, -2_000.0, 1e-3, 0.0] {
        let mut section = Section::settled(&design, x);
        let first = section.step(&design, x);
        let last = (0..10_800_000).fold(first, |_, _| section.step(&design, x));
        assert!((last - x).abs() <= x.abs() * 2e-5 && (last - first).abs() <= x.abs() * 1e-5, "{x}: {last}");
    }
}

#[test]
fn a_tail_of_denormals_ends() {
    // It ends at zero, or at the smallest numbers there are. On the board it costs nothing: the FPU computes denormals in
    // hardware (Cortex-M4 TRM, 7.1), and the emulated board's test counts as many instructions as for other numbers.
    let design = Biquad::butterworth(30.0, 1_000.0).unwrap();
    let mut section = Section::settled(&design, 2_000.0);
    let last = (0..20_000).fold(f32::MAX, |_, _| section.step(&design, 0.0));
    assert!(last.abs() < 1e-37, "{last:e}");
}
