//! Linear drag: the A of eqs 11-13.
//!
//! F = −A (v − v_air), per world axis. In free flight an accelerometer senses tilt only through drag.

use flight_core::geometry::Vec3;
use serde::Deserialize;

use super::{Body, BodyEffect, Load, Stage, VehicleEffect};
use crate::effects::{BuildContext, EffectParams};
use input::InputError;
use input::check;

/// `[effects.vehicle.linear_drag]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LinearDrag {
    /// Drag coefficients A, kg/s, north, east, down.
    pub a_kg_per_s: [f64; 3],
}

impl EffectParams for LinearDrag {
    type Effect = VehicleEffect;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        check::keys_in_range(key, "a_kg_per_s", self.a_kg_per_s, 0.0, 1e3, "kg/s")
    }

    fn build(&self, _: &BuildContext) -> VehicleEffect {
        VehicleEffect::Body(Body::LinearDrag(Drag(self.a_kg_per_s.into())))
    }
}

/// A, kg/s.
#[derive(Debug)]
pub struct Drag(Vec3<f64>);

impl BodyEffect for Drag {
    #[inline(always)]
    fn apply(&self, load: &mut Load, _: &[f64; 4], at: &Stage) {
        load.force = load.force - self.0.scale_by(at.airspeed);
    }
}
