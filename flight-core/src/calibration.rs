//! Conversion of sensor counts into SI units in body axes.
//!
//! The calibrated reading of each sensor is `x = M (S · counts − b)`. S is the sensitivity and mounting of the chip,
//! b the bias, and M the matrix of scale and misalignment; b and M come from a calibration. Both are combined into
//! one matrix and one offset when the configuration is loaded, so that a sample costs nine products and nine sums.

use crate::geometry::{Mat3, Vec3, vec3};
use crate::range::{ConfigError, check};

/// Result of the calibration of one three-axis sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct SensorCalibration {
    /// Reading at zero input, in the SI unit of the sensor (magnetometer: µT), body axes, each axis from −10⁶ to 10⁶.
    /// Subtracted first.
    pub bias: Vec3<f32>,
    /// Scale and misalignment, dimensionless, close to the unit matrix. Applied second. Determinant 0.5 to 2, squared
    /// length of a row at most 4.
    pub matrix: Mat3<f32>,
}

impl SensorCalibration {
    /// Calibration of an ideal sensor: no bias, unit matrix.
    pub const NONE: Self = Self { bias: Vec3::ZERO, matrix: Mat3::IDENTITY };
}

/// Result of the calibration of all sensors.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Calibration {
    /// Gyroscope, rad/s.
    pub gyro: SensorCalibration,
    /// Accelerometer, m/s².
    pub accel: SensorCalibration,
    /// Magnetometer, µT.
    pub mag: SensorCalibration,
}

impl Calibration {
    /// Calibration of ideal sensors.
    pub const NONE: Self =
        Self { gyro: SensorCalibration::NONE, accel: SensorCalibration::NONE, mag: SensorCalibration::NONE };
}

/// Conversion of the counts of a chip into SI units in body axes, before any calibration.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Sensitivity {
    /// SI units (magnetometer: µT) per count: above 0, for the gyroscope to 0.3 rad/s, for the others to 1,000.
    pub per_count: f32,
    /// Rotation from the axes of the chip to the body axes: a signed permutation on most boards.
    pub mounting: Mat3<f32>,
}

/// The combined form `x = matrix · counts − offset`.
#[derive(Clone, Copy, Debug)]
pub struct SensorModel {
    matrix: Mat3<f32>,
    offset: Vec3<f32>,
}

impl SensorModel {
    /// Combines sensitivity, mounting and calibration. `fields` contains the names of the fields for errors, and the
    /// largest sensitivity.
    ///
    /// # Errors
    /// Returns the first value outside its range: a sensitivity that is not above 0 or above its maximum, a mounting
    /// that is not a rotation, a calibration matrix that is not close to the unit matrix (a row longer than 2, a
    /// determinant outside 0.5 to 2), or a bias outside ±10⁶.
    pub fn new(
        fields: SensorFields,
        sensitivity: Sensitivity,
        calibration: SensorCalibration,
    ) -> Result<Self, ConfigError> {
        check(fields.per_count, sensitivity.per_count, f32::MIN_POSITIVE, fields.max_per_count)?;
        // The rows of a rotation have length 1 and are orthogonal; typed values satisfy this to a few digits. The
        // rows of a reflection do too, but its determinant is −1.
        let [a, b, c] = sensitivity.mounting.rows;
        for row in [a, b, c] {
            check(fields.mounting_row, row.dot(row), 0.999, 1.001)?;
        }
        for product in [a.dot(b), b.dot(c), c.dot(a)] {
            check(fields.mounting_angle, product, -1.0e-3, 1.0e-3)?;
        }
        check(fields.mounting, sensitivity.mounting.determinant(), 0.995, 1.005)?;
        for row in calibration.matrix.rows {
            check(fields.matrix_row, row.dot(row), 0.0, 4.0)?;
        }
        check(fields.matrix, calibration.matrix.determinant(), 0.5, 2.0)?;
        for axis in <[f32; 3]>::from(calibration.bias) {
            check(fields.bias, axis, -1.0e6, 1.0e6)?;
        }
        Ok(Self {
            matrix: calibration.matrix * sensitivity.mounting * sensitivity.per_count,
            offset: calibration.matrix * calibration.bias,
        })
    }

    /// Returns the calibrated reading, SI (magnetometer: µT), body axes.
    #[inline(always)]
    pub fn apply(&self, counts: [i16; 3]) -> Vec3<f32> {
        let [x, y, z] = counts;
        self.matrix * vec3(f32::from(x), f32::from(y), f32::from(z)) - self.offset
    }
}

/// Names of the fields of a sensor, as errors show them, and its largest sensitivity.
#[derive(Clone, Copy, Debug)]
pub struct SensorFields {
    per_count: &'static str,
    /// Largest sensitivity. Gyroscope: 32,768 counts of 0.3 rad/s turn 1,000 rad in the 0.1 s after which the sensor
    /// counts as lost, which is the limit of the estimator; real gyroscopes have 0.001 rad/s. Other sensors: 1,000.
    max_per_count: f32,
    mounting: &'static str,
    mounting_row: &'static str,
    mounting_angle: &'static str,
    matrix: &'static str,
    matrix_row: &'static str,
    bias: &'static str,
}

impl SensorFields {
    /// Fields of the gyroscope.
    pub const GYRO: Self = Self {
        per_count: "gyro.per_count",
        max_per_count: 0.3,
        mounting: "gyro.mounting (determinant)",
        mounting_row: "gyro.mounting (squared length of a row)",
        mounting_angle: "gyro.mounting (product of two rows)",
        matrix: "calibration.gyro.matrix (determinant)",
        matrix_row: "calibration.gyro.matrix (squared length of a row)",
        bias: "calibration.gyro.bias",
    };
    /// Fields of the accelerometer.
    pub const ACCEL: Self = Self {
        per_count: "accel.per_count",
        max_per_count: 1.0e3,
        mounting: "accel.mounting (determinant)",
        mounting_row: "accel.mounting (squared length of a row)",
        mounting_angle: "accel.mounting (product of two rows)",
        matrix: "calibration.accel.matrix (determinant)",
        matrix_row: "calibration.accel.matrix (squared length of a row)",
        bias: "calibration.accel.bias",
    };
    /// Fields of the magnetometer.
    pub const MAG: Self = Self {
        per_count: "mag.per_count",
        max_per_count: 1.0e3,
        mounting: "mag.mounting (determinant)",
        mounting_row: "mag.mounting (squared length of a row)",
        mounting_angle: "mag.mounting (product of two rows)",
        matrix: "calibration.mag.matrix (determinant)",
        matrix_row: "calibration.mag.matrix (squared length of a row)",
        bias: "calibration.mag.bias",
    };
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Quaternion;
    use proptest::num::f32::ANY;
    use proptest::prelude::*;

    const ALL: [SensorFields; 3] = [SensorFields::GYRO, SensorFields::ACCEL, SensorFields::MAG];

    fn rotation() -> impl Strategy<Value = Mat3<f32>> {
        [-1.0..1.0_f32, -1.0..1.0_f32, -1.0..1.0_f32, -1.0..1.0_f32]
            .prop_map(|[w, x, y, z]| Quaternion::new(w, x, y, z))
            .prop_filter("a direction", |q| q.norm_squared() > 0.01)
            .prop_map(|q| q.normalized().to_matrix())
    }

    fn calibration() -> impl Strategy<Value = SensorCalibration> {
        let off = || prop::array::uniform9(-0.05..0.05_f32);
        (prop::array::uniform3(-100.0..100.0_f32), off()).prop_map(|(bias, off)| {
            let mut matrix = Mat3::IDENTITY;
            for (row, off) in matrix.rows.iter_mut().zip(off.chunks(3)) {
                *row += vec3(off[0], off[1], off[2]);
            }
            SensorCalibration { bias: bias.into(), matrix }
        })
    }

    proptest! {
        /// For any mounting and any calibration close to the unit matrix: equal to the three steps in succession, in
        /// f64.
        #[test]
        fn reading_equals_the_three_steps_in_f64(
            mounting in rotation(), per_count in 1.0e-5..0.3_f32, calibration in calibration(),
            counts in prop::array::uniform3(any::<i16>()),
        ) {
            let model = SensorModel::new(SensorFields::GYRO, Sensitivity { per_count, mounting }, calibration).unwrap();
            let times = |m: &Mat3<f32>, v: [f64; 3]| {
                let row = |row: Vec3<f32>| <[f32; 3]>::from(row).into_iter().zip(v).map(|(a, b)| f64::from(a) * b).sum::<f64>();
                m.rows.map(row)
            };
            let mut body = times(&mounting, counts.map(f64::from));
            for (axis, bias) in body.iter_mut().zip(<[f32; 3]>::from(calibration.bias)) {
                *axis = *axis * f64::from(per_count) - f64::from(bias);
            }
            let expected = times(&calibration.matrix, body);
            // The rounding error is proportional to the largest term of the sum.
            let scale = f64::from(per_count) * 57_000.0 + 100.0;
            for (ours, exact) in <[f32; 3]>::from(model.apply(counts)).into_iter().zip(expected) {
                prop_assert!((f64::from(ours) - exact).abs() < 1e-6 * scale, "{} {}", ours, exact);
            }
        }

        /// For any numbers from a file or a link: either an error names a range that the number is outside of, or the
        /// readings are finite and at most twice the full scale of the sensor plus the bias.
        #[test]
        fn any_model_is_rejected_or_gives_bounded_readings(
            which in 0..3_usize,
            per_count in prop_oneof![2 => 1.0e-4..0.3_f32, 1 => ANY],
            mut mounting in rotation(),
            mut calibration in calibration(),
            odd in prop::collection::vec((0..21_usize, prop_oneof![ANY, -3.0..3.0_f32]), 0..3),
            counts in prop::array::uniform3(any::<i16>()),
        ) {
            for (place, number) in odd {
                let place = match place {
                    0..9 => (&mut mounting.rows[place / 3], place % 3),
                    9..18 => (&mut calibration.matrix.rows[place / 3 - 3], place % 3),
                    _ => (&mut calibration.bias, place % 3),
                };
                *[&mut place.0.x, &mut place.0.y, &mut place.0.z][place.1] = number;
            }
            match SensorModel::new(ALL[which], Sensitivity { per_count, mounting }, calibration) {
                Err(error) => prop_assert!(!(error.value >= error.minimum && error.value <= error.maximum), "{}", error),
                Ok(model) => {
                    let read = model.apply(counts);
                    // A row of the matrix has a length of at most 2. 32,768 counts on each of three axes are a vector
                    // of at most 57,000 counts, whose length the mounting does not change. Three biases of 10⁶ are a
                    // vector of at most 1.75e6.
                    let max = 2.0 * (per_count * 57_000.0 + 1.75e6);
                    prop_assert!(read.x.abs() <= max && read.y.abs() <= max && read.z.abs() <= max, "{:?}", read);
                }
            }
        }
    }

    #[test]
    fn largest_sensitivity_is_accepted_the_next_rejected() {
        for (fields, max) in ALL.into_iter().zip([0.3_f32, 1.0e3, 1.0e3]) {
            let with = |per_count| {
                SensorModel::new(fields, Sensitivity { per_count, ..TURNED }, SensorCalibration::NONE)
            };
            assert!(with(max).is_ok());
            for odd in [max.next_up(), 0.0, -0.01, f32::NAN, f32::INFINITY] {
                assert_eq!(with(odd).unwrap_err().field, fields.per_count);
            }
        }
    }

    const TURNED: Sensitivity = Sensitivity {
        per_count: 0.01,
        // The chip's x points right and its y backward: the board is mounted with a rotation of 90° clockwise.
        mounting: Mat3 { rows: [vec3(0.0, -1.0, 0.0), vec3(1.0, 0.0, 0.0), vec3(0.0, 0.0, 1.0)] },
    };

    #[test]
    fn combined_form_equals_the_three_steps() {
        let calibration = SensorCalibration {
            bias: vec3(0.1, -0.2, 0.3),
            matrix: Mat3::from_rows([[1.01, 0.002, -0.001], [0.0, 0.99, 0.004], [0.003, 0.0, 1.02]]),
        };
        let model = SensorModel::new(SensorFields::GYRO, TURNED, calibration).unwrap();
        let combined = model.apply([1000, -500, 250]);
        let body = vec3(5.0, 10.0, 2.5);
        let stepwise = calibration.matrix * (body - calibration.bias);
        assert!((combined - stepwise).norm() < 1e-5, "{combined:?} {stepwise:?}");
    }

    #[test]
    fn reflection_and_singular_matrix_are_rejected() {
        let mirror = Sensitivity {
            mounting: Mat3 { rows: [Vec3::X, vec3(0.0, 1.0, 0.0), vec3(0.0, 0.0, -1.0)] },
            ..TURNED
        };
        let error = SensorModel::new(SensorFields::GYRO, mirror, SensorCalibration::NONE).unwrap_err();
        assert_eq!(error.field, "gyro.mounting (determinant)");
        let flat = SensorCalibration { matrix: Mat3::IDENTITY * 0.0, ..SensorCalibration::NONE };
        assert!(SensorModel::new(SensorFields::MAG, TURNED, flat).is_err());
    }
}
