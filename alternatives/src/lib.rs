//! Algorithms that Kestrel could fly with and does not, for comparison.
//!
//! Each algorithm is written once, generic over f32 and f64 where the number format is compared. So the error that
//! `sim-host cost` finds and the instructions counted on the Cortex-M4F of QEMU belong to the same code. It is a
//! separate crate because code that does not fly does not belong in `flight-core`, and because the board cannot build
//! `sim-host`. The flight image does not depend on it.
#![no_std]
#![forbid(unsafe_code)]
#![warn(missing_docs)]
// Tests compare with std, an independent implementation.
#![cfg_attr(test, allow(clippy::disallowed_methods))]

#[cfg(test)]
extern crate std;

pub mod integration;
pub mod prefilter;

use flight_core::arithmetic;
use flight_core::geometry::{Quaternion, Scalar, Vec3};

/// A float type with the functions for attitudes: f32 by `flight-core`'s functions, f64 by `libm`.
pub trait Real: Scalar {
    /// Returns the nearest number of this type.
    fn of(x: f64) -> Self;
    /// Returns sine and cosine.
    fn sin_cos(self) -> (Self, Self);
    /// Returns the rotation by the rotation vector `r` (axis times angle, rad).
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
    /// For a half-angle h below 0.25 rad, the series of sin h / h and cos h to h¹² are exact to f64 (the next term is
    /// h¹⁴/14! = 4e-20).
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

/// Returns 1 − x/d₁ (1 − x/d₂ (1 − …)).
#[inline(always)]
fn series(x: f64, divisors: [f64; 6]) -> f64 {
    divisors.iter().rev().fold(1.0, |sum, divisor| 1.0 - x * (1.0 / divisor) * sum)
}
