//! Quadratic drag of the body: F = −½ ρ C_dA |v| v, per body axis.
//!
//! v is the velocity through the air in body axes, and C_dA (m²) the drag area along each axis. So a plate has more
//! drag when its face is to the wind. F_i = −½ ρ (C_dA)_i |v| v_i, N. The terminal speed of a level vehicle in free
//! fall is √(2 m g/(ρ C_dA_z)).
//!
//! Source: Hoerner, *Fluid-Dynamic Drag*, 1965, on bluff bodies. ρ = 1.225 kg/m³ is that of the
//! standard atmosphere at sea level (ISO 2533).

use flight_core::geometry::Vec3;
use serde::Deserialize;

use super::{Body, BodyEffect, Load, Stage, VehicleEffect};
use crate::effects::{BuildContext, EffectParams};
use input::InputError;
use input::check;

/// `[effects.vehicle.quadratic_drag]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct QuadraticDrag {
    /// Drag areas C_dA, m², along the body's x, y, z.
    pub cd_area_m2: [f64; 3],
    /// Air density ρ, kg/m³; default 1.225.
    #[serde(default = "sea_level")]
    pub air_density_kg_m3: f64,
}

fn sea_level() -> f64 {
    1.225
}

impl EffectParams for QuadraticDrag {
    type Effect = VehicleEffect;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        check::keys_in_range(key, "cd_area_m2", self.cd_area_m2, 0.0, 100.0, "m²")?;
        check::key_in_range(key, "air_density_kg_m3", self.air_density_kg_m3, 0.0, 10.0, "kg/m³")
    }

    fn build(&self, _: &BuildContext) -> VehicleEffect {
        let half_density = 0.5 * self.air_density_kg_m3;
        VehicleEffect::Body(Body::QuadraticDrag(Drag(Vec3::from(self.cd_area_m2) * half_density)))
    }
}

/// ½ ρ C_dA, kg/m.
#[derive(Debug)]
pub struct Drag(Vec3<f64>);

impl BodyEffect for Drag {
    #[inline(always)]
    fn apply(&self, load: &mut Load, _: &[f64; 4], at: &Stage) {
        let airspeed = at.matrix.transpose() * at.airspeed;
        let drag = airspeed.scale_by(self.0) * airspeed.norm();
        load.force = load.force - *at.matrix * drag;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::vehicle::testing::{STATE, applied};
    use crate::state::State;
    use flight_core::geometry::{Quaternion, vec3};

    #[test]
    fn quadratic_drag_acts_in_body_axes() {
        let drag = QuadraticDrag { cd_area_m2: [0.01, 0.02, 0.04], air_density_kg_m3: 1.225 };
        let force = |attitude, velocity| {
            applied(&drag, &State { attitude, velocity, ..STATE }, [0.0; 4], [0.0; 4], [0.0; 4]).0.force
        };
        let level = Quaternion::IDENTITY;
        // ½ · 1.225 · 0.01 · 10² = 0.6125 N.
        assert!((force(level, vec3(10.0, 0.0, 0.0)) - vec3(-0.6125, 0.0, 0.0)).norm() < 1e-12);
        assert!((force(level, vec3(-20.0, 0.0, 0.0)) - vec3(2.45, 0.0, 0.0)).norm() < 1e-12);
        // With 3, 4 and 12 m/s on the axes the speed is 13.
        let expected = vec3(3.0 * 0.01, 4.0 * 0.02, 12.0 * 0.04) * (-0.5 * 1.225 * 13.0);
        assert!((force(level, vec3(3.0, 4.0, 12.0)) - expected).norm() < 1e-12);
        // With the nose down, the body's z axis is along the motion.
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let nose_down = Quaternion::new(half, 0.0, -half, 0.0);
        assert!((force(nose_down, vec3(10.0, 0.0, 0.0)) - vec3(-2.45, 0.0, 0.0)).norm() < 1e-12);
    }
}
