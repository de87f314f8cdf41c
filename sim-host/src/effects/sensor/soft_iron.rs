//! Soft iron: unmagnetised ferromagnetic parts of the vehicle distort the external field.
//!
//! m ← S m, where S is a 3×3 matrix in body axes, near the identity. A sphere of readings becomes an ellipsoid. The
//! same matrix can represent errors of the magnetometer's gains (diagonal) and skewed axes.

use flight_core::geometry::{Mat3, Vec3};
use serde::Deserialize;

use crate::effects::{BoxedSensorEffect, BuildContext, EffectParams, SensorEffect, Snapshot};
use input::InputError;
use input::check;

/// `[effects.mag.soft_iron]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SoftIron {
    /// Matrix S, row by row: µT in the reading per µT of true field.
    pub matrix: [[f64; 3]; 3],
}

impl EffectParams for SoftIron {
    type Effect = BoxedSensorEffect;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        check::keys_in_range(key, "matrix", self.matrix.into_iter().flatten(), -10.0, 10.0, "µT/µT")?;
        // Soft iron cannot make a reflection or a singular matrix, and a calibration could not correct them.
        let determinant = Mat3::from_rows(self.matrix).determinant();
        check::key_in_range(key, "matrix", determinant, 1e-3, 1e3, "(determinant)")
    }

    fn build(&self, _: &BuildContext) -> BoxedSensorEffect {
        Box::new(Matrix(Mat3::from_rows(self.matrix)))
    }
}

struct Matrix(Mat3<f64>);

impl SensorEffect for Matrix {
    fn apply_to(&mut self, reading: &mut Vec3<f64>, _: &Snapshot) {
        *reading = self.0 * *reading;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::sensor::testing::{at_rest, build};
    use flight_core::geometry::vec3;

    #[test]
    fn soft_iron_columns_are_readings_of_unit_fields() {
        let matrix = [[1.1, 0.02, -0.03], [0.04, 0.9, 0.05], [-0.06, 0.07, 1.2]];
        let mut effect = build(&SoftIron { matrix }, 100.0);
        at_rest(|at| {
            assert_eq!(effect.apply(Vec3::X, at), vec3(1.1, 0.04, -0.06));
            let read = effect.apply(vec3(25.0, 3.0, 41.0), at);
            // Computed by hand: x is 27.5 + 0.06 − 1.23, y is 1 + 2.7 + 2.05, z is −1.5 + 0.21 + 49.2.
            assert!((read - vec3(26.33, 5.75, 47.91)).norm() < 1e-12, "{read:?}");
        });
    }

    #[test]
    fn singular_or_reflecting_soft_iron_is_an_error() {
        for last in [0.0, -1.0] {
            let matrix = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, last]];
            let error = SoftIron { matrix }.validate("effects.mag.soft_iron").unwrap_err().to_string();
            assert!(error.contains("determinant"), "{error}");
        }
    }
}
