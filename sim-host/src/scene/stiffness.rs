//! Checks that the step of the simulation is short enough for the vehicle.
//!
//! The vehicle is integrated by RK4. For a decay with rate λ and a step h, RK4 diverges where λh is above 2.78: the state
//! of a vehicle with little mass for its drag, or with stiff legs for its inertia, would grow without limit. For λh up to
//! 1 the error of RK4 is at most 2 % a step (1 − 1 + 1/2 − 1/6 + 1/24 = 0.375 in place of e⁻¹ = 0.368). The limit here is
//! λh = 1, which leaves room for tolerances, which may halve a mass. The lag of the rotors has no limit: it is computed in
//! closed form.

use super::DEFAULT_RATE_HZ;
use super::effects::VehicleEffects;
use crate::dynamics::{Ground, VehicleParams};
use input::InputError;

/// Airspeed up to which quadratic drag is checked, m/s: the strongest wind that a scene may have.
const MAX_AIRSPEED_M_S: f64 = 100.0;

/// Checks that the legs are not too stiff for the inertia: see [`Ground::min_inertia_kg_m2`].
///
/// # Errors
/// A moment of inertia is too small.
pub fn check_legs(params: &VehicleParams) -> Result<(), InputError> {
    let min = Ground::min_inertia_kg_m2(params);
    let inertias = <[f64; 3]>::from(params.inertia_kg_m2);
    inertias.into_iter().find(|inertia| *inertia < min).map_or(Ok(()), |inertia| {
        let VehicleParams { mass_kg, feet_m, .. } = params;
        let arm_m = params.arm_m();
        Err(InputError::new(format!(
            "must be at least {min:.3e} kg m² for {mass_kg} kg with arms of {arm_m:.3} m and feet {feet_m} m below: with less \
             the legs are too stiff for steps of 1 ms"
        ))
        .field("inertia.kg_m2")
        .value(inertia))
    })
}

/// Checks that the drag does not stop the vehicle within a step.
///
/// # Errors
/// The sum of the drags is too large for the mass.
pub fn check_drag(effects: &VehicleEffects, vehicle: &VehicleParams) -> Result<(), InputError> {
    let max_of = |axes: [f64; 3]| axes.into_iter().fold(0.0, f64::max);
    // Field, its value, and the drag in kg/s per unit of the value.
    let drags = [
        effects.linear_drag.as_ref().map(|drag| ("linear_drag.a_kg_per_s", max_of(drag.a_kg_per_s), 1.0)),
        effects.quadratic_drag.as_ref().map(|drag| {
            // The derivative of ½ ρ C_dA v² is ρ C_dA v.
            ("quadratic_drag.cd_area_m2", max_of(drag.cd_area_m2), drag.air_density_kg_m3 * MAX_AIRSPEED_M_S)
        }),
        effects
            .rotor_drag
            .as_ref()
            .map(|drag| ("rotor_drag.k_kg_per_rad", drag.k_kg_per_rad, 4.0 * vehicle.max_rad_s)),
    ];
    let drags = || drags.iter().flatten();
    let max_kg_per_s = vehicle.mass_kg * f64::from(DEFAULT_RATE_HZ);
    let sum_kg_per_s: f64 = drags().map(|(_, value, per_unit)| value * per_unit).sum();
    if sum_kg_per_s <= max_kg_per_s {
        return Ok(());
    }
    let largest = drags().max_by(|(_, a, per_a), (_, b, per_b)| (a * per_a).total_cmp(&(b * per_b)));
    largest.map_or(Ok(()), |(field, value, per_unit)| {
        let others = sum_kg_per_s - value * per_unit;
        let max = ((max_kg_per_s - others) / per_unit).max(0.0);
        Err(InputError::new(format!(
            "must be at most {max:.3}: more drag stops {} kg within one step of 1 ms",
            vehicle.mass_kg
        ))
        .field(format!("effects.vehicle.{field}"))
        .value(value))
    })
}
