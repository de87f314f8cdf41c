//! The prefilter: a second-order Butterworth low-pass on every axis (section 3 of the paper: 30 Hz).
//!
//! The coefficients are computed at run time, for any cutoff below the Nyquist frequency, by the bilinear transform
//! with prewarping. The filter runs in direct form II transposed: three products and five sums per sample, with two
//! states. The first sample initializes the states as if this input had always been present, so that a constant input
//! causes no transient.

use crate::geometry::{Vec3, vec3};
use crate::range::{ConfigError, check};

/// Largest ratio of sample rate to cutoff. The gain at zero frequency is 4K²/(D (1 + a₁ + a₂)). In exact arithmetic
/// the sum 1 + a₁ + a₂ is 4K²/D; the rounding of a₁ and a₂ to f32 changes it by up to 9e-8. With K = π/2,000 the sum
/// is 9.9e-6 and the gain is correct to 1 %; at a tenth of that cutoff the gain would be arbitrary or infinite. At
/// the same distance below half the sample rate the gain at half the sample rate has the same limit.
pub const MAX_RATE_PER_CUTOFF: f32 = 2_000.0;

/// Coefficients of one second-order low-pass section:
/// y\[k\] = b₀(x\[k\] + 2x\[k−1\] + x\[k−2\]) − a₁y\[k−1\] − a₂y\[k−2\].
///
/// The bilinear transform places both zeros of a low-pass at half the sample rate, so one b₀ represents all three
/// feed-forward coefficients.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Biquad {
    /// Feed-forward coefficient b₀.
    pub b0: f32,
    /// Feedback coefficients a₁ and a₂.
    pub a: [f32; 2],
}

impl Biquad {
    /// Designs a second-order Butterworth low-pass with its −3 dB point at `cutoff_hz` (Hz) for samples at `rate_hz`
    /// (Hz).
    ///
    /// With K = tan(π f_c/f_s) and D = 1 + √2K + K², the analogue prototype 1/(s² + √2 s + 1) becomes b = (K², 2K²,
    /// K²)/D, a₁ = 2(K² − 1)/D, a₂ = (1 − √2K + K²)/D. The computation is in f64: at 30 Hz and 8 kHz, 1 + a₁ + a₂ is
    /// 5e-4, and its relative error is the relative error of the gain.
    ///
    /// # Errors
    /// Returns a rate outside 1 Hz to 1 MHz, or a cutoff that is not above `rate_hz`/[`MAX_RATE_PER_CUTOFF`] or not
    /// at least as far below half of the rate.
    pub fn butterworth(cutoff_hz: f32, rate_hz: f32) -> Result<Self, ConfigError> {
        check("prefilter.rate_hz", rate_hz, 1.0, 1.0e6)?;
        let min_hz = rate_hz / MAX_RATE_PER_CUTOFF;
        if !(cutoff_hz > min_hz && cutoff_hz < 0.5 * rate_hz - min_hz) {
            return Err(ConfigError {
                field: "prefilter.cutoff_hz",
                value: cutoff_hz,
                minimum: min_hz,
                maximum: 0.5 * rate_hz - min_hz,
                exclusive: true,
            });
        }
        let k = libm::tan(core::f64::consts::PI * f64::from(cutoff_hz) / f64::from(rate_hz));
        let k2 = k * k;
        let root2_k = core::f64::consts::SQRT_2 * k;
        let d = 1.0 + root2_k + k2;
        Ok(Self {
            b0: (k2 / d) as f32,
            a: [(2.0 * (k2 - 1.0) / d) as f32, ((1.0 - root2_k + k2) / d) as f32],
        })
    }

    /// Returns the gain at zero frequency with the rounded coefficients: 1 except for rounding.
    fn dc_gain(&self) -> f32 {
        let [a1, a2] = self.a;
        4.0 * self.b0 / ((1.0 + a1) + a2)
    }
}

/// State of the filter of one axis, in direct form II transposed.
#[derive(Clone, Copy, Debug, Default)]
pub struct Section {
    s1: f32,
    s2: f32,
}

impl Section {
    /// Filters one sample with the coefficients `c`.
    #[inline(always)]
    pub fn step(&mut self, c: &Biquad, x: f32) -> f32 {
        let [a1, a2] = c.a;
        let fed = c.b0 * x;
        let y = fed + self.s1;
        self.s1 = (fed + fed) - a1 * y + self.s2;
        self.s2 = fed - a2 * y;
        y
    }

    /// Returns the state after a constant input `x` has settled.
    pub fn settled(c: &Biquad, x: f32) -> Self {
        let y = c.dc_gain() * x;
        let fed = c.b0 * x;
        Self { s1: y - fed, s2: fed - c.a[1] * y }
    }
}

/// The prefilter of one three-axis sensor.
#[derive(Clone, Copy, Debug)]
pub struct Prefilter {
    design: Biquad,
    axes: [Section; 3],
    stage: Stage,
}

/// State of the prefilter. One field for "has a filter" and "has started", so that each sample needs one comparison.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Stage {
    Off,
    Fresh,
    Running,
}

impl Prefilter {
    /// Creates a prefilter with the given coefficients. `None` passes every sample unchanged.
    pub fn new(design: Option<Biquad>) -> Self {
        Self {
            design: design.unwrap_or_default(),
            axes: [Section::default(); 3],
            stage: if design.is_some() { Stage::Fresh } else { Stage::Off },
        }
    }

    /// Filters one sample of three axes, in any unit. A sample that is not finite remains in the state until
    /// [`Self::restart`].
    #[inline(always)]
    pub fn step(&mut self, x: Vec3<f32>) -> Vec3<f32> {
        if self.stage != Stage::Running {
            if self.stage == Stage::Off {
                return x;
            }
            self.start(x);
        }
        let c = &self.design;
        let [ax, ay, az] = &mut self.axes;
        vec3(ax.step(c, x.x), ay.step(c, x.y), az.step(c, x.z))
    }

    /// Initializes the states. Not inlined: merged into [`Self::step`] it would cost every other sample four more
    /// instructions per axis, because the states would not stay in memory until they are used.
    #[cold]
    #[inline(never)]
    fn start(&mut self, x: Vec3<f32>) {
        self.stage = Stage::Running;
        self.axes = <[f32; 3]>::from(x).map(|x| Section::settled(&self.design, x));
    }

    /// Resets the filter: the next sample initializes the states, without a transient.
    pub fn restart(&mut self) {
        if self.stage == Stage::Running {
            self.stage = Stage::Fresh;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::num::f32::ANY;
    use proptest::prelude::*;

    /// An independent design: scipy 1.17.1, `scipy.signal.butter(2, cutoff, fs=rate)`.
    const SCIPY: [(f32, f32, [f64; 3], [f64; 2]); 5] = [
        (
            30.0,
            1000.0,
            [0.007820208033497193, 0.015640416066994386, 0.007820208033497193],
            [-1.734725768809275, 0.766_006_600_943_263_8],
        ),
        (
            30.0,
            100.0,
            [0.39133577250176854, 0.7826715450035371, 0.39133577250176854],
            [0.3695273773512411, 0.19581571265583297],
        ),
        (
            30.0,
            8000.0,
            [0.0001365107220938609, 0.0002730214441877218, 0.0001365107220938609],
            [-1.9666813852634852, 0.9672274281518607],
        ),
        (
            100.0,
            1000.0,
            [0.0674552738890719, 0.1349105477781438, 0.0674552738890719],
            [-1.1429805025399011, 0.41280159809618877],
        ),
        (
            499.0,
            1000.0,
            [0.995566972017647, 1.991133944035294, 0.995566972017647],
            [1.9911142922016531, 0.9911535958689351],
        ),
    ];

    #[test]
    fn coefficients_equal_the_scipy_design() {
        for (cutoff, rate, b, a) in SCIPY {
            let ours = Biquad::butterworth(cutoff, rate).unwrap();
            let fed = [ours.b0, 2.0 * ours.b0, ours.b0];
            for (ours, theirs) in fed.into_iter().zip(b).chain(ours.a.into_iter().zip(a)) {
                // The bound is the rounding of the result to f32, plus that of the cutoff to f32.
                assert!(
                    (f64::from(ours) - theirs).abs() <= 1.5e-7 * theirs.abs(),
                    "{cutoff} Hz at {rate} Hz"
                );
            }
        }
    }

    #[test]
    fn cutoff_out_of_range_error_names_the_range() {
        for cutoff in [499.5, 500.0, 1e4, 0.5, 0.0, -1.0, f32::NAN] {
            let error = Biquad::butterworth(cutoff, 1000.0).unwrap_err();
            assert_eq!((error.field, error.maximum), ("prefilter.cutoff_hz", 499.5));
        }
        assert!(Biquad::butterworth(30.0, 0.0).is_err());
    }

    /// Returns the gain at a frequency, measured from the response to a long sine: a second method beside the
    /// coefficients.
    fn gain_at(frequency_hz: f64, cutoff_hz: f32, rate_hz: f32) -> f64 {
        let c = Biquad::butterworth(cutoff_hz, rate_hz).unwrap();
        let mut s = Section::default();
        let (mut sin_sum, mut cos_sum, mut n) = (0.0, 0.0, 0);
        for k in 0..40_000 {
            let phase = core::f64::consts::TAU * frequency_hz * f64::from(k) / f64::from(rate_hz);
            let y = f64::from(s.step(&c, phase.sin() as f32));
            if k >= 20_000 {
                sin_sum += y * phase.sin();
                cos_sum += y * phase.cos();
                n += 1;
            }
        }
        2.0 * (sin_sum * sin_sum + cos_sum * cos_sum).sqrt() / f64::from(n)
    }

    #[test]
    #[cfg_attr(miri, ignore = "40,000 steps of each design")]
    fn half_power_at_the_cutoff() {
        for (cutoff, rate) in [(30.0, 1000.0), (30.0, 100.0), (100.0, 8000.0)] {
            let gain = gain_at(f64::from(cutoff), cutoff, rate);
            assert!((gain - core::f64::consts::FRAC_1_SQRT_2).abs() < 1e-3, "{gain}");
        }
    }

    proptest! {
        #[test]
        fn constant_input_has_no_transient(
            x in -2000.0_f32..2000.0, share in 1.01 / MAX_RATE_PER_CUTOFF..0.45, rate in 1.0_f32..32_000.0,
        ) {
            let cutoff = share * rate;
            let mut filter = Prefilter::new(Some(Biquad::butterworth(cutoff, rate).unwrap()));
            let first = filter.step(vec3(x, -x, 0.0));
            // The gain of the rounded coefficients is within 1e-5 above 30 Hz at 1 kHz. A step adds rounding errors
            // of at most 4 ε |x|: ε/2 in y, 5ε/2 in s₁ and ε in s₂, each multiplied by that gain.
            let rounding = 4.0 * f32::EPSILON / (core::f32::consts::TAU * cutoff / rate).powi(2) + 1e-6;
            prop_assert!((first.x - x).abs() <= rounding.min(0.01) * x.abs());
            for _ in 0..2000 {
                let y = filter.step(vec3(x, -x, 0.0));
                prop_assert!((y.x - first.x).abs() <= rounding * x.abs() + 1e-6);
                prop_assert_eq!(y.z, 0.0);
            }
        }
    }

    /// Valid cutoffs and rates, Hz.
    fn design() -> impl Strategy<Value = (f32, f32)> {
        let share =
            prop_oneof![1.01 / MAX_RATE_PER_CUTOFF..0.5 - 1.01 / MAX_RATE_PER_CUTOFF, 0.001..0.05_f32];
        (share, 1.0_f32..=32_000.0).prop_map(|(share, rate_hz)| (share * rate_hz, rate_hz))
    }

    proptest! {
        /// The Butterworth gain in closed form, |H|² = 1/(1 + (tan(π f/f_s)/tan(π f_c/f_s))⁴), equals the transfer
        /// function of the coefficients on the unit circle.
        #[test]
        fn gain_follows_the_butterworth_formula((cutoff_hz, rate_hz) in design(), at in 0.0..0.49_f64) {
            use core::f64::consts::PI;
            let c = Biquad::butterworth(cutoff_hz, rate_hz).unwrap();
            let wanted = ((PI * at).tan() / (PI * f64::from(cutoff_hz) / f64::from(rate_hz)).tan()).powi(4);
            // z⁻¹ = cos ω − i sin ω.
            let at_circle = |first: f64, second: f64, third: f64| {
                let (s1, c1) = (2.0 * PI * at).sin_cos();
                let (s2, c2) = (4.0 * PI * at).sin_cos();
                (first + second * c1 + third * c2).powi(2) + (second * s1 + third * s2).powi(2)
            };
            let [a1, a2] = c.a.map(f64::from);
            let b0 = f64::from(c.b0);
            let squared = at_circle(b0, 2.0 * b0, b0) / at_circle(1.0, a1, a2);
            // Rounding of the coefficients causes an error of 1 % at the ends of the range, as
            // `MAX_RATE_PER_CUTOFF` documents. The square doubles it.
            prop_assert!((squared - 1.0 / (1.0 + wanted)).abs() < 0.025, "{}", squared);
            // A pole outside the unit circle would be a growing oscillation.
            prop_assert!(a2.abs() < 1.0 && a1.abs() < 1.0 + a2);
        }

        /// The filter equals a second form of itself, direct form I in f64, which stores inputs and outputs.
        #[test]
        fn section_equals_the_difference_equation(
            (cutoff_hz, rate_hz) in design(), start in -1000.0..1000.0_f32, x in prop::collection::vec(-1000.0..1000.0_f32, 1..100),
        ) {
            let c = Biquad::butterworth(cutoff_hz, rate_hz).unwrap();
            let [a1, a2] = c.a.map(f64::from);
            let b0 = f64::from(c.b0);
            // The sum in the gain is exact in f32, so the settled state is correct to a few units in the last place.
            let gain = 4.0 * b0 / (1.0 + a1 + a2);
            let mut ours = Section::settled(&c, start);
            let y = gain * f64::from(start);
            let last_place = f64::from(f32::EPSILON) * y.abs();
            prop_assert!((f64::from(ours.s1) - (y - b0 * f64::from(start))).abs() <= 4.0 * last_place);
            prop_assert!((f64::from(ours.s2) - (b0 * f64::from(start) - a2 * y)).abs() <= 4.0 * last_place);

            let (mut x1, mut x2) = (f64::from(start), f64::from(start));
            let (mut y1, mut y2) = (y, y);
            let mut axes = Prefilter::new(Some(c));
            for x in core::iter::once(start).chain(x) {
                let y = b0 * (f64::from(x) + 2.0 * x1 + x2) - a1 * y1 - a2 * y2;
                (x2, x1, y2, y1) = (x1, f64::from(x), y1, y);
                let found = ours.step(&c, x);
                // Rounding errors accumulate over 1/ω_c samples, as in the test of a constant input above, and in the
                // same way near half the sample rate.
                let share = f64::from(cutoff_hz / rate_hz);
                let summed = 1.0 / (core::f64::consts::TAU * share.min(0.5 - share)).powi(2);
                let rounding = 1000.0 * 8.0 * f64::from(f32::EPSILON) * (1.0 + summed);
                prop_assert!((f64::from(found) - y).abs() <= rounding, "{} {}", found, y);
                // The three axes are independent.
                prop_assert_eq!(axes.step(vec3(x, 0.0, -x)), vec3(found, 0.0, -found));
            }
        }

        #[test]
        fn any_design_is_valid_or_rejected(
            cutoff_hz in prop_oneof![0.0..600.0_f32, ANY], rate_hz in prop_oneof![4 => Just(1000.0_f32), 1 => ANY],
        ) {
            let valid = (1.0..=1.0e6).contains(&rate_hz)
                && cutoff_hz > rate_hz / 2_000.0 && cutoff_hz < 0.5 * rate_hz - rate_hz / 2_000.0;
            let design = Biquad::butterworth(cutoff_hz, rate_hz);
            prop_assert_eq!(design.is_ok(), valid);
            if let Ok(Biquad { b0, a: [a1, a2] }) = design {
                prop_assert!(b0 > 0.0 && b0 < 1.0 && a1.abs() < 2.0 && a2.abs() < 1.0);
            }
        }

        #[test]
        fn no_design_passes_every_sample_unchanged(samples in prop::collection::vec([ANY, ANY, ANY], 1..10)) {
            let mut filter = Prefilter::new(None);
            for [x, y, z] in samples {
                let passed = filter.step(vec3(x, y, z));
                prop_assert_eq!(<[f32; 3]>::from(passed).map(f32::to_bits), [x, y, z].map(f32::to_bits));
                filter.restart();
            }
        }

        /// A NaN or infinite sample stays in the state until a restart removes it completely. In operation samples
        /// come from integer counts and are always finite.
        #[test]
        fn restart_removes_any_state(before in prop::collection::vec([ANY, ANY, ANY], 0..5), x in -1000.0..1000.0_f32) {
            let c = Biquad::butterworth(30.0, 1000.0).unwrap();
            let [mut used, mut fresh] = [Prefilter::new(Some(c)); 2];
            for sample in before {
                used.step(sample.into());
            }
            used.restart();
            for k in 0..20_u8 {
                let sample = vec3(x + f32::from(k), -x, 0.5 * x);
                prop_assert_eq!(used.step(sample), fresh.step(sample));
            }
        }
    }

    #[test]
    fn restart_starts_without_a_transient() {
        let mut filter = Prefilter::new(Some(Biquad::butterworth(30.0, 1000.0).unwrap()));
        filter.step(vec3(5.0, 5.0, 5.0));
        filter.restart();
        assert!((filter.step(vec3(1.0, 2.0, 3.0)) - vec3(1.0, 2.0, 3.0)).norm() < 1e-4);
    }
}
