//! Motor failure: from `at_s` on, a rotor reaches at most a share of its full speed.
//!
//! From then on Ω_wanted ≤ `limit` Ω_max. A limit of 0 stops the rotor. A limit of 0.5 is like a motor that lost a
//! phase, or whose current is limited because of a chipped propeller. The rotor follows with the motor's lag, as for
//! any command.
//!
//! Source: a limit on the command; the cause of the failure is not modelled.

use serde::Deserialize;

use super::{CommandEffect, VehicleEffect};
use crate::effects::{BuildContext, EffectParams, Snapshot};
use input::InputError;
use input::check;

/// `[effects.vehicle.motor_failure]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MotorFailure {
    /// Number of the rotor: 1 front left, 2 front right, 3 rear right, 4 rear left.
    #[serde(deserialize_with = "check::whole_number::<_, _, 1, 4>")]
    pub rotor: u32,
    /// Time of the failure, s from the start of the scene.
    pub at_s: f64,
    /// Remaining share of full speed, 0 to 1; default 0, which stops the rotor.
    #[serde(default)]
    pub limit: f64,
}

impl EffectParams for MotorFailure {
    type Effect = VehicleEffect;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        check::key_in_range(key, "at_s", self.at_s, 0.0, 1e6, "s")?;
        check::key_in_range(key, "limit", self.limit, 0.0, 1.0, "of full speed")
    }

    fn at_s(&self) -> Option<f64> {
        Some(self.at_s)
    }

    fn build(&self, context: &BuildContext) -> VehicleEffect {
        VehicleEffect::Command(Box::new(Failure {
            rotor: self.rotor as usize - 1,
            // The failure begins in the middle of the previous step, so that rounding of the time does not matter.
            after_s: self.at_s - 0.5 * context.interval_s(),
            limit_rad_s: self.limit * context.vehicle.max_rad_s,
        }))
    }
}

struct Failure {
    rotor: usize,
    after_s: f64,
    limit_rad_s: f64,
}

impl CommandEffect for Failure {
    fn apply(&mut self, wanted: &mut [f64; 4], at: &Snapshot) {
        if at.time_s > self.after_s {
            let wanted = &mut wanted[self.rotor];
            *wanted = wanted.min(self.limit_rad_s);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::vehicle::testing::{STATE, command, snapshot};

    #[test]
    fn failure_limits_its_rotor_from_its_time_on() {
        for (limit, left) in [(0.0, 0.0), (0.5, 159.5), (1.0, 225.0)] {
            let mut failure = command(&MotorFailure { rotor: 3, at_s: 2.0, limit });
            let mut at = |time_s| {
                let mut wanted = [225.0; 4];
                failure.apply(&mut wanted, &snapshot(&STATE, time_s, [225.0; 4]));
                wanted
            };
            assert_eq!(at(1.999), [225.0; 4]);
            assert_eq!(at(2.0), [225.0, 225.0, left, 225.0]);
        }
    }

    #[test]
    fn rotor_number_5_is_an_error() {
        for rotor in [0_i64, 5, 300, -1] {
            let failure = format!("[effects.vehicle.motor_failure]\nrotor = {rotor}\nat_s = 2.0\n");
            let text = format!("include = \"hover\"\n{failure}");
            let error = crate::scene::Scene::parse("s", &text).unwrap_err().to_string();
            let wanted = "must be a whole number from 1 to 4";
            assert_eq!(error, format!("s:3: effects.vehicle.motor_failure.rotor = {rotor}: {wanted}"));
        }
    }
}
