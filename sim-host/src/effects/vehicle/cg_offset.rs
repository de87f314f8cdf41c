//! Centre of gravity beside the rotors' centre: torque −c × F of the thrust.
//!
//! The body turns about its centre of gravity. With that at c (m, body axes) from the middle of the rotors,
//! thrust F = (0, 0, −T) acts at −c, and turns the body by −c × F = (c_y T, −c_x T, 0), N·m: a battery pushed
//! forward pulls the nose down, and the front rotors have to work harder by T c_x/(4 l sin 45°) each.
//!
//! Moments of inertia and the feet stay as they are. An accelerometer that is not at the centre of gravity
//! is an effect of the sensor.
//!
//! Source: statics; the moment of a force about a point.

use flight_core::geometry::vec3;
use serde::Deserialize;

use super::{Body, BodyEffect, Load, Stage, VehicleEffect};
use crate::effects::{Build, Recipe};
use input::InputError;
use input::check;

/// `[effects.vehicle.cg_offset]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CgOffset {
    /// c, m: forward, right, down from the rotors' centre. Thrust is along z, so z moves nothing.
    pub offset_m: [f64; 3],
}

impl Recipe for CgOffset {
    type Effect = VehicleEffect;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        check::keys_in_range(key, "offset_m", self.offset_m, -1.0, 1.0, "m")
    }

    fn build(&self, _: &Build) -> VehicleEffect {
        let [forward, right, _] = self.offset_m;
        VehicleEffect::Body(Body::CgOffset(Offset { forward, right }))
    }
}

/// Where the centre of gravity is, m.
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
    fn equals_the_moments_of_the_rotors_about_the_moved_centre() {
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
        // Weight forward: nose down, a negative turn about y.
        assert!(load.torque.y < 0.0 && load.force.norm() == 0.0);
    }
}
