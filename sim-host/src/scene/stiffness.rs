//! What a step of the simulation can follow.
//!
//! The vehicle is integrated by RK4, which turns a decay by λ into a growth where λh is above 2.78: a vehicle that is
//! light for its drag, or hard to its legs, would not be slow but infinite. What λh = 1 and less is, RK4 follows to 2 %
//! a step and better (1 − 1 + 1/2 − 1/6 + 1/24 = 0.375 for e⁻¹ = 0.368); tolerances may halve a mass on top. The rotors'
//! lag has no bound: it is a closed form.

use super::DEFAULT_RATE_HZ;
use super::effects::VehicleEffects;
use crate::dynamics::{Ground, VehicleParams};
use input::InputError;

/// The speed through the air up to which quadratic drag must be followed, m/s: the strongest wind that a scene may name.
const FASTEST_M_S: f64 = 100.0;

/// Refuses a vehicle whose legs would throw it about: see [`Ground::least_inertia_kg_m2`].
pub fn check_legs(params: &VehicleParams) -> Result<(), InputError> {
    let least = Ground::least_inertia_kg_m2(params);
    let inertias = <[f64; 3]>::from(params.inertia_kg_m2);
    inertias.into_iter().find(|inertia| *inertia < least).map_or(Ok(()), |inertia| {
        let VehicleParams { mass_kg, feet_m, .. } = params;
        let arm_m = params.arm_m();
        Err(InputError::new(format!(
            "must be at least {least:.3e} kg m² for {mass_kg} kg with arms of {arm_m:.3} m and feet {feet_m} m below: they \
             are too stiff for steps of 1 ms"
        ))
        .field("vehicle.inertia.kg_m2")
        .value(inertia))
    })
}

/// Refuses drag that stops the vehicle within a step.
pub fn check_drag(effects: &VehicleEffects, vehicle: &VehicleParams) -> Result<(), InputError> {
    let largest = |of: [f64; 3]| of.into_iter().fold(0.0, f64::max);
    // Field, its value, and the drag in kg/s for each unit of it.
    let drags = [
        effects.linear_drag.as_ref().map(|drag| ("linear_drag.a_kg_per_s", largest(drag.a_kg_per_s), 1.0)),
        effects.quadratic_drag.as_ref().map(|drag| {
            // The slope of ½ ρ C_dA v².
            ("quadratic_drag.cd_area_m2", largest(drag.cd_area_m2), drag.air_density_kg_m3 * FASTEST_M_S)
        }),
        effects
            .rotor_drag
            .as_ref()
            .map(|drag| ("rotor_drag.k_kg_per_rad", drag.k_kg_per_rad, 4.0 * vehicle.max_rad_s)),
    ];
    let drags = || drags.iter().flatten();
    let most_kg_per_s = vehicle.mass_kg * f64::from(DEFAULT_RATE_HZ);
    let all_kg_per_s: f64 = drags().map(|(_, value, per_unit)| value * per_unit).sum();
    if all_kg_per_s <= most_kg_per_s {
        return Ok(());
    }
    let worst = drags().max_by(|(_, a, per_a), (_, b, per_b)| (a * per_a).total_cmp(&(b * per_b)));
    worst.map_or(Ok(()), |(field, value, per_unit)| {
        let others = all_kg_per_s - value * per_unit;
        let most = ((most_kg_per_s - others) / per_unit).max(0.0);
        Err(InputError::new(format!(
            "must be at most {most:.3}: more stops {} kg within less than a step, in steps of 1 ms",
            vehicle.mass_kg
        ))
        .field(format!("effects.vehicle.{field}"))
        .value(value))
    })
}
