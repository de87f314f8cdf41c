//! Gyroscopic torque of the spinning rotors: the J_r terms of eqs 8-9.
//!
//! The rotors' angular momentum is h = −J_r Ω_r along the body's z, Ω_r by eq 14. When the body turns at
//! ω = (p, q, r), h turns with it, and the rotors apply the torque −ω × h = (q, −p, 0) J_r Ω_r to the body.

use flight_core::geometry::vec3;
use serde::Deserialize;

use super::{Body, BodyEffect, Load, Stage, VehicleEffect};
use crate::effects::{BuildContext, EffectParams};
use ::vehicle::VehicleParams;
use input::InputError;

/// `[effects.vehicle.rotor_gyroscopic]`: J_r is in the vehicle's file.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RotorGyroscopic {}

impl EffectParams for RotorGyroscopic {
    type Effect = VehicleEffect;

    fn validate(&self, _: &str) -> Result<(), InputError> {
        Ok(())
    }

    fn build(&self, context: &BuildContext) -> VehicleEffect {
        VehicleEffect::Body(Body::RotorGyroscopic(Gyroscope(signed_rotor_inertia(context.vehicle))))
    }
}

/// Returns J_r, kg·m², with the sign of the front left rotor's reaction torque.
pub(super) fn signed_rotor_inertia(vehicle: &VehicleParams) -> f64 {
    f64::from(vehicle.spin.sign()) * vehicle.rotor_inertia_kg_m2
}

/// ±J_r, kg·m².
#[derive(Debug)]
pub struct Gyroscope(f64);

impl BodyEffect for Gyroscope {
    #[inline(always)]
    fn apply(&self, load: &mut Load, _: &[f64; 4], at: &Stage) {
        let [w1, w2, w3, w4] = at.rotors;
        let h = self.0 * (w1 - w2 + w3 - w4);
        load.torque += vec3(at.state.rates.y * h, -at.state.rates.x * h, 0.0);
    }
}
