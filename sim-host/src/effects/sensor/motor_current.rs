//! Magnetic field of the motor current: it turns with the vehicle and changes with the throttle.
//!
//! m ← m + k I. By the Biot-Savart law the field is proportional to the current. The wiring determines k of each
//! axis. Flight stacks compensate it with the same formula (ArduPilot's compass-motor setup: an offset per ampere;
//! PX4's current compensation: gauss per kiloampere). A rotor at Ω needs the torque d Ω², so the power d Ω³. With
//! motors and ESCs of efficiency η, the current from a battery of voltage U is
//!
//! I = Σ d Ω³ / (η U)
//!
//! OS4 hovers at 225.7 rad/s: 4 · 7.5e-7 · 225.7³ = 34.5 W, which is 5.2 A at η = 0.6 and 11.1 V. A straight wire
//! with 5.2 A makes 10 µT at a distance of 10 cm (µ₀ I / 2π r), a fifth of the Earth's field.

use flight_core::geometry::Vec3;
use serde::Deserialize;

use crate::effects::{BoxedSensorEffect, BuildContext, EffectParams, SensorEffect, Snapshot};
use input::InputError;
use input::check;

/// `[effects.mag.motor_current]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MotorCurrent {
    /// Field per current k, µT/A, body axes.
    pub field_ut_per_a: [f64; 3],
    /// Voltage U of the battery, V.
    pub supply_v: f64,
    /// Efficiency η of motors and ESCs, 0 to 1.
    pub efficiency: f64,
}

impl EffectParams for MotorCurrent {
    type Effect = BoxedSensorEffect;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        check::keys_in_range(key, "field_ut_per_a", self.field_ut_per_a, -1e3, 1e3, "µT/A")?;
        check::key_in_range(key, "supply_v", self.supply_v, 1.0, 1e3, "V")?;
        check::key_in_range(key, "efficiency", self.efficiency, 0.01, 1.0, "")
    }

    fn build(&self, context: &BuildContext) -> BoxedSensorEffect {
        let per_cube = context.vehicle.torque_coefficient / (self.efficiency * self.supply_v);
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
    use crate::effects::sensor::testing::{STATE, build, snapshot};
    use ::vehicle::{GRAVITY, VehicleParams};
    use flight_core::geometry::vec3;

    #[test]
    fn hovering_os4_adds_the_field_of_its_current() {
        let params = MotorCurrent { field_ut_per_a: [2.0, -1.0, 0.5], supply_v: 11.1, efficiency: 0.6 };
        let mut effect = build(&params, 100.0);
        let standing = snapshot(&STATE, 0.0);
        assert_eq!(effect.apply(vec3(25.0, 3.0, 41.0), &standing), vec3(25.0, 3.0, 41.0));

        // An independent calculation of the current: power is torque times speed, and the torque is d/b of the weight.
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
