//! ESC quantization: the pulse is rounded to the nearest multiple of `step_us`.
//!
//! The pulse grows linearly from 1,000 µs at rest to 2,000 µs at the vehicle's full speed, as in the flight code.
//! An ESC that measures the pulse with a 1 MHz timer has steps of 1 µs. DShot has 2,000 steps, which is 0.5 µs. 8-bit
//! ESCs have steps of 4 to 8 µs. A step of s µs is s/1000 of full speed: for OS4 1 µs is 0.319 rad/s, at hover
//! 0.28 % of a rotor's thrust.
//!
//! Source: rounding to the nearest step, and from halfway between two steps to the even one.

use serde::Deserialize;

use super::{CommandEffect, VehicleEffect};
use crate::effects::{BuildContext, EffectParams, Snapshot};
use input::InputError;
use input::check;

/// `[effects.vehicle.esc_quantization]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EscQuantization {
    /// Step of the pulse, µs; rest and full speed are 1,000 µs apart.
    pub step_us: f64,
}

impl EffectParams for EscQuantization {
    type Effect = VehicleEffect;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        check::key_in_range(key, "step_us", self.step_us, 1e-3, 500.0, "µs")
    }

    fn build(&self, context: &BuildContext) -> VehicleEffect {
        VehicleEffect::Command(Box::new(Rounding(self.step_us * 1e-3 * context.vehicle.max_rad_s)))
    }
}

/// Step of the speed, rad/s.
struct Rounding(f64);

impl CommandEffect for Rounding {
    fn apply(&mut self, wanted: &mut [f64; 4], _: &Snapshot) {
        for wanted in wanted {
            *wanted = libm::rint(*wanted / self.0) * self.0;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::vehicle::testing::{STATE, command, snapshot};
    use ::vehicle::VehicleParams;

    #[test]
    fn pulse_is_rounded_to_the_nearest_step() {
        let mut rounding = command(&EscQuantization { step_us: 8.0 });
        let us = VehicleParams::OS4.max_rad_s / 1000.0;
        let mut wanted = [0.0, 707.9 * us, 708.1 * us, 3.9 * us];
        rounding.apply(&mut wanted, &snapshot(&STATE, 0.0, [0.0; 4]));
        // 707.9 is between 704 and 712, whose midpoint is 708.
        for (wanted, pulse_us) in wanted.into_iter().zip([0.0, 704.0, 712.0, 0.0]) {
            assert!((wanted - pulse_us * us).abs() < 1e-9, "{wanted} {pulse_us}");
        }
    }
}
