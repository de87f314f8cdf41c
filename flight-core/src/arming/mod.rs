//! The arm state: whether the motors may turn, and how the flight controller reacts to failures.
//!
//! ```text
//!                  ┌────── a check fails ────────┐
//!                  ▼                             │
//!  Maintenance ◄► Disarmed ── arm request ─────► Arming ── checked for 0.5 s ──► Armed ──► Descent
//!                  ▲    ▲ ▼                                                      │  ▲        │ │
//!                  │    Bench                            disarm request ◄────────┘  └ link ──┘ │
//!                  └─── disarm request ──── Terminated ◄──── a fault, or the descent is over ──┘
//! ```
//!
//! [`table`] contains all transitions: one row for each way from a state to a state, decided by boolean
//! [`Conditions`]. [`Arming`] adds the time in the present state and remembers that a request has been answered.
//! `docs/safety.md` shows the same table.
//!
//! The motors can be driven only with a [`MotorPermit`]. Code outside this module cannot construct or copy one, and a
//! stored one has no use. [`Arming`] issues one permit per step in the states in which a motor may turn.

pub mod table;

use table::{Conditions, decide, rows};

/// Time for which the arming conditions are checked before the motors turn, µs.
const CHECK_US: u32 = 500_000;

/// The arm state: whether the motors may turn.
///
/// The discriminants are codes in a [`StepRecord`](crate::record::StepRecord) and never change; a new state gets the
/// next number.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[repr(u8)]
pub enum ArmState {
    /// Motors stopped. The state at start.
    #[default]
    Disarmed = 0,
    /// Motors stopped. The pilot has requested arming; all conditions are checked for another 0.5 s.
    Arming = 1,
    /// Motors turn at idle speed or faster, as the pilot commands.
    Armed = 2,
    /// Motors turn. The flight controller holds the vehicle level and lets it sink.
    Descent = 3,
    /// Motors stopped by a fault or at the end of a descent. The pilot must disarm before arming again.
    Terminated = 4,
    /// One motor may turn, at limited thrust, on a bench command.
    Bench = 5,
    /// Motors stopped. Flash may be erased.
    Maintenance = 6,
}

impl ArmState {
    /// All states, in the order of their codes.
    pub const ALL: [Self; 7] = [
        Self::Disarmed,
        Self::Arming,
        Self::Armed,
        Self::Descent,
        Self::Terminated,
        Self::Bench,
        Self::Maintenance,
    ];

    /// Returns the name of the state, as logs and `docs/safety.md` print it.
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

    /// Returns whether the flight controller controls the attitude: `Armed` or `Descent`.
    pub const fn flies(self) -> bool {
        matches!(self, Self::Armed | Self::Descent)
    }
}

/// The reason for a state change or for a refused request.
///
/// The discriminants are codes in a [`StepRecord`](crate::record::StepRecord) and never change; a new cause gets the
/// next number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[repr(u8)]
pub enum Cause {
    /// The pilot requested it.
    Pilot = 0,
    /// All arming conditions were met for the whole time of the check.
    Checked = 1,
    /// The outputs are locked because USB is plugged in.
    BenchLock = 2,
    /// The link to the pilot is lost.
    RcLost = 3,
    /// The link to the pilot is back.
    RcBack = 4,
    /// The throttle is not low.
    ThrottleUp = 5,
    /// No valid IMU samples arrive.
    ImuLost = 6,
    /// An axis of the IMU reads a constant value.
    ImuStuck = 7,
    /// The sensors have not been calibrated.
    NoCalibration = 8,
    /// The vehicle is not at rest.
    NotStill = 9,
    /// The vehicle is not level.
    NotLevel = 10,
    /// The battery voltage is too low to start a flight, or is not measured.
    BatteryLow = 11,
    /// The battery voltage is too low to continue the flight.
    BatteryCritical = 12,
    /// A task has missed its deadline.
    Overload = 13,
    /// The descent without a link has reached its time limit.
    DescentOver = 14,
    /// The watchdog has reset the board.
    WatchdogReset = 15,
    /// The pilot has not acknowledged the last fault by disarming.
    NotAcknowledged = 16,
    /// A bench command is in force.
    BenchCommand = 17,
    /// Bench commands have stopped.
    BenchSilent = 18,
    /// Bench commands have reached their time limit.
    BenchExpired = 19,
    /// Flash is about to be erased.
    Maintenance = 20,
    /// The request to erase flash has ended.
    MaintenanceOver = 21,
    /// The vehicle is tilted beyond what the sticks can command ([`crate::tilt_limit`]).
    TiltLimit = 22,
}

impl Cause {
    /// All causes, in the order of their codes.
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

    /// Returns a short description for logs and messages.
    pub const fn text(self) -> &'static str {
        match self {
            Self::Pilot => "by the pilot",
            Self::Checked => "checks passed",
            Self::BenchLock => "outputs locked by USB",
            Self::RcLost => "link lost",
            Self::RcBack => "link back",
            Self::ThrottleUp => "throttle not low",
            Self::ImuLost => "IMU lost",
            Self::ImuStuck => "IMU stuck",
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
            Self::TiltLimit => "tilt limit exceeded",
        }
    }
}

/// A change of the arm state or, if both states are the same, a refused request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Event {
    /// State before the step.
    pub from: ArmState,
    /// State after the step.
    pub to: ArmState,
    /// Reason.
    pub cause: Cause,
}

impl Event {
    /// Returns whether this event is a refused request: no change of state, or back from `Arming` to `Disarmed`.
    pub fn is_refusal(&self) -> bool {
        self.from == self.to || (self.from == ArmState::Arming && self.to == ArmState::Disarmed)
    }
}

/// Permission to drive the motors for one step. The output function of the board takes it by value.
#[derive(Debug)]
#[must_use = "a permit that is not handed to the outputs leaves the motors at their last pulse"]
pub struct MotorPermit(Allowed);

#[derive(Debug)]
enum Allowed {
    Flight,
    Bench { rotor: usize, limit_us: f32 },
}

impl MotorPermit {
    /// Returns the pulses that may be sent, given the wanted ones (µs, rotors 1 to 4). In flight these are the wanted
    /// pulses. On the bench one rotor gets its pulse, limited to the limit of the permit, and the others get
    /// `stop_us` (µs). Consumes the permit.
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

/// The motor that may turn on the bench.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BenchMotor {
    /// Index of the rotor, 0 to 3.
    pub rotor: usize,
    /// Longest permitted pulse, µs.
    pub limit_us: f32,
}

/// The arming state machine: the present state, the time spent in it, and whether the present request has been
/// answered.
#[derive(Clone, Copy, Debug)]
pub struct Arming {
    state: ArmState,
    in_state_us: u32,
    descent_us: u32,
    /// Whether the present arm request has been answered. It counts as a new request only after the pilot has
    /// released it. True at the start, so that a request that is already present then is ignored.
    request_answered: bool,
    /// Conditions of the last step, if no row of the state matched them.
    unmatched: Option<Conditions>,
}

impl Arming {
    /// Creates the state machine in `Disarmed`. A descent without a link lasts `descent_us` (µs); then the motors
    /// stop.
    pub fn new(descent_us: u32) -> Self {
        Self {
            state: ArmState::Disarmed,
            in_state_us: 0,
            descent_us,
            request_answered: true,
            unmatched: None,
        }
    }

    /// Returns the present state.
    #[inline(always)]
    pub fn state(&self) -> ArmState {
        self.state
    }

    /// Returns a permit for this step if a motor may turn. `bench` returns the motor of the bench command in force;
    /// it is called only in `Bench`.
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

    /// Updates the state for a step that comes `dt_us` (µs) after the last one. `now` holds the step's conditions
    /// without `TIME_UP`, which this function adds. Returns the change of state or the refusal, if there is one.
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
            self.request_answered = false;
        } else if self.request_answered {
            now.remove(Conditions::ARM);
        }
        // The table is stateless: conditions that matched no row in the last step match none in this step.
        if self.unmatched == Some(now) {
            return None;
        }
        let Some(row) = decide(rows(self.state), now) else {
            self.unmatched = Some(now);
            return None;
        };
        self.unmatched = None;
        if row.when.contains(Conditions::ARM) {
            self.request_answered = true;
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
