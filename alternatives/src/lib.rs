//! What Kestrel could fly and does not, written to be compared.
//!
//! Each algorithm stands here once, generic over f32 and f64 where that is the question, so that the error that
//! a study of `sim-host` finds and the instructions that the emulated Cortex-M4F counts belong to the same code.
//! A crate of its own, because what does not fly has no place in `flight-core`, and because the board cannot
//! build `sim-host`. The image that flies does not depend on it.
#![no_std]
#![forbid(unsafe_code)]
#![warn(missing_docs)]
// Tests measure against std, an independent implementation.
#![cfg_attr(test, allow(clippy::disallowed_methods))]

#[cfg(test)]
extern crate std;

pub mod integration;
pub mod prefilter;

use flight_core::arithmetic;
use flight_core::geometry::{Quaternion, Scalar, Vec3};

/// A float type with what an attitude takes: f32 by `flight-core`'s kernels, f64 by `libm`.
pub trait Real: Scalar {
    /// The nearest number of this type.
    fn of(x: f64) -> Self;
    /// Sine and cosine.
    fn sin_cos(self) -> (Self, Self);
    /// The rotation by the vector `r` (axis times angle, rad).
    fn rotation(r: Vec3<Self>) -> Quaternion<Self>;
}

impl Real for f32 {
    #[inline(always)]
    fn of(x: f64) -> f32 {
        x as f32
    }
    #[inline(always)]
    fn sin_cos(self) -> (f32, f32) {
        arithmetic::sin_cos(self)
    }
    #[inline(always)]
    fn rotation(r: Vec3<f32>) -> Quaternion<f32> {
        Quaternion::from_rotation_vector(r)
    }
}

impl Real for f64 {
    #[inline(always)]
    fn of(x: f64) -> f64 {
        x
    }
    #[inline(always)]
    fn sin_cos(self) -> (f64, f64) {
        libm::sincos(self)
    }
    /// Below a quarter radian of half-angle h the series of sin h / h and cos h to h¹² are exact to f64
    /// (h¹⁴/14! = 4e-20).
    fn rotation(r: Vec3<f64>) -> Quaternion<f64> {
        let h2 = 0.25 * r.dot(r);
        let (cos, sinc) = if h2 < 0.0625 {
            (
                series(h2, [2.0, 12.0, 30.0, 56.0, 90.0, 132.0]),
                series(h2, [6.0, 20.0, 42.0, 72.0, 110.0, 156.0]),
            )
        } else {
            let h = libm::sqrt(h2);
            let (s, c) = libm::sincos(h);
            (c, s / h)
        };
        Quaternion { w: cos, v: r * (0.5 * sinc) }
    }
}

/// 1 − x/d₁ (1 − x/d₂ (1 − …)).
#[inline(always)]
fn series(x: f64, divisors: [f64; 6]) -> f64 {
    divisors.iter().rev().fold(1.0, |sum, divisor| 1.0 - x * (1.0 / divisor) * sum)
}
