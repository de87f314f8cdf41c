//! The error of an estimated attitude.
//!
//! The error is the rotation q_est ⊗ q_ref⁻¹ from the true attitude to the estimated one, in world axes. The attitudes
//! are not aligned first, so a constant offset counts as an error. As in the BROAD benchmark (Laidig, Caruso,
//! Cereatti, Seel, *Data* 6(7):72, 2021) it is split into a rotation about the vertical, the heading error, and a
//! rotation about a horizontal axis, the inclination error. Heading comes from the magnetometer and inclination from
//! the accelerometer, so they fail independently.

use flight_core::geometry::Quaternion;

/// The error of one attitude, rad; every angle is in [0, π].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AttitudeError {
    /// Angle of the whole rotation.
    pub total_rad: f64,
    /// Angle of its part about the vertical.
    pub heading_rad: f64,
    /// Angle of its part about a horizontal axis: the angle between the two down directions.
    pub inclination_rad: f64,
}

impl AttitudeError {
    /// Returns the error of `estimate` against `truth`. Both are body to world and nearly of unit length.
    ///
    /// BROAD's formulas are 2 acos|w|, 2 atan|z/w| and 2 acos √(w² + z²). The arc tangents here give the same angles,
    /// but do not lose all digits below 1e-8 rad as the arc cosine does.
    pub fn between(estimate: Quaternion<f64>, truth: Quaternion<f64>) -> Self {
        let [w, x, y, z] = (estimate * truth.conjugate()).to_array();
        let level_squared = x * x + y * y;
        let length = libm::sqrt;
        Self {
            total_rad: 2.0 * angle(length(level_squared + z * z), w.abs()),
            heading_rad: 2.0 * angle(z.abs(), w.abs()),
            inclination_rad: 2.0 * angle(length(level_squared), length(w * w + z * z)),
        }
    }
}

/// Returns `atan2` of two non-negative numbers.
///
/// A flight calls this three times per step, nearly always for small angles. Below a tangent of 0.05 the series up to
/// t¹¹ has an error of t¹³/13 = 1e-18, and takes a fifth of the time.
#[inline(always)]
fn angle(opposite: f64, adjacent: f64) -> f64 {
    if opposite < 0.05 * adjacent {
        let t = opposite / adjacent;
        let u = t * t;
        t * (1.0 - u * (1.0 / 3.0 - u * (0.2 - u * (1.0 / 7.0 - u * (1.0 / 9.0 - u * (1.0 / 11.0))))))
    } else {
        libm::atan2(opposite, adjacent)
    }
}

/// Root mean square of attitude errors.
#[derive(Clone, Copy, Debug, Default)]
pub struct AttitudeRmse {
    /// Sums of squares, rad²: total, heading, inclination.
    sums: [f64; 3],
    count: u64,
}

impl AttitudeRmse {
    /// Adds one error.
    pub fn add(&mut self, error: AttitudeError) {
        let parts = [error.total_rad, error.heading_rad, error.inclination_rad];
        for (sum, part) in self.sums.iter_mut().zip(parts) {
            *sum += part * part;
        }
        self.count += 1;
    }

    /// Returns the number of errors added.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// Returns the three RMSE; `None` if no error was added.
    pub fn root(&self) -> Option<AttitudeError> {
        if self.count == 0 {
            return None;
        }
        let [total_rad, heading_rad, inclination_rad] =
            self.sums.map(|sum| libm::sqrt(sum / self.count as f64));
        Some(AttitudeError { total_rad, heading_rad, inclination_rad })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flight_core::geometry::vec3;

    fn about(axis: [f64; 3], angle: f64) -> Quaternion<f64> {
        let [x, y, z] = axis.map(|c| c * libm::sin(0.5 * angle));
        Quaternion { w: libm::cos(0.5 * angle), v: vec3(x, y, z) }
    }

    #[track_caller]
    fn assert_close(error: AttitudeError, [total, heading, inclination]: [f64; 3]) {
        for (ours, expected) in
            [(error.total_rad, total), (error.heading_rad, heading), (error.inclination_rad, inclination)]
        {
            assert!((ours - expected).abs() < 1e-14, "{error:?}");
        }
    }

    const TRUTH: Quaternion<f64> = Quaternion::new(0.1, 0.7, -0.5, 0.5);

    #[test]
    fn error_is_split_into_heading_and_inclination() {
        let level = about([0.6, 0.8, 0.0], 0.3);
        let vertical = about([0.0, 0.0, 1.0], -0.2);
        assert_close(AttitudeError::between(vertical * TRUTH, TRUTH), [0.2, 0.2, 0.0]);
        assert_close(AttitudeError::between(level * TRUTH, TRUTH), [0.3, 0.0, 0.3]);
        // For both rotations, one after the other, cos(total/2) = cos(heading/2) cos(inclination/2).
        let total = 2.0 * libm::acos(libm::cos(0.1) * libm::cos(0.15));
        assert_close(AttitudeError::between(vertical * level * TRUTH, TRUTH), [total, 0.2, 0.3]);
        assert_close(AttitudeError::between(level * vertical * TRUTH, TRUTH), [total, 0.2, 0.3]);
    }

    #[test]
    fn both_signs_of_a_quaternion_are_the_same_attitude() {
        let turned = about([0.0, 0.0, 1.0], 0.2) * TRUTH;
        assert_close(AttitudeError::between(turned.scaled(-1.0), TRUTH), [0.2, 0.2, 0.0]);
        assert_close(AttitudeError::between(TRUTH, TRUTH.scaled(-1.0)), [0.0; 3]);
    }

    #[test]
    fn tiny_errors_keep_their_digits() {
        let error = AttitudeError::between(about([1.0, 0.0, 0.0], 1e-12) * TRUTH, TRUTH);
        assert!((error.inclination_rad / 1e-12 - 1.0).abs() < 1e-3, "{error:?}");
    }

    #[test]
    fn series_and_atan2_agree_at_their_boundary() {
        for angle in [1e-6, 0.01, 0.0999, 0.1, 0.1001, 0.2, 3.0] {
            let error = AttitudeError::between(about([0.0, 0.0, 1.0], angle) * TRUTH, TRUTH);
            assert!((error.heading_rad - angle).abs() < 1e-15 + 4e-16 * angle, "{angle}: {error:?}");
        }
    }

    #[test]
    fn rmse_is_the_root_of_the_mean_square() {
        let mut rmse = AttitudeRmse::default();
        assert_eq!(rmse.root(), None);
        for total_rad in [3.0, 4.0] {
            rmse.add(AttitudeError { total_rad, heading_rad: 1.0, inclination_rad: 0.0 });
        }
        let root = rmse.root().unwrap();
        assert_eq!((rmse.count(), root.total_rad), (2, libm::sqrt(12.5)));
        assert_eq!((root.heading_rad, root.inclination_rad), (1.0, 0.0));
    }
}
