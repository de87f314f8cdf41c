//! Rotor drag (H-force): F = −k ΣΩ_i v⊥, in the rotor plane.
//!
//! In edgewise flow the advancing blade meets faster air than the retreating one, and has more drag. Averaged over a
//! turn, this is a force opposite to the in-plane part v⊥ of the velocity through the air, proportional to it and to
//! the rotor's speed. The unit of k is kg/rad, which is N divided by m/s and by rad/s. 1.19·10⁻⁴ is RotorPy's value for
//! the 8-inch propellers of a Hummingbird. The accelerometer measures this force, as it does linear drag. The force
//! grows with the thrust.
//!
//! All rotors are assumed to move with the centre of gravity: the ω × r of a rotor is small compared with v where
//! this force matters.
//!
//! Source: Martin and Salaün, *The true role of accelerometer feedback in quadrotor control*, ICRA 2010;
//! Mahony, Kumar and Corke, *Multirotor aerial vehicles*, IEEE RAM 19(3), 2012.

use flight_core::geometry::vec3;
use serde::Deserialize;

use super::{Body, BodyEffect, Load, Stage, VehicleEffect};
use crate::effects::{BuildContext, EffectParams};
use input::InputError;
use input::check;

/// `[effects.vehicle.rotor_drag]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RotorDrag {
    /// Drag coefficient k, kg/rad.
    pub k_kg_per_rad: f64,
}

impl EffectParams for RotorDrag {
    type Effect = VehicleEffect;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        check::key_in_range(key, "k_kg_per_rad", self.k_kg_per_rad, 0.0, 1.0, "kg/rad")
    }

    fn build(&self, _: &BuildContext) -> VehicleEffect {
        VehicleEffect::Body(Body::RotorDrag(HForce(self.k_kg_per_rad)))
    }
}

/// k, kg/rad.
#[derive(Debug)]
pub struct HForce(f64);

impl BodyEffect for HForce {
    #[inline(always)]
    fn apply(&self, load: &mut Load, _: &[f64; 4], at: &Stage) {
        let axis = vec3(at.matrix[0].z, at.matrix[1].z, at.matrix[2].z);
        let in_plane = at.airspeed - axis * axis.dot(at.airspeed);
        let [w1, w2, w3, w4] = at.rotors;
        load.force = load.force - in_plane * (self.0 * (w1 + w2 + w3 + w4));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::vehicle::testing::{STATE, applied};
    use crate::state::State;
    use flight_core::geometry::Quaternion;

    #[test]
    fn rotor_drag_acts_in_the_rotor_plane() {
        let drag = RotorDrag { k_kg_per_rad: 1e-4 };
        // The vehicle is rolled by 1 rad (57°) and moves along the body's y and z. There is drag along y only.
        let (sin, cos) = (libm::sin(0.5), libm::cos(0.5));
        let attitude = Quaternion::new(cos, sin, 0.0, 0.0);
        let velocity = attitude.rotate(vec3(0.0, 3.0, 7.0));
        let state = State { attitude, velocity, ..STATE };
        let (load, _) = applied(&drag, &state, [100.0, 200.0, 300.0, 400.0], [0.0; 4], [0.0; 4]);
        let in_body = attitude.conjugate().rotate(load.force);
        assert!((in_body - vec3(0.0, -0.3, 0.0)).norm() < 1e-12, "{in_body:?}");
        assert_eq!(load.torque.norm(), 0.0);
    }
}
