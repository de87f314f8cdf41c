//! Misalignment: the sensor's axes are neither square to each other nor along the body's.
//!
//! ```text
//!                          ⎡ 1     0     0 ⎤              ⎡  1    θ_z  −θ_y ⎤
//!  y ← N (I − [θ]×) y   N = ⎢ n_yx  1     0 ⎥   I − [θ]× = ⎢ −θ_z   1    θ_x ⎥
//!                          ⎣ n_zx  n_zy  1 ⎦              ⎣  θ_y  −θ_x   1  ⎦
//! ```
//!
//! θ turns the chip on the board by small angles (θ_x, θ_y, θ_z): a vector seen from axes turned by θ is
//! y − θ × y, good to θ²/2 (10 mrad: 5e-5). N has ones on its diagonal and, with x kept as the reference, the
//! three angles by which y leans on x and z on x and y (Skog and Händel,
//! *Calibration of a MEMS inertial measurement unit*, 2006). A datasheet's cross-axis sensitivity of 1 % is
//! 10 mrad.

use flight_core::geometry::{Mat3, Vec3};
use serde::Deserialize;

use crate::effects::{BoxedSensorEffect, Build, Recipe, SensorEffect, Snapshot};
use input::InputError;
use input::check;

/// `[effects.gyro.misalignment]` and `[effects.accel.misalignment]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Misalignment {
    /// θ, mrad: the chip turned about the body's x, y and z.
    #[serde(default)]
    pub mounting_mrad: [f64; 3],
    /// mrad: what y reads of x, z of x, and z of y.
    #[serde(default)]
    pub non_orthogonality_mrad: [f64; 3],
}

impl Misalignment {
    fn matrix(&self) -> Mat3<f64> {
        let [x, y, z] = self.mounting_mrad.map(|mrad| mrad * 1e-3);
        let [y_of_x, z_of_x, z_of_y] = self.non_orthogonality_mrad.map(|mrad| mrad * 1e-3);
        let leaning = Mat3::from_rows([[1.0, 0.0, 0.0], [y_of_x, 1.0, 0.0], [z_of_x, z_of_y, 1.0]]);
        let turned = Mat3::from_rows([[1.0, z, -y], [-z, 1.0, x], [y, -x, 1.0]]);
        leaning * turned
    }
}

impl Recipe for Misalignment {
    type Effect = BoxedSensorEffect;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        // Beyond 0.2 rad small angles are off by 2 %: that is a mounting to be calibrated, not an error.
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

    fn build(&self, _: &Build) -> BoxedSensorEffect {
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
    fn a_turned_chip_sees_the_world_turned_back() {
        let theta = vec3(0.004, -0.003, 0.005);
        let mut effect = build(
            &Misalignment { mounting_mrad: <[f64; 3]>::from(theta * 1e3), non_orthogonality_mrad: [0.0; 3] },
            100.0,
        );
        let truth = vec3(1.0, -2.0, 9.0);
        // The exact rotation, with half angles by their sine.
        let (angle, axis) = (theta.norm(), theta * (1.0 / theta.norm()));
        let chip = Quaternion { w: (angle / 2.0).cos(), v: axis * (angle / 2.0).sin() };
        let want = chip.conjugate().rotate(truth);
        let got = at_rest(|at| effect.apply(truth, at));
        // θ²/2 of the vector.
        assert!((got - want).norm() < 0.51 * angle * angle * truth.norm(), "{got:?} {want:?}");
        assert!((got - truth).norm() > 10.0 * (got - want).norm());
    }

    #[test]
    fn leaning_axes_read_their_neighbours() {
        let mut effect =
            build(&Misalignment { mounting_mrad: [0.0; 3], non_orthogonality_mrad: [1.0, 2.0, 3.0] }, 100.0);
        at_rest(|at| {
            assert_eq!(effect.apply(Vec3::X, at), vec3(1.0, 0.001, 0.002));
            assert_eq!(effect.apply(vec3(0.0, 1.0, 0.0), at), vec3(0.0, 1.0, 0.003));
            assert_eq!(effect.apply(Vec3::Z, at), Vec3::Z);
        });
    }
}
