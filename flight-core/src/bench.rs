//! Bench mode: which motor may turn, how fast, and for how long.

use crate::arithmetic::sqrt;
use crate::arming::BenchMotor;
use crate::range::{ConfigError, check};
use crate::sample::BenchCommand;

/// The motor stops if the last command is older than this, µs.
pub const BENCH_SILENT_US: u32 = 250_000;

/// Limits of bench mode.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct BenchParams {
    /// Maximum thrust as a share of the maximum of a rotor, 0 to 0.5.
    pub max_thrust: f32,
    /// Maximum time for which commands may continue without a pause, s: 0.1 to 60.
    pub max_s: f32,
}

impl BenchParams {
    /// 10 s, and a tenth of the maximum thrust. With this thrust one rotor of a vehicle with a thrust-to-weight ratio
    /// of 2 lifts 5 % of the weight.
    pub const STANDARD: Self = Self { max_thrust: 0.1, max_s: 10.0 };

    pub(crate) fn validate(&self) -> Result<(), ConfigError> {
        check("bench.max_thrust", self.max_thrust, 0.0, 0.5)?;
        check("bench.max_s", self.max_s, 0.1, 60.0)
    }
}

/// State of bench mode: the command in force, and the time for which commands have continued.
#[derive(Clone, Copy, Debug)]
pub struct Bench {
    params: BenchParams,
    max_us: u32,
    command: Option<BenchCommand>,
    age_us: u32,
    running_us: u32,
}

impl Bench {
    /// Creates the state without a command.
    ///
    /// # Errors
    /// Returns the limit that is out of range.
    pub fn new(params: &BenchParams) -> Result<Self, ConfigError> {
        params.validate()?;
        let max_us = (params.max_s * 1.0e6) as u32;
        Ok(Self { params: *params, max_us, command: None, age_us: 0, running_us: 0 })
    }

    /// Updates the state with the command of a step, if there is one; the step comes `dt_us` (µs) after the last one.
    /// A command with a rotor outside 1 to 4 or a thrust outside 0 to 1 is ignored, also as a heartbeat.
    #[inline]
    pub fn update(&mut self, command: Option<&BenchCommand>, dt_us: u32) {
        if self.command.is_none() && command.is_none() {
            return;
        }
        self.age_us = self.age_us.saturating_add(dt_us);
        if self.command.is_some() {
            self.running_us = self.running_us.saturating_add(dt_us);
        }
        if let Some(command) =
            command.filter(|c| (1..=4).contains(&c.rotor) && (0.0..=1.0).contains(&c.thrust))
        {
            self.command = Some(*command);
            self.age_us = 0;
        } else if self.age_us > BENCH_SILENT_US {
            self.command = None;
            self.running_us = 0;
        }
    }

    /// Returns whether a command is in force.
    #[inline(always)]
    pub fn commanded(&self) -> bool {
        self.command.is_some()
    }

    /// Returns whether commands have continued for too long. A pause longer than [`BENCH_SILENT_US`] ends this.
    #[inline(always)]
    pub fn expired(&self) -> bool {
        self.running_us > self.max_us
    }

    /// Returns the index of the commanded rotor (0 to 3) and its speed as a share of the maximum, limited by
    /// `max_thrust`. Thrust is proportional to the square of the speed.
    pub fn speed(&self) -> Option<(usize, f32)> {
        let command = self.command?;
        let thrust = crate::arithmetic::min(command.thrust, self.params.max_thrust);
        Some((usize::from(command.rotor - 1), sqrt(thrust)))
    }

    /// Returns the motor for the permit: the commanded rotor and its longest permitted pulse, µs. `pulse_us` converts
    /// a share of the maximum speed into a pulse.
    pub fn motor(&self, pulse_us: impl Fn(f32) -> f32) -> Option<BenchMotor> {
        let (rotor, _) = self.speed()?;
        Some(BenchMotor { rotor, limit_us: pulse_us(sqrt(self.params.max_thrust)) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::num::f32::ANY;
    use proptest::prelude::*;

    #[test]
    fn limits_outside_their_range_are_rejected_by_name() {
        let with = |max_thrust, max_s| {
            Bench::new(&BenchParams { max_thrust, max_s }).map(|_| ()).map_err(|error| error.field)
        };
        for (max_thrust, max_s) in [(0.0, 0.1), (0.5, 60.0), (0.1, 10.0)] {
            assert_eq!(with(max_thrust, max_s), Ok(()));
        }
        for odd in [-0.001, 0.501, f32::NAN, f32::INFINITY] {
            assert_eq!(with(odd, 10.0), Err("bench.max_thrust"));
        }
        for odd in [0.099, 60.1, f32::NAN, f32::INFINITY] {
            assert_eq!(with(0.1, odd), Err("bench.max_s"));
        }
    }

    fn command() -> impl Strategy<Value = BenchCommand> {
        let thrust = prop_oneof![4 => 0.0..=1.0_f32, 2 => prop::sample::select(&[0.0, 1.0, -0.1, 1.01, f32::NAN][..]), 1 => ANY];
        (0..=5_u8, thrust).prop_map(|(rotor, thrust)| BenchCommand { rotor, thrust })
    }

    proptest! {
        /// Computed from the whole history with absolute times: the command in force, and the time since which there
        /// has been one.
        #[test]
        fn motor_and_expiry_follow_from_the_history(
            max_thrust in 0.0..=0.5_f32,
            past in prop::collection::vec((
                prop::option::of(command()),
                prop_oneof![3 => 0..100_000_u32, 2 => Just(50_000), 2 => Just(250_000), 1 => Just(250_001), 1 => Just(u32::MAX)],
            ), 1..60),
        ) {
            let mut bench = Bench::new(&BenchParams { max_thrust, max_s: 0.6 }).unwrap();
            let mut now_us = 0_u64;
            let mut in_force: Option<(u64, BenchCommand)> = None;
            let mut since_us = 0;
            for (command, dt_us) in past {
                now_us += u64::from(dt_us);
                bench.update(command.as_ref(), dt_us);
                let valid = command.filter(|c| (1..=4).contains(&c.rotor) && c.thrust >= 0.0 && c.thrust <= 1.0);
                if let Some(command) = valid {
                    if in_force.is_none() {
                        since_us = now_us;
                    }
                    in_force = Some((now_us, command));
                } else if in_force.is_some_and(|(at_us, _)| now_us - at_us > 250_000) {
                    in_force = None;
                }
                prop_assert_eq!(bench.commanded(), in_force.is_some());
                prop_assert_eq!(bench.expired(), in_force.is_some() && now_us - since_us > 600_000);

                let turning = bench.speed();
                prop_assert_eq!(turning.map(|(rotor, _)| rotor + 1), in_force.map(|(_, c)| usize::from(c.rotor)));
                let limit = bench.motor(|share| 1_000.0 + 1_000.0 * share);
                prop_assert_eq!(limit.is_some(), in_force.is_some());
                if let (Some((rotor, share)), Some((_, command)), Some(motor)) = (turning, in_force, limit) {
                    // Thrust is proportional to the square of the speed.
                    let thrust = f64::from(command.thrust).min(f64::from(max_thrust));
                    prop_assert!((f64::from(share).powi(2) - thrust).abs() < 1e-6);
                    let max_share = (f64::from(motor.limit_us) - 1_000.0) / 1_000.0;
                    prop_assert!(motor.rotor == rotor && (max_share.powi(2) - f64::from(max_thrust)).abs() < 1e-3);
                    prop_assert!(f64::from(share) <= max_share + 1e-3);
                }
            }
        }
    }
}
