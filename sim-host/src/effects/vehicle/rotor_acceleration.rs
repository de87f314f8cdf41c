//! Yaw reaction of rotors that change their speed: torque +J_r Ω̇_r about the body's z.
//!
//! The rotors' angular momentum is h_z = −J_r Ω_r with Ω_r by eq 14. The body loses the momentum that they gain:
//! −ḣ = +J_r (Ω̇₁ − Ω̇₂ + Ω̇₃ − Ω̇₄), N·m, which eq 10 leaves out. At the start of a yaw command it is
//! J_r/(2 d Ω τ) times the commanded aerodynamic torque, in the same direction: 3.5 times for OS4.
//!
//! Source: Bouabdallah, EPFL thesis 3727, 2007 (the "inertial counter-torque" of its yaw moments). Ω̇ comes from
//! `motor_lag`. Without it rotor speeds jump, so a scene that names this effect alone is an error.

use serde::Deserialize;

use super::rotor_gyroscopic::signed_rotor_inertia;
use super::{Body, BodyEffect, Load, Stage, VehicleEffect};
use crate::effects::{BuildContext, EffectParams};
use input::InputError;

/// `[effects.vehicle.rotor_acceleration]`: J_r is in the vehicle's file.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RotorAcceleration {}

impl EffectParams for RotorAcceleration {
    type Effect = VehicleEffect;

    fn validate(&self, _: &str) -> Result<(), InputError> {
        Ok(())
    }

    fn build(&self, context: &BuildContext) -> VehicleEffect {
        VehicleEffect::Body(Body::RotorAcceleration(Reaction(signed_rotor_inertia(context.vehicle))))
    }
}

/// ±J_r, kg·m².
#[derive(Debug)]
pub struct Reaction(f64);

impl BodyEffect for Reaction {
    #[inline(always)]
    fn apply(&self, load: &mut Load, _: &[f64; 4], at: &Stage) {
        let [a1, a2, a3, a4] = at.rotor_accelerations;
        load.torque.z += self.0 * (a1 - a2 + a3 - a4);
    }

    fn follows_command_at_once(&self) -> bool {
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::vehicle::testing::{STATE, applied};

    #[test]
    fn body_loses_angular_momentum_of_the_rotors() {
        // The torque is Ω̇_r = 300 − 50 + 200 + 10 = 460 rad/s², times 6e-5 kg·m².
        let (load, _) =
            applied(&RotorAcceleration {}, &STATE, [200.0; 4], [300.0, 50.0, 200.0, -10.0], [1.0; 4]);
        assert_eq!((load.torque.x, load.torque.y), (0.0, 0.0));
        assert!((load.torque.z - 460.0 * 6e-5).abs() < 1e-15);
    }
}
