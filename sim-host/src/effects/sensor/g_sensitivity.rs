//! g-sensitivity: a gyroscope reads specific force as rate.
//!
//! ω ← ω + G f/g, with f the true specific force at the centre of gravity and G in deg/s per g; rows are the
//! gyroscope's axes, columns the force's (IEEE Std 1431-2004: linear acceleration sensitivity). MEMS parts
//! state up to 0.1 deg/s/g.

use flight_core::geometry::{Mat3, Vec3};
use serde::Deserialize;

use super::DEG;
use crate::effects::{BoxedSensorEffect, BuildContext, EffectParams, SensorEffect, Snapshot};
use ::vehicle::GRAVITY;
use input::InputError;
use input::check;

/// `[effects.gyro.g_sensitivity]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GSensitivity {
    /// Matrix G, row by row, deg/s/g: the rows are the gyroscope's x, y, z, the columns the axes of the force.
    pub matrix_deg_s_per_g: [[f64; 3]; 3],
}

impl EffectParams for GSensitivity {
    type Effect = BoxedSensorEffect;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        let entries = self.matrix_deg_s_per_g.into_iter().flatten();
        check::keys_in_range(key, "matrix_deg_s_per_g", entries, -100.0, 100.0, "deg/s/g")
    }

    fn build(&self, _: &BuildContext) -> BoxedSensorEffect {
        Box::new(Coupling(Mat3::from_rows(self.matrix_deg_s_per_g) * (DEG / GRAVITY)))
    }
}

/// Coupling matrix, rad/s per m/s².
struct Coupling(Mat3<f64>);

impl SensorEffect for Coupling {
    #[inline]
    fn apply_to(&mut self, reading: &mut Vec3<f64>, at: &Snapshot) {
        *reading += self.0 * at.specific_force;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::sensor::testing::{STATE, at_rest, build, snapshot};
    use flight_core::geometry::vec3;

    #[test]
    fn gyro_at_rest_reads_g_sensitivity_to_minus_1_g() {
        let g = [[0.0, 0.0, 0.1], [0.0, 0.2, 0.0], [0.3, 0.0, -0.4]];
        let mut effect = build(&GSensitivity { matrix_deg_s_per_g: g }, 100.0);
        let level = at_rest(|at| effect.apply(Vec3::ZERO, at)) * (1.0 / DEG);
        assert!((level - vec3(-0.1, 0.0, 0.4)).norm() < 1e-12, "{level:?}");
        let pushed = Snapshot { specific_force: vec3(GRAVITY, 2.0 * GRAVITY, 0.0), ..snapshot(&STATE, 0.0) };
        let pushed = effect.apply(vec3(1.0, 0.0, 0.0), &pushed);
        assert!((pushed - vec3(1.0, 0.4 * DEG, 0.3 * DEG)).norm() < 1e-12, "{pushed:?}");
    }
}
