//! Turning one motor on the bench: which may, how fast, and for how long.

use crate::arithmetic::sqrt;
use crate::arming::BenchMotor;
use crate::config::{ConfigError, check};
use crate::sample::BenchCommand;

/// Age of the last command at which the motor stops, µs.
pub const BENCH_SILENT_US: u32 = 250_000;

/// Limits of the bench.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct BenchParams {
    /// Largest thrust, as a share of the rotor's largest.
    pub max_thrust: f32,
    /// Longest time that commands may go on without a pause, s.
    pub max_s: f32,
}

impl BenchParams {
    /// A tenth of the thrust, a fifth of the vehicle's weight with thrust to weight 2; and ten seconds.
    pub const STANDARD: Self = Self { max_thrust: 0.1, max_s: 10.0 };

    pub(crate) fn validate(&self) -> Result<(), ConfigError> {
        check("bench.max_thrust", self.max_thrust, 0.0, 0.5)?;
        check("bench.max_s", self.max_s, 0.1, 60.0)
    }
}

/// The command in force, and how long commands have gone on.
#[derive(Clone, Copy, Debug)]
pub struct Bench {
    params: BenchParams,
    max_us: u32,
    command: Option<BenchCommand>,
    age_us: u32,
    running_us: u32,
}

impl Bench {
    /// Nobody commands.
    ///
    /// # Errors
    /// A limit out of range.
    pub fn new(params: &BenchParams) -> Result<Self, ConfigError> {
        params.validate()?;
        let max_us = (params.max_s * 1.0e6) as u32;
        Ok(Self { params: *params, max_us, command: None, age_us: 0, running_us: 0 })
    }

    /// Takes what was commanded in a step that comes `dt_us` after the last. A rotor that does not exist, or a
    /// thrust that is no share, is no command and no heartbeat.
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

    /// Whether a command is in force.
    #[inline(always)]
    pub fn commanded(&self) -> bool {
        self.command.is_some()
    }

    /// Whether commands have gone on for too long. A pause longer than [`BENCH_SILENT_US`] ends that.
    #[inline(always)]
    pub fn expired(&self) -> bool {
        self.running_us > self.max_us
    }

    /// The rotor that is to turn and its speed as a share of the largest, not above the limit (thrust goes with
    /// the speed's square).
    pub fn speed(&self) -> Option<(usize, f32)> {
        let command = self.command?;
        let thrust = crate::arithmetic::min(command.thrust, self.params.max_thrust);
        Some((usize::from(command.rotor - 1), sqrt(thrust)))
    }

    /// The permit's share of it: the rotor, and the pulse that it may not exceed.
    pub fn motor(&self, pulse_us: impl Fn(f32) -> f32) -> Option<BenchMotor> {
        let (rotor, _) = self.speed()?;
        Some(BenchMotor { rotor, limit_us: pulse_us(sqrt(self.params.max_thrust)) })
    }
}
