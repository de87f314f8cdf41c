//! Tests of the algebraic laws in f64, where they hold to rounding, and of operations with a closed form.

use super::*;
use core::f64::consts::PI;
use proptest::num::f32::ANY;
use proptest::prelude::*;

/// Bound for the rounding of a few products of numbers up to 10³.
const CLOSE: f64 = 1e-9;

fn vector() -> impl Strategy<Value = Vec3<f64>> {
    [-10.0..10.0, -10.0..10.0, -10.0..10.0_f64].prop_map(Vec3::from)
}

fn matrix() -> impl Strategy<Value = Mat3<f64>> {
    [vector(), vector(), vector()].prop_map(|rows| Mat3 { rows })
}

/// Any rotation: an axis, and an angle from −π to π.
fn rotation() -> impl Strategy<Value = (Vec3<f64>, f64)> {
    (vector(), -PI..PI)
        .prop_filter("an axis", |(axis, _)| axis.norm() > 0.1)
        .prop_map(|(axis, angle)| (axis * (1.0 / axis.norm()), angle))
}

fn quaternion((axis, angle): (Vec3<f64>, f64)) -> Quaternion<f64> {
    Quaternion { w: (0.5 * angle).cos(), v: axis * (0.5 * angle).sin() }
}

fn near(a: Vec3<f64>, b: Vec3<f64>) -> bool {
    (a - b).norm() < CLOSE
}

fn near_matrix(a: Mat3<f64>, b: Mat3<f64>) -> bool {
    (0..3).all(|row| near(a[row], b[row]))
}

/// Rodrigues' formula.
fn turned((axis, angle): (Vec3<f64>, f64), v: Vec3<f64>) -> Vec3<f64> {
    let (sin, cos) = angle.sin_cos();
    v * cos + axis.cross(v) * sin + axis * (axis.dot(v) * (1.0 - cos))
}

/// The rotations about one axis, from the definition.
fn about_x(angle: f64) -> Mat3<f64> {
    let (s, c) = angle.sin_cos();
    Mat3::from_rows([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
}

fn about_y(angle: f64) -> Mat3<f64> {
    let (s, c) = angle.sin_cos();
    Mat3::from_rows([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
}

fn about_z(angle: f64) -> Mat3<f64> {
    let (s, c) = angle.sin_cos();
    Mat3::from_rows([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
}

fn double(v: Vec3<f32>) -> Vec3<f64> {
    <[f32; 3]>::from(v).map(f64::from).into()
}

#[test]
fn products_of_unit_vectors_and_quaternions() {
    let y = vec3(0.0, 1.0, 0.0);
    assert_eq!([Vec3::X.cross(y), y.cross(Vec3::Z), Vec3::Z.cross(Vec3::X)], [Vec3::Z, Vec3::X, y]);
    assert_eq!(vec3(2.0_f32, 3.0, 6.0).norm(), 7.0);
    assert_eq!(Mat3::from_rows([[0.0, 1.0, 2.0], [3.0, 4.0, 5.0], [6.0, 7.0, 8.0]])[1], vec3(3.0, 4.0, 5.0));
    // The Hamilton convention is i j = k, j k = i, k i = j.
    let [i, j, k] = [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0_f64)]
        .map(|(x, y, z)| Quaternion::new(0.0, x, y, z));
    assert_eq!([i * j, j * k, k * i], [k, i, j]);
    assert_eq!((i * i).to_array(), [-1.0, 0.0, 0.0, 0.0]);
    assert_eq!(Quaternion::new(1.0, 2.0, 3.0, 4.0).conjugate().to_array(), [1.0, -2.0, -3.0, -4.0]);
    assert_eq!(Quaternion::new(1.0, 2.0, 3.0, 4.0).norm_squared(), 30.0);
}

proptest! {
    #[test]
    fn vector_operations_obey_their_laws(a in vector(), b in vector(), c in vector(), k in -10.0..10.0_f64) {
        let [ax, ay, az] = <[f64; 3]>::from(a);
        let [bx, by, bz] = <[f64; 3]>::from(b);
        prop_assert_eq!(<[f64; 3]>::from(a + b), [ax + bx, ay + by, az + bz]);
        prop_assert_eq!(<[f64; 3]>::from(a - b), [ax - bx, ay - by, az - bz]);
        prop_assert_eq!(<[f64; 3]>::from(a.scale_by(b)), [ax * bx, ay * by, az * bz]);
        prop_assert_eq!(<[f64; 3]>::from(a * k), [ax * k, ay * k, az * k]);
        prop_assert_eq!(a + -a, Vec3::ZERO);
        let mut sum = a;
        sum += b;
        prop_assert_eq!(sum, a + b);

        // Lagrange: |a × b|² + (a · b)² = |a|² |b|². The triple product is invariant under cyclic permutation.
        let cross = a.cross(b);
        prop_assert!((cross.dot(cross) + a.dot(b).powi(2) - (a.norm() * b.norm()).powi(2)).abs() < CLOSE);
        prop_assert!(cross.dot(a).abs() < CLOSE && cross.dot(b).abs() < CLOSE);
        prop_assert!((a.dot(b.cross(c)) - c.dot(a.cross(b))).abs() < CLOSE);
        prop_assert!(near(a.cross(b + c), a.cross(b) + a.cross(c)));
    }

    #[test]
    fn matrix_operations_obey_their_laws(a in matrix(), b in matrix(), v in vector(), k in -10.0..10.0_f64) {
        prop_assert!((a.determinant() * b.determinant() - (a * b).determinant()).abs() < 1e-4);
        prop_assert!((a.transpose().determinant() - a.determinant()).abs() < CLOSE);
        prop_assert!((a * b * v - a * (b * v)).norm() < 1e-8);
        prop_assert!(near((a * k) * v, (a * v) * k));
        prop_assert_eq!(Mat3::IDENTITY * a, a);
        prop_assert_eq!(a.transpose().transpose(), a);
        // (A v) · w = v · (Aᵀ w). With the unit vectors for v and w, this checks each element of the transpose.
        for (row, unit) in Mat3::<f64>::IDENTITY.rows.into_iter().enumerate() {
            prop_assert_eq!(a.transpose()[row], a * unit);
        }
    }

    /// Three ways to rotate a vector give the result of Rodrigues' formula.
    #[test]
    fn quaternion_rotates_about_its_axis_by_its_angle(r in rotation(), v in vector()) {
        let q = quaternion(r);
        prop_assert!(near(q.rotate(v), turned(r, v)));
        prop_assert!(near(q.to_matrix() * v, turned(r, v)));
        let sandwich = q * Quaternion { w: 0.0, v } * q.conjugate();
        prop_assert!(near(sandwich.v, turned(r, v)) && sandwich.w.abs() < CLOSE);
        prop_assert!(near_matrix(q.conjugate().to_matrix(), q.to_matrix().transpose()));
        prop_assert!(near(q.down(), q.conjugate().rotate(Vec3::Z)));
    }

    #[test]
    fn product_of_rotations_applies_the_right_one_first(p in rotation(), q in rotation(), v in vector()) {
        prop_assert!(near((quaternion(p) * quaternion(q)).rotate(v), turned(p, turned(q, v))));
    }

    #[test]
    fn euler_angles_convert_to_a_quaternion_and_back(roll in -PI..PI, pitch in -0.5 * PI..0.5 * PI, yaw in -PI..PI) {
        let half = |angle: f64| (0.5 * angle).sin_cos();
        let q = Quaternion::from_half_angles(half(roll), half(pitch), half(yaw));
        let expected = about_z(yaw) * about_y(pitch) * about_x(roll);
        prop_assert!(near_matrix(q.to_matrix(), expected));

        let [w, x, y, z] = q.to_array().map(|part| part as f32);
        let found = Quaternion::new(w, x, y, z).to_euler();
        let [roll, pitch, yaw] = [found.roll, found.pitch, found.yaw].map(f64::from);
        let back = about_z(yaw) * about_y(pitch) * about_x(roll);
        // Roll and yaw are angles of points at the distance cos θ from the origin, so their rounding error grows by
        // 1/cos θ.
        for row in 0..3 {
            prop_assert!((back[row] - expected[row]).norm() < 2e-6 / pitch.cos().abs(), "{:?}", found);
        }
    }

    /// Against the standard library in f64, over the whole range of a gyroscope and beyond.
    #[test]
    fn rotation_vector_is_axis_times_angle(
        (axis, _) in rotation(), angle in prop_oneof![0.0..0.6_f64, 0.45..0.5, 0.0..7.0, 0.0..1000.0, Just(0.0)],
    ) {
        let [x, y, z] = <[f64; 3]>::from(axis * angle).map(|part| part as f32);
        let q = Quaternion::from_rotation_vector(vec3(x, y, z));
        // The rounded argument.
        let r = double(vec3(x, y, z));
        let h = 0.5 * r.norm();
        let expected = if h > 0.0 { r * (0.5 * h.sin() / h) } else { Vec3::ZERO };
        // The half angle adds its own rounding error.
        let bound = 2e-7 + 1.2e-7 * h;
        prop_assert!((double(q.v) - expected).norm() < bound && (f64::from(q.w) - h.cos()).abs() < bound, "{:?}", q);
    }

    /// Any four numbers whose squares are in range give a unit quaternion in their direction.
    #[test]
    fn normalized_is_a_unit_quaternion_in_direction(parts in prop::array::uniform4(prop_oneof![-1e18..1e18_f32, -1.0..1.0_f32, -1e-15..1e-15_f32])) {
        let [w, x, y, z] = parts;
        let q = Quaternion::new(w, x, y, z);
        prop_assume!(q.norm_squared() > 1e-36);
        let unit = q.normalized();
        prop_assert!((unit.norm_squared() - 1.0).abs() < 1e-6, "{:?}", unit);
        let norm = parts.iter().map(|part| f64::from(*part).powi(2)).sum::<f64>().sqrt();
        for (ours, part) in unit.to_array().into_iter().zip(parts) {
            prop_assert!((f64::from(ours) - f64::from(part) / norm).abs() < 1e-6);
        }
    }

    /// Quaternions that are no attitude give NaN or angles in range.
    #[test]
    fn euler_angles_of_any_quaternion_are_nan_or_in_range(parts in prop::array::uniform4(ANY)) {
        let [w, x, y, z] = parts;
        let angles = Quaternion::new(w, x, y, z).to_euler();
        let within = |angle: f32, max: f32| angle.is_nan() || angle.abs() <= max;
        prop_assert!(within(angles.roll, core::f32::consts::PI), "{:?}", angles);
        prop_assert!(within(angles.yaw, core::f32::consts::PI), "{:?}", angles);
        prop_assert!(within(angles.pitch, core::f32::consts::FRAC_PI_2), "{:?}", angles);
    }
}

#[test]
fn normalized_zero_is_nan() {
    let zero = Quaternion::<f32>::IDENTITY.scaled(0.0);
    assert!(zero.normalized().to_array().iter().all(|part| part.is_nan()));
    assert_eq!(Quaternion::from_rotation_vector(Vec3::ZERO), Quaternion::IDENTITY);
}
