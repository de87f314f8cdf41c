//! Vectors, 3×3 matrices and quaternions, generic over f32 (flight code) and f64 (simulated truth).
//!
//! This module replaces a linear algebra crate, because every operation must be evaluated in one fixed order, without
//! SIMD, fused multiply-add or the mathematics library of a host: the digests of a flight on the board and on the
//! host must be equal bit for bit.

use core::ops::{Add, AddAssign, Div, Index, Mul, Neg, Sub};

/// The scalar types of the geometry: f32 and f64.
pub trait Scalar:
    Copy
    + PartialEq
    + PartialOrd
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + AddAssign
{
    /// 0.
    const ZERO: Self;
    /// 1.
    const ONE: Self;
    /// 2.
    const TWO: Self;
    /// Returns the correctly rounded square root.
    fn sqrt(self) -> Self;
}

impl Scalar for f32 {
    const ZERO: f32 = 0.0;
    const ONE: f32 = 1.0;
    const TWO: f32 = 2.0;
    #[inline(always)]
    fn sqrt(self) -> f32 {
        crate::arithmetic::sqrt(self)
    }
}

impl Scalar for f64 {
    const ZERO: f64 = 0.0;
    const ONE: f64 = 1.0;
    const TWO: f64 = 2.0;
    #[inline(always)]
    fn sqrt(self) -> f64 {
        libm::sqrt(self)
    }
}

/// A vector in body or world axes. The place of use states the axes and the unit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Vec3<T> {
    /// Component forward (body) or north (world).
    pub x: T,
    /// Component to the right (body) or east (world).
    pub y: T,
    /// Component down.
    pub z: T,
}

/// Creates a [`Vec3`].
#[inline(always)]
pub const fn vec3<T>(x: T, y: T, z: T) -> Vec3<T> {
    Vec3 { x, y, z }
}

impl<T: Scalar> Vec3<T> {
    /// The zero vector.
    pub const ZERO: Self = vec3(T::ZERO, T::ZERO, T::ZERO);
    /// The unit vector (1, 0, 0).
    pub const X: Self = vec3(T::ONE, T::ZERO, T::ZERO);
    /// The unit vector (0, 0, 1): down.
    pub const Z: Self = vec3(T::ZERO, T::ZERO, T::ONE);

    /// Returns the scalar product with `o`.
    #[inline(always)]
    pub fn dot(self, o: Self) -> T {
        self.x * o.x + self.y * o.y + self.z * o.z
    }

    /// Returns the vector product with `o`.
    #[inline(always)]
    pub fn cross(self, o: Self) -> Self {
        vec3(self.y * o.z - self.z * o.y, self.z * o.x - self.x * o.z, self.x * o.y - self.y * o.x)
    }

    /// Returns the length.
    #[inline(always)]
    pub fn norm(self) -> T {
        self.dot(self).sqrt()
    }

    /// Returns the product of each component with that of `o`, for gains per axis.
    #[inline(always)]
    pub fn scale_by(self, o: Self) -> Self {
        vec3(self.x * o.x, self.y * o.y, self.z * o.z)
    }
}

impl<T> From<[T; 3]> for Vec3<T> {
    #[inline(always)]
    fn from([x, y, z]: [T; 3]) -> Self {
        vec3(x, y, z)
    }
}

impl<T> From<Vec3<T>> for [T; 3] {
    #[inline(always)]
    fn from(v: Vec3<T>) -> Self {
        [v.x, v.y, v.z]
    }
}

impl<T: Scalar> Add for Vec3<T> {
    type Output = Self;
    #[inline(always)]
    fn add(self, o: Self) -> Self {
        vec3(self.x + o.x, self.y + o.y, self.z + o.z)
    }
}

impl<T: Scalar> AddAssign for Vec3<T> {
    #[inline(always)]
    fn add_assign(&mut self, o: Self) {
        *self = *self + o;
    }
}

impl<T: Scalar> Sub for Vec3<T> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, o: Self) -> Self {
        vec3(self.x - o.x, self.y - o.y, self.z - o.z)
    }
}

impl<T: Scalar> Neg for Vec3<T> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        vec3(-self.x, -self.y, -self.z)
    }
}

impl<T: Scalar> Mul<T> for Vec3<T> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, k: T) -> Self {
        vec3(self.x * k, self.y * k, self.z * k)
    }
}

/// A 3×3 matrix, stored as rows.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Mat3<T> {
    /// The three rows.
    pub rows: [Vec3<T>; 3],
}

impl<T: Scalar> Mat3<T> {
    /// The unit matrix.
    pub const IDENTITY: Self = Self { rows: [Vec3::X, vec3(T::ZERO, T::ONE, T::ZERO), Vec3::Z] };

    /// Creates a matrix from rows.
    pub fn from_rows(rows: [[T; 3]; 3]) -> Self {
        Self { rows: rows.map(Vec3::from) }
    }

    /// Returns the transpose, which is the inverse of a rotation.
    #[inline]
    pub fn transpose(self) -> Self {
        let [a, b, c] = self.rows;
        Self { rows: [vec3(a.x, b.x, c.x), vec3(a.y, b.y, c.y), vec3(a.z, b.z, c.z)] }
    }

    /// Returns the determinant.
    pub fn determinant(self) -> T {
        let [a, b, c] = self.rows;
        a.dot(b.cross(c))
    }
}

impl<T: Scalar> Mul<Vec3<T>> for Mat3<T> {
    type Output = Vec3<T>;
    #[inline(always)]
    fn mul(self, v: Vec3<T>) -> Vec3<T> {
        vec3(self.rows[0].dot(v), self.rows[1].dot(v), self.rows[2].dot(v))
    }
}

impl<T: Scalar> Mul<T> for Mat3<T> {
    type Output = Self;
    fn mul(self, k: T) -> Self {
        Self { rows: self.rows.map(|r| r * k) }
    }
}

impl<T: Scalar> Mul for Mat3<T> {
    type Output = Self;
    fn mul(self, o: Self) -> Self {
        let columns = o.transpose();
        Self { rows: self.rows.map(|r| columns * r) }
    }
}

impl<T> Index<usize> for Mat3<T> {
    type Output = Vec3<T>;
    fn index(&self, i: usize) -> &Vec3<T> {
        &self.rows[i]
    }
}

/// Attitude as a Hamilton quaternion, scalar first, that rotates body vectors into world axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quaternion<T> {
    /// Scalar part.
    pub w: T,
    /// Vector part.
    pub v: Vec3<T>,
}

impl<T: Scalar> Quaternion<T> {
    /// No rotation: the body axes are parallel to the world axes.
    pub const IDENTITY: Self = Self { w: T::ONE, v: Vec3::ZERO };

    /// Creates a quaternion from its components.
    #[inline(always)]
    pub const fn new(w: T, x: T, y: T, z: T) -> Self {
        Self { w, v: vec3(x, y, z) }
    }

    /// Returns the components (w, x, y, z).
    #[inline(always)]
    pub fn to_array(self) -> [T; 4] {
        [self.w, self.v.x, self.v.y, self.v.z]
    }

    /// Returns the conjugate: the inverse rotation of a unit quaternion.
    #[inline(always)]
    pub fn conjugate(self) -> Self {
        Self { w: self.w, v: -self.v }
    }

    /// Returns the sum of the squared components; 1 for a rotation.
    #[inline(always)]
    pub fn norm_squared(self) -> T {
        self.w * self.w + self.v.dot(self.v)
    }

    /// Returns the quaternion with every component multiplied by `k`.
    #[inline(always)]
    pub fn scaled(self, k: T) -> Self {
        Self { w: self.w * k, v: self.v * k }
    }

    /// Returns the unit quaternion in the same direction. The components are not finite or not normalized if the sum
    /// of the squares is 0 or overflows; the zero quaternion gives NaN.
    #[inline(always)]
    pub fn normalized(self) -> Self {
        self.scaled(T::ONE / self.norm_squared().sqrt())
    }

    /// Returns the attitude of yaw, pitch and roll applied in this order. The arguments are (sine, cosine) of the
    /// **half** angles.
    #[inline]
    pub fn from_half_angles(roll: (T, T), pitch: (T, T), yaw: (T, T)) -> Self {
        let ((sr, cr), (sp, cp), (sy, cy)) = (roll, pitch, yaw);
        Self::new(
            cy * cp * cr + sy * sp * sr,
            cy * cp * sr - sy * sp * cr,
            cy * sp * cr + sy * cp * sr,
            sy * cp * cr - cy * sp * sr,
        )
    }

    /// Returns the rotation matrix, body to world.
    #[inline(always)]
    pub fn to_matrix(self) -> Mat3<T> {
        let Vec3 { x, y, z } = self.v;
        let (x2, y2, z2) = (x + x, y + y, z + z);
        let (wx, wy, wz) = (self.w * x2, self.w * y2, self.w * z2);
        let (xx, xy, xz) = (x * x2, x * y2, x * z2);
        let (yy, yz, zz) = (y * y2, y * z2, z * z2);
        Mat3 {
            rows: [
                vec3(T::ONE - (yy + zz), xy - wz, xz + wy),
                vec3(xy + wz, T::ONE - (xx + zz), yz - wx),
                vec3(xz - wy, yz + wx, T::ONE - (xx + yy)),
            ],
        }
    }

    /// Returns the direction of down in body axes: the third row of the rotation matrix.
    #[inline(always)]
    pub fn down(self) -> Vec3<T> {
        let Vec3 { x, y, z } = self.v;
        vec3(T::TWO * (x * z - self.w * y), T::TWO * (y * z + self.w * x), T::ONE - T::TWO * (x * x + y * y))
    }

    /// Rotates the body vector `b` into world axes.
    #[inline(always)]
    pub fn rotate(self, b: Vec3<T>) -> Vec3<T> {
        let t = self.v.cross(b) * T::TWO;
        b + t * self.w + self.v.cross(t)
    }
}

impl<T: Scalar> Mul for Quaternion<T> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, o: Self) -> Self {
        Self { w: self.w * o.w - self.v.dot(o.v), v: o.v * self.w + self.v * o.w + self.v.cross(o.v) }
    }
}

/// Euler angles of an attitude, rad. For display and logs only; the controller does not use them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Euler<T> {
    /// Roll about x of the body, rad, in [−π, π].
    pub roll: T,
    /// Pitch, positive nose up, rad, in [−π/2, π/2].
    pub pitch: T,
    /// Yaw, clockwise from north seen from above, rad, in [−π, π].
    pub yaw: T,
}

impl Quaternion<f32> {
    /// Returns the Euler angles of the attitude.
    pub fn to_euler(self) -> Euler<f32> {
        let m = self.to_matrix();
        let sin_pitch = -m[2].x;
        let cos_pitch = crate::arithmetic::sqrt(m[2].y * m[2].y + m[2].z * m[2].z);
        Euler {
            roll: crate::arithmetic::atan2(m[2].y, m[2].z),
            pitch: crate::arithmetic::atan2(sin_pitch, cos_pitch),
            yaw: crate::arithmetic::atan2(m[1].x, m[0].x),
        }
    }

    /// Returns the rotation by the vector `r` (axis times angle, rad).
    ///
    /// For half angles h below 0.25 rad, the series of sin h / h and cos h up to h⁶ are exact in f32 (h⁸/8! = 4e-10).
    /// A gyroscope at its full scale of 2,000 °/s, at 100 Hz, turns a half angle of 0.17 rad per sample.
    #[inline]
    pub fn from_rotation_vector(r: Vec3<f32>) -> Self {
        let h2 = 0.25 * r.dot(r);
        let (cos, sinc) = if h2 < 0.0625 {
            (
                1.0 - h2 * (0.5 - h2 * (1.0 / 24.0 - h2 * (1.0 / 720.0))),
                1.0 - h2 * (1.0 / 6.0 - h2 * (1.0 / 120.0 - h2 * (1.0 / 5040.0))),
            )
        } else {
            let h = crate::arithmetic::sqrt(h2);
            let (s, c) = crate::arithmetic::sin_cos(h);
            (c, s / h)
        };
        Self { w: cos, v: r * (0.5 * sinc) }
    }
}

#[cfg(test)]
mod tests;
