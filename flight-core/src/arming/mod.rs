//! Whether the motors may turn, and what happens when something fails.
//!
//! ```text
//!                  ┌──────── an obstacle ────────┐
//!                  ▼                             │
//!  Maintenance ◄► Disarmed ── the pilot asks ──► Arming ── checked for 0.5 s ──► Armed ──► Descent
//!                  ▲    ▲ ▼                                                      │  ▲        │ │
//!                  │    Bench                         the pilot disarms ◄────────┘  └ link ──┘ │
//!                  └── the pilot disarms ── Terminated ◄──── a fault, or the descent is over ──┘
//! ```
//!
//! [`table`] is the whole of it: a row for each way from state to state, by [`Conditions`] that are each a yes or
//! no. [`Arming`] adds the clock of the present state and remembers that a request has been answered.
//! `docs/safety.md` has the same table for people.
//!
//! The motors depend on a [`MotorPermit`], which cannot be copied, stored to any use, or made outside this module;
//! [`Arming`] hands one out per step in the states in which a motor may turn.

pub mod table;

use table::{Conditions, decide, rows};

/// How long the conditions of arming are checked before the motors turn, µs.
const CHECK_US: u32 = 500_000;

/// Whether the motors may turn.
///
/// The numbers are codes in a [`StepRecord`](crate::record::StepRecord): a new state gets the next number, and none
/// changes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[repr(u8)]
pub enum ArmState {
    /// They may not.
    #[default]
    Disarmed = 0,
    /// They may not yet: the pilot has asked, and everything is checked a little longer.
    Arming = 1,
    /// They turn at idle or faster, as the pilot flies.
    Armed = 2,
    /// They turn: the flight controller keeps the vehicle level and lets it sink.
    Descent = 3,
    /// They were stopped by a fault, and may not turn until the pilot has taken note by disarming.
    Terminated = 4,
    /// One of them may turn, slowly, on the bench.
    Bench = 5,
    /// They may not: flash is about to be erased.
    Maintenance = 6,
}

impl ArmState {
    /// All of them, in the order of their numbers.
    pub const ALL: [Self; 7] = [
        Self::Disarmed,
        Self::Arming,
        Self::Armed,
        Self::Descent,
        Self::Terminated,
        Self::Bench,
        Self::Maintenance,
    ];

    /// For people.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Disarmed => "Disarmed",
            Self::Arming => "Arming",
            Self::Armed => "Armed",
            Self::Descent => "Descent",
            Self::Terminated => "Terminated",
            Self::Bench => "Bench",
            Self::Maintenance => "Maintenance",
        }
    }

    /// Whether the flight controller flies the vehicle.
    pub const fn flies(self) -> bool {
        matches!(self, Self::Armed | Self::Descent)
    }
}

/// Why a state was left, or a request refused.
///
/// The numbers are codes in a [`StepRecord`](crate::record::StepRecord): a new cause gets the next number, and none
/// changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[repr(u8)]
pub enum Cause {
    /// The pilot asked for it.
    Pilot = 0,
    /// Nothing stood against arming for as long as it is checked.
    Checked = 1,
    /// The outputs are locked: USB is plugged in.
    BenchLock = 2,
    /// No link to the pilot.
    RcLost = 3,
    /// The link to the pilot is back.
    RcBack = 4,
    /// The throttle is not low.
    ThrottleUp = 5,
    /// No valid inertial samples.
    ImuLost = 6,
    /// An axis of the inertial sensor does not move.
    ImuStuck = 7,
    /// The sensors have not been calibrated.
    NoCalibration = 8,
    /// The vehicle does not lie still.
    NotStill = 9,
    /// The vehicle does not lie level.
    NotLevel = 10,
    /// The battery is too low to start with, or not measured.
    BatteryLow = 11,
    /// The battery is too low to fly on.
    BatteryCritical = 12,
    /// A task missed its deadline.
    Overload = 13,
    /// The descent has taken as long as it may.
    DescentOver = 14,
    /// The watchdog has reset the board.
    WatchdogReset = 15,
    /// The last fault has not been taken note of: disarm first.
    NotAcknowledged = 16,
    /// Somebody commands the bench.
    BenchCommand = 17,
    /// Nobody commands the bench any more.
    BenchSilent = 18,
    /// The bench has been commanded for as long as it may be.
    BenchExpired = 19,
    /// Flash is about to be erased.
    Maintenance = 20,
    /// Flash is not erased any more.
    MaintenanceOver = 21,
    /// The vehicle does not follow the sticks.
    TiltLimit = 22,
}

impl Cause {
    /// All of them, in the order of their numbers.
    pub const ALL: [Self; 23] = [
        Self::Pilot,
        Self::Checked,
        Self::BenchLock,
        Self::RcLost,
        Self::RcBack,
        Self::ThrottleUp,
        Self::ImuLost,
        Self::ImuStuck,
        Self::NoCalibration,
        Self::NotStill,
        Self::NotLevel,
        Self::BatteryLow,
        Self::BatteryCritical,
        Self::Overload,
        Self::DescentOver,
        Self::WatchdogReset,
        Self::NotAcknowledged,
        Self::BenchCommand,
        Self::BenchSilent,
        Self::BenchExpired,
        Self::Maintenance,
        Self::MaintenanceOver,
        Self::TiltLimit,
    ];

    /// For people, in a few words.
    pub const fn text(self) -> &'static str {
        match self {
            Self::Pilot => "by the pilot",
            Self::Checked => "checked",
            Self::BenchLock => "outputs locked by USB",
            Self::RcLost => "receiver lost",
            Self::RcBack => "receiver back",
            Self::ThrottleUp => "throttle not low",
            Self::ImuLost => "inertial sensor lost",
            Self::ImuStuck => "inertial sensor stuck",
            Self::NoCalibration => "not calibrated",
            Self::NotStill => "not still",
            Self::NotLevel => "not level",
            Self::BatteryLow => "battery low or not measured",
            Self::BatteryCritical => "battery critical",
            Self::Overload => "deadline missed",
            Self::DescentOver => "descent over",
            Self::WatchdogReset => "watchdog reset",
            Self::NotAcknowledged => "disarm first",
            Self::BenchCommand => "bench command",
            Self::BenchSilent => "bench command ended",
            Self::BenchExpired => "bench time over",
            Self::Maintenance => "maintenance",
            Self::MaintenanceOver => "maintenance over",
            Self::TiltLimit => "does not follow",
        }
    }
}

/// A change of state or, from a state to itself, a refusal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Event {
    /// The state before.
    pub from: ArmState,
    /// The state from now on.
    pub to: ArmState,
    /// Why.
    pub cause: Cause,
}

impl Event {
    /// Whether this is a request that was turned down, rather than a change.
    pub fn is_refusal(&self) -> bool {
        self.from == self.to || (self.from == ArmState::Arming && self.to == ArmState::Disarmed)
    }
}

/// The key to the motors, for one step. The board's output function takes it by value.
#[derive(Debug)]
#[must_use = "a permit that is not handed to the outputs leaves the motors at their last pulse"]
pub struct MotorPermit(Allowed);

#[derive(Debug)]
enum Allowed {
    Flight,
    Bench { rotor: usize, limit_us: f32 },
}

impl MotorPermit {
    /// What of these pulses (µs, rotors 1 to 4) may go out: on the bench, that of one rotor, up to its limit, and
    /// `stop_us` to the others. Uses the permit up.
    #[inline]
    pub fn apply(self, pulses_us: [f32; 4], stop_us: f32) -> [f32; 4] {
        match self.0 {
            Allowed::Flight => pulses_us,
            Allowed::Bench { rotor, limit_us } => {
                let mut allowed = [stop_us; 4];
                for (index, (out, us)) in allowed.iter_mut().zip(pulses_us).enumerate() {
                    if index == rotor {
                        *out = crate::arithmetic::min(us, limit_us);
                    }
                }
                allowed
            }
        }
    }
}

/// The one motor that may turn on the bench.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BenchMotor {
    /// Index of the rotor, 0 to 3.
    pub rotor: usize,
    /// The longest pulse it may get, µs.
    pub limit_us: f32,
}

/// The state, how long it has lasted, and whether the pilot's request has been answered.
#[derive(Clone, Copy, Debug)]
pub struct Arming {
    state: ArmState,
    in_state_us: u32,
    descent_us: u32,
    /// The pilot has not stopped asking since the last answer: what goes on is no new request. True at the start:
    /// so is what began before it.
    answered: bool,
    /// What held in the last step, if no row of the state fitted.
    undecided: Option<Conditions>,
}

impl Arming {
    /// Disarmed; a descent without a link takes `descent_us`, then the motors stop.
    pub fn new(descent_us: u32) -> Self {
        Self { state: ArmState::Disarmed, in_state_us: 0, descent_us, answered: true, undecided: None }
    }

    /// The present state.
    #[inline(always)]
    pub fn state(&self) -> ArmState {
        self.state
    }

    /// A permit for this step, if a motor may turn. `bench` is the motor of the bench command in force, if any.
    #[inline(always)]
    pub fn permit(&self, bench: impl FnOnce() -> Option<BenchMotor>) -> Option<MotorPermit> {
        match self.state {
            ArmState::Armed | ArmState::Descent => Some(MotorPermit(Allowed::Flight)),
            ArmState::Bench => {
                bench().map(|BenchMotor { rotor, limit_us }| MotorPermit(Allowed::Bench { rotor, limit_us }))
            }
            _ => None,
        }
    }

    /// Decides for a step that comes `dt_us` after the last.
    #[inline(always)]
    pub fn update(&mut self, mut now: Conditions, dt_us: u32) -> Option<Event> {
        self.in_state_us = self.in_state_us.saturating_add(dt_us);
        let allowed_us = match self.state {
            ArmState::Arming => CHECK_US,
            ArmState::Descent => self.descent_us,
            _ => u32::MAX,
        };
        if self.in_state_us >= allowed_us {
            now.insert(Conditions::TIME_UP);
        }
        if !now.contains(Conditions::ARM) {
            self.answered = false;
        } else if self.answered {
            now.remove(Conditions::ARM);
        }
        // The table has no memory: what decided nothing in the last step decides nothing in this one.
        if self.undecided == Some(now) {
            return None;
        }
        let Some(row) = decide(rows(self.state), now) else {
            self.undecided = Some(now);
            return None;
        };
        self.undecided = None;
        if row.when.contains(Conditions::ARM) {
            self.answered = true;
        }
        let event = Event { from: self.state, to: row.to, cause: row.cause };
        if event.to != event.from {
            self.state = event.to;
            self.in_state_us = 0;
        }
        Some(event)
    }
}

#[cfg(test)]
mod tests;
