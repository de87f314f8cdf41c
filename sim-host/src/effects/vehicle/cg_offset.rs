//! Offset of the centre of gravity from the rotors' centre: the thrust F makes the torque −c × F.
//!
//! The body turns about its centre of gravity. If that is at c (m, body axes) from the centre of the rotors, the
//! thrust F = (0, 0, −T) acts at −c and makes the torque −c × F = (c_y T, −c_x T, 0), N·m. For example, a battery
//! that is mounted too far forward pulls the nose down, and each front rotor needs T c_x/(4 l sin 45°) more thrust.
//!
//! Moments of inertia and the feet do not change. An accelerometer away from the centre of gravity is an effect of
//! the sensor (`lever_arm`).
//!
//! Source: statics; the moment of a force about a point.

use flight_core::geometry::vec3;
use serde::Deserialize;

use super::{Body, BodyEffect, Load, Stage, VehicleEffect};
use crate::effects::{BuildContext, EffectParams};
use input::InputError;
use input::check;

/// `[effects.vehicle.cg_offset]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CgOffset {
    /// Offset c from the rotors' centre, m: forward, right, down. Thrust is along z, so z has no effect.
    pub offset_m: [f64; 3],
}

impl EffectParams for CgOffset {
    type Effect = VehicleEffect;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        check::keys_in_range(key, "offset_m", self.offset_m, -1.0, 1.0, "m")
    }

    fn build(&self, _: &BuildContext) -> VehicleEffect {
        let [forward, right, _] = self.offset_m;
        VehicleEffect::Body(Body::CgOffset(Offset { forward, right }))
    }
}

/// Offset of the centre of gravity, m.
#[derive(Debug)]
pub struct Offset {
    forward: f64,
    right: f64,
}

impl BodyEffect for Offset {
    #[inline(always)]
    fn apply(&self, load: &mut Load, thrusts: &[f64; 4], _: &Stage) {
        let thrust: f64 = thrusts.iter().sum();
        load.torque += vec3(self.right * thrust, -self.forward * thrust, 0.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::vehicle::testing::{STATE, applied};
    use ::vehicle::VehicleParams;

    #[test]
    fn torque_equals_rotor_moments_about_the_moved_centre() {
        let offset = [0.012, -0.007, 0.02];
        let thrusts = [1.5, 1.7, 1.4, 2.0];
        let (load, _) = applied(&CgOffset { offset_m: offset }, &STATE, [200.0; 4], [0.0; 4], thrusts);
        let reach = VehicleParams::OS4.forward_m;
        let moment = |from: [f64; 3]| {
            let places = [(1.0, -1.0), (1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0)];
            places.iter().zip(thrusts).fold(vec3(0.0, 0.0, 0.0), |sum, ((x, y), thrust)| {
                sum + (vec3(x * reach, y * reach, 0.0) - from.into()).cross(vec3(0.0, 0.0, -thrust))
            })
        };
        assert!((load.torque - (moment(offset) - moment([0.0; 3]))).norm() < 1e-12);
        // With the weight forward the nose goes down, which is a negative torque about y.
        assert!(load.torque.y < 0.0 && load.force.norm() == 0.0);
    }
}
