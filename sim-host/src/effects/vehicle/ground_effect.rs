//! Ground effect: T/T∞ = 1/(1 − (R/4z)²) for each rotor.
//!
//! R is the rotor's radius and z its height above the ground, both in m. The model is a source above its mirror
//! image, which reduces the inflow. So the same speed gives more thrust: 1.6 % more at z = 2R, 6.7 % at z = R.
//!
//! The formula has a pole at z = R/4 and was compared with measurements of rotors down to z = R/2, where it gives
//! 4/3. Below that height the factor stays at 4/3, because there are no measurements, and because an infinite factor
//! would lift any weight. The formula is for hover. In forward flight the real effect is smaller than the formula's.
//! An inverted vehicle has no ground effect.
//!
//! Source: Cheeseman and Bennett, *The Effect of the Ground on a Helicopter Rotor in Forward Flight*, ARC
//! R&M 3021, 1955.

use serde::Deserialize;

use super::{Stage, ThrustEffect, VehicleEffect};
use crate::effects::{BuildContext, EffectParams};
use ::vehicle::VehicleParams;
use input::InputError;
use input::check;

/// `[effects.vehicle.ground_effect]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GroundEffect {
    /// Radius R of a rotor, m.
    pub rotor_radius_m: f64,
}

impl EffectParams for GroundEffect {
    type Effect = VehicleEffect;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        check::key_in_range(key, "rotor_radius_m", self.rotor_radius_m, 0.005, 5.0, "m")
    }

    fn build(&self, context: &BuildContext) -> VehicleEffect {
        let VehicleParams { forward_m, right_m, .. } = *context.vehicle;
        VehicleEffect::Thrust(Box::new(Cushion { radius_m: self.rotor_radius_m, forward_m, right_m }))
    }
}

struct Cushion {
    radius_m: f64,
    /// Distance of the rotors from the centre of gravity, m.
    forward_m: f64,
    right_m: f64,
}

impl Cushion {
    fn ratio(&self, height_m: f64) -> f64 {
        // 1/(1 − (R/4z)²) with only one division, because this runs for four rotors at four stages of every step.
        let height_m = height_m.max(0.5 * self.radius_m);
        let square = height_m * height_m;
        square / (square - 0.0625 * self.radius_m * self.radius_m)
    }
}

impl ThrustEffect for Cushion {
    fn apply(&self, thrusts: &mut [f64; 4], at: &Stage) {
        let height_m = -at.state.position.z;
        let down = at.matrix[2];
        if down.z <= 0.0 {
            return;
        }
        let (forward, right) = (self.forward_m * down.x, self.right_m * down.y);
        thrusts[0] *= self.ratio(height_m - forward + right);
        thrusts[1] *= self.ratio(height_m - forward - right);
        thrusts[2] *= self.ratio(height_m + forward - right);
        thrusts[3] *= self.ratio(height_m + forward + right);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::vehicle::testing::{STATE, applied};
    use crate::state::State;
    use flight_core::geometry::{Quaternion, vec3};

    fn ratios(height_m: f64, attitude: Quaternion<f64>) -> [f64; 4] {
        let state = State { position: vec3(0.0, 0.0, -height_m), attitude, ..STATE };
        applied(&GroundEffect { rotor_radius_m: 0.15 }, &state, [200.0; 4], [0.0; 4], [1.0; 4]).1
    }

    #[test]
    fn ground_effect_is_constant_below_half_a_radius() {
        let level = Quaternion::IDENTITY;
        // The factor is 16/15 at z = R, 64/63 at 2R, and 4/3 at R/2 and below.
        for (height_m, expected) in [(0.15, 16.0 / 15.0), (0.3, 64.0 / 63.0), (0.075, 4.0 / 3.0)] {
            for ratio in ratios(height_m, level) {
                assert!((ratio - expected).abs() < 1e-12);
            }
        }
        assert_eq!(ratios(0.01, level), ratios(0.075, level));
        assert!(ratios(100.0, level)[0] - 1.0 < 1e-6);
    }

    #[test]
    fn ground_effect_depends_on_height_of_each_rotor() {
        // Rolled to the right, rotors 2 and 3 are lower by 2 · 0.23 sin 45° sin 0.2.
        let rolled = Quaternion::new(libm::cos(0.1), libm::sin(0.1), 0.0, 0.0);
        let [left, right, ..] = ratios(0.3, rolled);
        let apart = 0.23 * std::f64::consts::FRAC_1_SQRT_2 * libm::sin(0.2);
        let by_hand = |z: f64| 1.0 / (1.0 - (0.0375 / z) * (0.0375 / z));
        assert!((left - by_hand(0.3 + apart)).abs() < 1e-12 && (right - by_hand(0.3 - apart)).abs() < 1e-12);
        assert_eq!(ratios(0.3, Quaternion::new(0.0, 1.0, 0.0, 0.0)), [1.0; 4]);
    }
}
