//! The f32 functions of the control loop.
//!
//! `libm::sinf` computes in f64, which the Cortex-M4F does in software: 1,260 instructions. These functions stay in
//! f32 and have few branches. Each is the same sequence of additions and multiplications on every machine, so that
//! the host and the board produce the same bits.
//!
//! | function | domain | largest error against f64 (tested) |
//! |---|---|---|
//! | [`sin_cos`] | ±π (to ±8,192: 1e-6) | 2 ulp |
//! | [`atan2`], [`direction`], [`elevation`] | all finite | 4e-7 rad |
//! | [`sqrt`] | all | correctly rounded |
//! | [`wrap_pi`] | ±1,000 rad | 1 ulp of the argument |
//!
//! A NaN argument gives NaN. The result outside the domain is unspecified, except where the function documents it;
//! callers stay inside the domain.

use core::f32::consts::{FRAC_PI_2, PI, TAU};

/// 1.5 · 2²³. Added to |x| < 2²² it leaves no bits below the binary point: the sum is x rounded to the nearest
/// integer, which is also in the low bits of the sum. Three instructions instead of a function call.
const ROUNDER: f32 = 12_582_912.0;

/// Returns the correctly rounded square root; NaN for a negative argument.
///
/// On the Cortex-M4F this is one `vsqrt.f32` (14 cycles) instead of the 56 instructions of a software root.
#[inline(always)]
pub fn sqrt(x: f32) -> f32 {
    #[cfg(all(target_arch = "arm", target_abi = "eabihf"))]
    {
        let bits: u32;
        // SAFETY: the hard-float ABI guarantees an FPU. The value passes through a core register, because this target
        // rejects operands in `s` registers. s0 is declared as clobbered; memory, flags and the stack are not
        // touched.
        unsafe {
            core::arch::asm!(
                "vmov s0, {0}",
                "vsqrt.f32 s0, s0",
                "vmov {0}, s0",
                inlateout(reg) x.to_bits() => bits,
                out("s0") _,
                options(pure, nomem, nostack, preserves_flags),
            );
        }
        f32::from_bits(bits)
    }
    #[cfg(not(all(target_arch = "arm", target_abi = "eabihf")))]
    {
        libm::sqrtf(x)
    }
}

/// Returns the larger of two numbers; `b` if `a` is NaN.
///
/// `f32::max` must also handle a NaN in `b`, and calls a function for it on the Cortex-M4F.
#[inline(always)]
pub fn max(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// Returns the smaller of two numbers; `b` if `a` is NaN.
#[inline(always)]
pub fn min(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

/// Returns the sine and cosine of `x` (rad), |x| ≤ 8,192.
///
/// The argument is reduced to ±π/4 by π/2 in three parts. The first two are short enough that their products with the
/// quadrant number are exact (Cody and Waite, *Software Manual for the Elementary Functions*, 1980). The polynomials
/// are the minimax polynomials of Cephes for single precision (Moshier, `sinf.c`).
#[inline]
pub fn sin_cos(x: f32) -> (f32, f32) {
    // HIGH + MIDDLE + LOW equals π/2 to 2.4e-15.
    const HIGH: f32 = 1.570_312_5;
    const MIDDLE: f32 = 4.837_513e-4;
    const LOW: f32 = 7.549_79e-8;

    let shifted = x * (1.0 / FRAC_PI_2) + ROUNDER;
    let quadrant = shifted.to_bits();
    let n = shifted - ROUNDER;
    let r = ((x - n * HIGH) - n * MIDDLE) - n * LOW;
    let u = r * r;

    let s = r + r * u * (-1.666_665_5e-1 + u * (8.332_161e-3 - u * 1.951_529_6e-4));
    let c = 1.0 - 0.5 * u + u * u * (4.166_664_6e-2 + u * (-1.388_731_6e-3 + u * 2.443_315_7e-5));

    let (s, c) = if quadrant & 1 == 0 { (s, c) } else { (c, s) };
    // Sine is negative in quadrants 2 and 3, cosine in 1 and 2: move that bit to the sign.
    let sin_sign = (quadrant & 2) << 30;
    let cos_sign = (quadrant.wrapping_add(1) & 2) << 30;
    (f32::from_bits(s.to_bits() ^ sin_sign), f32::from_bits(c.to_bits() ^ cos_sign))
}

/// Returns the angle of the point (x, y) from the x axis, rad, in [−π, π]; `atan2(0, 0)` is 0.
#[inline]
pub fn atan2(y: f32, x: f32) -> f32 {
    if y == 0.0 {
        // 0 times x is 0, or NaN for a NaN.
        return if x < 0.0 { PI } else { 0.0 * x };
    }
    direction(y, x)
}

/// Returns [`atan2`] of a point other than (0, 0), for which the result is NaN. No branches.
#[inline(always)]
pub fn direction(y: f32, x: f32) -> f32 {
    let angle = first_quadrant(y.abs(), x.abs());
    let half_plane = if x < 0.0 { PI - angle } else { angle };
    if y < 0.0 { -half_plane } else { half_plane }
}

/// Returns [`atan2`] of a point other than (0, 0) with x ≥ 0: an angle in [−π/2, π/2].
#[inline(always)]
pub fn elevation(y: f32, x: f32) -> f32 {
    let angle = first_quadrant(y.abs(), x);
    if y < 0.0 { -angle } else { angle }
}

/// Returns the angle of a point other than (0, 0) whose coordinates are not negative.
///
/// The ratio t of the smaller to the larger coordinate is in [0, 1], where atan t = t + t³ Q(t²). Q is a minimax
/// polynomial (Lawson iteration in f64; error in f32 1.6e-7 rad).
#[inline(always)]
fn first_quadrant(y: f32, x: f32) -> f32 {
    let steep = y > x;
    let (low, high) = if steep { (x, y) } else { (y, x) };
    let t = low / high;
    let u = t * t;
    let q = -0.333_324_64
        + u * (0.199_756_09
            + u * (-0.140_503_76
                + u * (0.099_954_57 + u * (-0.060_609_795 + u * (0.025_035_46 - u * 0.004_909_855)))));
    let octant = t + t * u * q;
    if steep { FRAC_PI_2 - octant } else { octant }
}

/// Subtracts from `x` (rad, |x| ≤ 1,000) the nearest number of whole turns. Returns an angle in [−π, π].
#[inline(always)]
pub fn wrap_pi(x: f32) -> f32 {
    let turns = (x * (1.0 / TAU) + ROUNDER) - ROUNDER;
    // 2π in two parts. Products of the first with small integers are exact, so that many turns lose no precision.
    (x - turns * 6.281_25) - turns * 1.935_307_2e-3
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::num::f32::ANY;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn sqrt_equals_the_standard_library(x in ANY) {
            let exact = x.sqrt();
            prop_assert!(sqrt(x).to_bits() == exact.to_bits() || (sqrt(x).is_nan() && exact.is_nan()));
        }

        #[test]
        fn max_and_min_equal_std_except_for_nan(a in ANY, b in ANY) {
            if a.is_nan() || b.is_nan() {
                // If either operand is NaN, the result is the second operand.
                prop_assert_eq!((max(a, b).to_bits(), min(a, b).to_bits()), (b.to_bits(), b.to_bits()));
            } else {
                prop_assert_eq!((max(a, b), min(a, b)), (a.max(b), a.min(b)));
            }
        }

        #[test]
        fn sin_cos_is_accurate_up_to_8192(x in -8192.0_f32..=8192.0, any in ANY) {
            let (s, c) = sin_cos(x);
            prop_assert!((f64::from(s) - f64::from(x).sin()).abs() < 1e-6, "sin {}: {}", x, s);
            prop_assert!((f64::from(c) - f64::from(x).cos()).abs() < 1e-6, "cos {}: {}", x, c);
            let (s, c) = sin_cos(any);
            prop_assert!(any.is_finite() || (s.is_nan() && c.is_nan()), "{}: {} {}", any, s, c);
        }

        /// Compares the angle of any two numbers with that of the standard library in f64. A negative zero counts
        /// as zero here.
        #[test]
        fn atan2_of_any_two_numbers_is_accurate(y in ANY, x in ANY) {
            let ours = [atan2(y, x), direction(y, x), elevation(y, x.abs())].map(f64::from);
            let (exact_y, exact_x) = (f64::from(y) + 0.0, f64::from(x) + 0.0);
            if y.is_finite() && x.is_finite() {
                prop_assert!((ours[0] - exact_y.atan2(exact_x)).abs() <= 4e-7, "({}, {}): {:?}", y, x, ours);
                if (y, x) != (0.0, 0.0) {
                    prop_assert!((ours[1] - exact_y.atan2(exact_x)).abs() <= 4e-7, "({}, {}): {:?}", y, x, ours);
                    prop_assert!((ours[2] - exact_y.atan2(exact_x.abs())).abs() <= 4e-7, "({}, {}): {:?}", y, x, ours);
                }
            } else if y.is_nan() || x.is_nan() || (y.is_infinite() && x.is_infinite()) {
                prop_assert!(ours.iter().all(|angle| angle.is_nan()), "({}, {}): {:?}", y, x, ours);
            }
        }

        #[test]
        fn direction_of_the_origin_is_nan(
            y in prop::sample::select(&[0.0_f32, -0.0][..]), x in prop::sample::select(&[0.0_f32, -0.0][..]),
        ) {
            prop_assert!(atan2(y, x) == 0.0 && direction(y, x).is_nan() && elevation(y, x).is_nan());
        }

        /// Against the remainder in f64.
        #[test]
        fn wrap_pi_equals_the_remainder_in_f64(x in -1000.0_f32..=1000.0, any in ANY) {
            let turns = (f64::from(x) / core::f64::consts::TAU).round();
            let exact = f64::from(x) - turns * core::f64::consts::TAU;
            let ulp = f64::from(x.abs().next_up() - x.abs());
            let wrapped = f64::from(wrap_pi(x));
            // π and −π are the same angle.
            let off = (wrapped - exact).abs();
            let off = off.min((off - core::f64::consts::TAU).abs());
            prop_assert!(off <= ulp, "{}: {} off", x, off);
            prop_assert!(wrapped.abs() <= core::f64::consts::PI + ulp);
            prop_assert!(any.is_finite() || wrap_pi(any).is_nan());
        }
    }

    /// Returns the distance of `y` from `exact` in units in the last place of the f32 nearest to `exact`.
    fn ulps(y: f32, exact: f64) -> f64 {
        let nearest = exact as f32;
        let spacing = f64::from(f32::from_bits(nearest.abs().to_bits() + 1)) - f64::from(nearest.abs());
        (f64::from(y) - exact).abs() / spacing
    }

    #[test]
    fn sin_cos_is_within_2_ulp_on_plus_minus_pi() {
        // Every 997th f32 of [2⁻²⁰, π] is tested. These are 180,000 points, as dense as the f32 numbers.
        let mut worst = 0.0_f64;
        let stride = if cfg!(miri) { 997_997 } else { 997 };
        for bits in ((2.0_f32.powi(-20)).to_bits()..=PI.to_bits()).step_by(stride) {
            let x = f32::from_bits(bits);
            for x in [x, -x] {
                let (s, c) = sin_cos(x);
                worst = worst.max(ulps(s, f64::from(x).sin())).max(ulps(c, f64::from(x).cos()));
            }
        }
        assert!(worst <= 2.0, "{worst} ulp");
    }

    #[test]
    fn sin_cos_at_the_ends_of_its_domain() {
        assert_eq!(sin_cos(0.0), (0.0, 1.0));
        let (s, c) = sin_cos(PI);
        assert!(ulps(s, f64::from(PI).sin()) <= 2.0 && c == -1.0);
        let (s, c) = sin_cos(8192.0);
        assert!(
            (f64::from(s) - 8192.0_f64.sin()).abs() < 1e-6 && (f64::from(c) - 8192.0_f64.cos()).abs() < 1e-6
        );
        assert!(sin_cos(f32::NAN).0.is_nan());
    }

    #[test]
    fn atan2_is_within_4e_7_rad_at_all_angles() {
        let mut worst = 0.0_f64;
        for i in (0..1_000_000).step_by(if cfg!(miri) { 9_973 } else { 1 }) {
            let angle = (f64::from(i) / 1e6 - 0.5) * core::f64::consts::TAU;
            let radius = 10.0_f64.powf(f64::from(i % 13) - 6.0);
            let (y, x) = ((radius * angle.sin()) as f32, (radius * angle.cos()) as f32);
            worst = worst.max((f64::from(atan2(y, x)) - f64::from(y).atan2(f64::from(x))).abs());
            let right = f64::from(y).atan2(f64::from(x.abs()));
            worst = worst.max((f64::from(elevation(y, x.abs())) - right).abs());
        }
        assert!(worst <= 4e-7, "{worst}");
    }

    #[test]
    fn atan2_on_the_axes() {
        for (y, x, angle) in
            [(0.0, 0.0, 0.0), (0.0, -1.0, PI), (1.0, 0.0, FRAC_PI_2), (-1.0, 0.0, -FRAC_PI_2)]
        {
            assert_eq!(atan2(y, x), angle, "({y}, {x})");
        }
        for (y, x) in [(0.0, f32::NAN), (f32::NAN, 0.0), (f32::NAN, 1.0), (-1.0, f32::NAN)] {
            assert!(atan2(y, x).is_nan(), "({y}, {x})");
        }
    }

    #[test]
    fn wrap_pi_subtracts_whole_turns() {
        for k in -15_i8..=15 {
            for a in [-3.1, -1.0, 0.0, 0.5, 3.1_f32] {
                let exact = f64::from(a + f32::from(k) * TAU) - f64::from(k) * core::f64::consts::TAU;
                assert!(
                    (f64::from(wrap_pi(a + f32::from(k) * TAU)) - exact).abs() < 1e-6,
                    "{k} turns and {a}"
                );
            }
        }
    }

    #[test]
    fn sqrt_is_exact_for_squares() {
        for i in (0..2048_u16).step_by(if cfg!(miri) { 101 } else { 1 }) {
            assert_eq!(sqrt(f32::from(i) * f32::from(i)), f32::from(i));
        }
        assert!(sqrt(-1.0).is_nan());
    }
}
