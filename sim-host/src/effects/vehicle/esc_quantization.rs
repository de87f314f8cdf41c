//! ESC quantization: the pulse takes the nearest of a row of values, `step_us` apart.
//!
//! The pulse is 1,000 µs at rest to 2,000 µs at the vehicle's full speed, in a straight line as in the flight
//! code's map. An ESC that counts the pulse with a 1 MHz timer has steps of 1 µs; DShot has 2,000 steps,
//! which is 0.5 µs; 8-bit ones have 4 to 8. A step of s µs is s/1000 of full speed: with OS4 0.319 rad/s
//! for 1 µs, at hover 0.28 % of a rotor's thrust.
//!
//! Source: rounding to the nearest step, halves to even.

use serde::Deserialize;

use super::{CommandEffect, VehicleEffect};
use crate::effects::{Build, Recipe, Snapshot};
use input::InputError;
use input::check;

/// `[effects.vehicle.esc_quantization]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EscQuantization {
    /// µs of the 1,000 between rest and full speed.
    pub step_us: f64,
}

impl Recipe for EscQuantization {
    type Effect = VehicleEffect;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        check::key_in_range(key, "step_us", self.step_us, 1e-3, 500.0, "µs")
    }

    fn build(&self, with: &Build) -> VehicleEffect {
        VehicleEffect::Command(Box::new(Stairs(self.step_us * 1e-3 * with.vehicle.max_rad_s)))
    }
}

/// Height of a stair, rad/s.
struct Stairs(f64);

impl CommandEffect for Stairs {
    fn apply(&mut self, wanted: &mut [f64; 4], _: &Snapshot) {
        for wanted in wanted {
            *wanted = libm::rint(*wanted / self.0) * self.0;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::vehicle::testing::{STATE, command, moment};
    use ::vehicle::VehicleParams;

    #[test]
    fn pulse_takes_the_nearest_step() {
        let mut stairs = command(&EscQuantization { step_us: 8.0 });
        let us = VehicleParams::OS4.max_rad_s / 1000.0;
        let mut wanted = [0.0, 707.9 * us, 708.1 * us, 3.9 * us];
        stairs.apply(&mut wanted, &moment(&STATE, 0.0, [0.0; 4]));
        // 707.9 lies between 704 and 712, whose middle is 708.
        for (wanted, pulse_us) in wanted.into_iter().zip([0.0, 704.0, 712.0, 0.0]) {
            assert!((wanted - pulse_us * us).abs() < 1e-9, "{wanted} {pulse_us}");
        }
    }
}
