//! The field of the current that the motors draw: it turns with the vehicle and changes with the throttle.
//!
//! m ← m + k I. By Biot and Savart the field is proportional to the current, with a k for each axis that the
//! wiring decides; flight stacks take it out the same way (ArduPilot's magnetometer-motor setup: an offset per
//! ampere; PX4's current compensation: gauss per kiloampere). A rotor at Ω takes the torque d Ω², so the
//! power d Ω³; motors and ESCs of efficiency η draw
//!
//! I = Σ d Ω³ / (η U)
//!
//! from a supply of U. OS4 hovers at 225.7 rad/s: 4 · 7.5e-7 · 225.7³ = 34.5 W, at η = 0.6 and 11.1 V
//! 5.2 A. A straight wire of 5.2 A makes 10 µT 10 cm away (µ₀ I / 2π r), a fifth of the Earth's field.

use flight_core::geometry::Vec3;
use serde::Deserialize;

use crate::effects::{BoxedSensorEffect, Build, Recipe, SensorEffect, Snapshot};
use input::InputError;
use input::check;

/// `[effects.mag.motor_current]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MotorCurrent {
    /// k, µT/A, body axes.
    pub field_ut_per_a: [f64; 3],
    /// U, V.
    pub supply_v: f64,
    /// η of motors and ESCs, 0 to 1.
    pub efficiency: f64,
}

impl Recipe for MotorCurrent {
    type Effect = BoxedSensorEffect;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        check::keys_in_range(key, "field_ut_per_a", self.field_ut_per_a, -1e3, 1e3, "µT/A")?;
        check::key_in_range(key, "supply_v", self.supply_v, 1.0, 1e3, "V")?;
        check::key_in_range(key, "efficiency", self.efficiency, 0.01, 1.0, "of 1")
    }

    fn build(&self, with: &Build) -> BoxedSensorEffect {
        let per_cube = with.vehicle.torque_coefficient / (self.efficiency * self.supply_v);
        Box::new(Wiring { field_per_cube: Vec3::from(self.field_ut_per_a) * per_cube })
    }
}

struct Wiring {
    /// k d / (η U), µT/(rad/s)³.
    field_per_cube: Vec3<f64>,
}

impl SensorEffect for Wiring {
    fn apply_to(&mut self, reading: &mut Vec3<f64>, at: &Snapshot) {
        let cubes: f64 = at.rotors.iter().map(|speed| speed * speed * speed).sum();
        *reading += self.field_per_cube * cubes;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::sensor::testing::{STATE, build, moment};
    use ::vehicle::{GRAVITY, VehicleParams};
    use flight_core::geometry::vec3;

    #[test]
    fn a_hovering_os4_adds_the_field_of_its_current() {
        let recipe = MotorCurrent { field_ut_per_a: [2.0, -1.0, 0.5], supply_v: 11.1, efficiency: 0.6 };
        let mut effect = build(&recipe, 100.0);
        let standing = moment(&STATE, 0.0);
        assert_eq!(effect.apply(vec3(25.0, 3.0, 41.0), &standing), vec3(25.0, 3.0, 41.0));

        // Another way to the current: the power is torque times speed, the torque d/b of the weight.
        let p = VehicleParams::OS4;
        let speed = (p.mass_kg * GRAVITY / (4.0 * p.thrust_coefficient)).sqrt();
        let torque = p.mass_kg * GRAVITY * p.torque_coefficient / p.thrust_coefficient;
        let current = torque * speed / (0.6 * 11.1);
        assert!((current - 5.2).abs() < 0.05, "{current}");
        let hovering = Snapshot { rotors: [speed; 4], ..standing };
        let added = effect.apply(Vec3::ZERO, &hovering);
        assert!((added - vec3(2.0, -1.0, 0.5) * current).norm() < 1e-9, "{added:?}");
    }
}
