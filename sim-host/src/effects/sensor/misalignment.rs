//! Misalignment: the sensor's axes are neither orthogonal to each other nor parallel to the body's.
//!
//! ```text
//!                          ⎡ 1     0     0 ⎤              ⎡  1    θ_z  −θ_y ⎤
//!  y ← N (I − [θ]×) y   N = ⎢ n_yx  1     0 ⎥   I − [θ]× = ⎢ −θ_z   1    θ_x ⎥
//!                          ⎣ n_zx  n_zy  1 ⎦              ⎣  θ_y  −θ_x   1  ⎦
//! ```
//!
//! θ = (θ_x, θ_y, θ_z) rotates the chip on the board by small angles. In axes rotated by θ a vector y is y − θ × y,
//! with an error of θ²/2 (10 mrad: 5e-5). N has ones on its diagonal. With x as the reference axis, its other entries
//! are the three angles by which y deviates towards x, and z towards x and y (Skog and Händel,
//! *Calibration of a MEMS inertial measurement unit*, 2006). A datasheet's cross-axis sensitivity of 1 % is
//! 10 mrad.

use flight_core::geometry::{Mat3, Vec3};
use serde::Deserialize;

use crate::effects::{BoxedSensorEffect, BuildContext, EffectParams, SensorEffect, Snapshot};
use input::InputError;
use input::check;

/// `[effects.gyro.misalignment]` and `[effects.accel.misalignment]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Misalignment {
    /// Rotation θ of the chip about the body's x, y and z, mrad.
    #[serde(default)]
    pub mounting_mrad: [f64; 3],
    /// Responses n_yx of y to x, n_zx of z to x, and n_zy of z to y, mrad.
    #[serde(default)]
    pub non_orthogonality_mrad: [f64; 3],
}

impl Misalignment {
    fn matrix(&self) -> Mat3<f64> {
        let [x, y, z] = self.mounting_mrad.map(|mrad| mrad * 1e-3);
        let [y_of_x, z_of_x, z_of_y] = self.non_orthogonality_mrad.map(|mrad| mrad * 1e-3);
        let skew = Mat3::from_rows([[1.0, 0.0, 0.0], [y_of_x, 1.0, 0.0], [z_of_x, z_of_y, 1.0]]);
        let turned = Mat3::from_rows([[1.0, z, -y], [-z, 1.0, x], [y, -x, 1.0]]);
        skew * turned
    }
}

impl EffectParams for Misalignment {
    type Effect = BoxedSensorEffect;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        // Beyond 0.2 rad the small-angle formula is wrong by 2 %. Such an angle is a mounting orientation, which a
        // calibration handles, and not an error.
        check::keys_in_range(key, "mounting_mrad", self.mounting_mrad, -200.0, 200.0, "mrad")?;
        check::keys_in_range(
            key,
            "non_orthogonality_mrad",
            self.non_orthogonality_mrad,
            -200.0,
            200.0,
            "mrad",
        )
    }

    fn build(&self, _: &BuildContext) -> BoxedSensorEffect {
        Box::new(Axes(self.matrix()))
    }
}

struct Axes(Mat3<f64>);

impl SensorEffect for Axes {
    #[inline]
    fn apply_to(&mut self, reading: &mut Vec3<f64>, _: &Snapshot) {
        *reading = self.0 * *reading;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::sensor::testing::{at_rest, build};
    use flight_core::geometry::{Quaternion, vec3};

    #[test]
    fn rotated_chip_reads_inverse_rotation() {
        let theta = vec3(0.004, -0.003, 0.005);
        let mut effect = build(
            &Misalignment { mounting_mrad: <[f64; 3]>::from(theta * 1e3), non_orthogonality_mrad: [0.0; 3] },
            100.0,
        );
        let truth = vec3(1.0, -2.0, 9.0);
        // The exact rotation.
        let (angle, axis) = (theta.norm(), theta * (1.0 / theta.norm()));
        let chip = Quaternion { w: (angle / 2.0).cos(), v: axis * (angle / 2.0).sin() };
        let want = chip.conjugate().rotate(truth);
        let got = at_rest(|at| effect.apply(truth, at));
        // The error is at most θ²/2 of the vector.
        assert!((got - want).norm() < 0.51 * angle * angle * truth.norm(), "{got:?} {want:?}");
        assert!((got - truth).norm() > 10.0 * (got - want).norm());
    }

    #[test]
    fn non_orthogonal_axes_read_their_neighbours() {
        let mut effect =
            build(&Misalignment { mounting_mrad: [0.0; 3], non_orthogonality_mrad: [1.0, 2.0, 3.0] }, 100.0);
        at_rest(|at| {
            assert_eq!(effect.apply(Vec3::X, at), vec3(1.0, 0.001, 0.002));
            assert_eq!(effect.apply(vec3(0.0, 1.0, 0.0), at), vec3(0.0, 1.0, 0.003));
            assert_eq!(effect.apply(Vec3::Z, at), Vec3::Z);
        });
    }
}
