//! Whether the motors may turn.
//!
//! The motors depend on a [`MotorPermit`], which cannot be copied, stored between steps to any use, or made
//! outside this module; [`Arming`] hands one out per step while it is armed. A pilot arms by holding throttle
//! low and yaw full right for a second, and disarms by holding throttle low and yaw full left.
//!
//! | state | goes to | when |
//! |---|---|---|
//! | `Disarmed` | `Armed` | the arm gesture is held for 1 s and nothing refuses ([`Refusal`]) |
//! | `Armed` | `Disarmed` | the disarm gesture is held for 0.5 s, or a [`DisarmCause`] occurs |

use crate::rc::Gesture;

/// How long the arm gesture must be held, s.
pub const ARM_HOLD_S: f32 = 1.0;
/// How long the disarm gesture must be held, s.
pub const DISARM_HOLD_S: f32 = 0.5;
/// Age of the last receiver frame at which the link counts as lost, µs.
pub const RC_LOST_US: u32 = 1_000_000;
/// Age of the last inertial sample at which the sensor counts as lost, µs.
pub const IMU_LOST_US: u32 = 100_000;
/// cos 25°: further from level than this, arming is refused.
const ARM_COS_TILT: f32 = 0.906_308;

/// The key to the motors, for one step. The board's output function takes it by value.
#[derive(Debug)]
#[must_use = "a permit that is not handed to the outputs leaves the motors at their last pulse"]
pub struct MotorPermit {
    _only_arming_makes_one: (),
}

/// Whether the motors may turn.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ArmState {
    /// They may not.
    #[default]
    Disarmed,
    /// They turn at idle or faster.
    Armed,
}

/// Why an arm gesture was refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refusal {
    /// The outputs are locked: USB or bench mode.
    BenchLock,
    /// No inertial sample for [`IMU_LOST_US`].
    ImuLost,
    /// The vehicle has not been still since it was last moved, or since start.
    NotStill,
    /// More than 25° from level.
    NotLevel,
    /// The battery is below the voltage at which a flight may start.
    BatteryLow,
}

/// Why the motors were stopped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DisarmCause {
    /// The pilot's gesture.
    Sticks,
    /// The outputs were locked: USB or bench mode.
    BenchLock,
    /// No inertial sample for [`IMU_LOST_US`].
    ImuLost,
    /// No receiver frame for [`RC_LOST_US`].
    RcLost,
}

/// A change of, or an attempt at, the arm state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// The motors may turn from now on.
    Armed,
    /// The motors are stopped from now on.
    Disarmed(DisarmCause),
    /// The arm gesture was held, and refused.
    Refused(Refusal),
}

/// What the decision depends on.
#[derive(Clone, Copy, Debug)]
pub struct Conditions {
    /// What the sticks ask for.
    pub gesture: Gesture,
    /// The receiver's last frame is older than [`RC_LOST_US`], or there has been none.
    pub rc_lost: bool,
    /// The last inertial sample is older than [`IMU_LOST_US`], or there has been none.
    pub imu_lost: bool,
    /// The vehicle lies still and the gyroscope is zeroed.
    pub still: bool,
    /// Cosine of the estimated tilt.
    pub cos_tilt: f32,
    /// The battery is known to be below its minimum.
    pub battery_low: bool,
    /// The outputs are locked.
    pub bench_lock: bool,
}

/// The arm state and the clock of the gesture that would change it.
#[derive(Clone, Copy, Debug, Default)]
pub struct Arming {
    state: ArmState,
    held_s: f32,
    refused: bool,
}

impl Arming {
    /// The present state.
    pub fn state(&self) -> ArmState {
        self.state
    }

    /// A permit for this step, if armed.
    pub fn permit(&self) -> Option<MotorPermit> {
        (self.state == ArmState::Armed).then_some(MotorPermit { _only_arming_makes_one: () })
    }

    /// Decides for a step of `dt_s`.
    pub fn update(&mut self, now: &Conditions, dt_s: f32) -> Option<Event> {
        let asked = match self.state {
            ArmState::Disarmed => now.gesture == Gesture::Arm,
            ArmState::Armed => now.gesture == Gesture::Disarm,
        };
        // What a lost link last said is not a gesture.
        self.held_s = if asked && !now.rc_lost { self.held_s + dt_s } else { 0.0 };
        match self.state {
            ArmState::Disarmed => self.try_to_arm(now),
            ArmState::Armed => self.try_to_disarm(now),
        }
    }

    fn try_to_arm(&mut self, now: &Conditions) -> Option<Event> {
        if self.held_s < ARM_HOLD_S {
            self.refused = false;
            return None;
        }
        let refusal = if now.bench_lock {
            Some(Refusal::BenchLock)
        } else if now.imu_lost {
            Some(Refusal::ImuLost)
        } else if !now.still {
            Some(Refusal::NotStill)
        } else if now.cos_tilt < ARM_COS_TILT {
            Some(Refusal::NotLevel)
        } else if now.battery_low {
            Some(Refusal::BatteryLow)
        } else {
            None
        };
        match refusal {
            None => {
                *self = Self { state: ArmState::Armed, ..Self::default() };
                Some(Event::Armed)
            }
            // Said once a gesture; the sticks must be let go before the next try.
            Some(_) if self.refused => None,
            Some(refusal) => {
                self.refused = true;
                Some(Event::Refused(refusal))
            }
        }
    }

    fn try_to_disarm(&mut self, now: &Conditions) -> Option<Event> {
        let cause = if now.bench_lock {
            DisarmCause::BenchLock
        } else if now.imu_lost {
            DisarmCause::ImuLost
        } else if now.rc_lost {
            DisarmCause::RcLost
        } else if self.held_s >= DISARM_HOLD_S {
            DisarmCause::Sticks
        } else {
            return None;
        };
        *self = Self::default();
        Some(Event::Disarmed(cause))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const READY: Conditions = Conditions {
        gesture: Gesture::Arm,
        rc_lost: false,
        imu_lost: false,
        still: true,
        cos_tilt: 1.0,
        battery_low: false,
        bench_lock: false,
    };
    const FLYING: Conditions = Conditions { gesture: Gesture::None, still: false, cos_tilt: 0.5, ..READY };

    fn run(arming: &mut Arming, now: Conditions, seconds: f32) -> std::vec::Vec<Event> {
        (0..(seconds * 1000.0) as u32).filter_map(|_| arming.update(&now, 0.001)).collect()
    }

    fn armed() -> Arming {
        let mut arming = Arming::default();
        assert_eq!(run(&mut arming, READY, 1.1), [Event::Armed]);
        arming
    }

    #[test]
    fn arms_after_the_gesture_is_held_and_not_before() {
        let mut arming = Arming::default();
        assert!(run(&mut arming, READY, 0.9).is_empty());
        assert!(run(&mut arming, FLYING, 0.1).is_empty());
        assert!(run(&mut arming, READY, 0.9).is_empty());
        assert!(arming.permit().is_none());
        assert_eq!(run(&mut arming, READY, 0.2), [Event::Armed]);
        assert!(arming.permit().is_some());
    }

    #[test]
    fn every_refusal_has_its_condition_and_is_said_once() {
        let cases = [
            (Conditions { bench_lock: true, ..READY }, Refusal::BenchLock),
            (Conditions { imu_lost: true, ..READY }, Refusal::ImuLost),
            (Conditions { still: false, ..READY }, Refusal::NotStill),
            (Conditions { cos_tilt: 0.9, ..READY }, Refusal::NotLevel),
            (Conditions { battery_low: true, ..READY }, Refusal::BatteryLow),
        ];
        for (now, refusal) in cases {
            let mut arming = Arming::default();
            assert_eq!(run(&mut arming, now, 3.0), [Event::Refused(refusal)]);
            assert!(arming.permit().is_none());
        }
    }

    #[test]
    fn nothing_of_a_lost_link_arms() {
        let mut arming = Arming::default();
        assert!(run(&mut arming, Conditions { rc_lost: true, ..READY }, 3.0).is_empty());
        assert_eq!(arming.state(), ArmState::Disarmed);
    }

    #[test]
    fn every_cause_stops_the_motors() {
        let cases = [
            (Conditions { bench_lock: true, ..FLYING }, DisarmCause::BenchLock),
            (Conditions { imu_lost: true, ..FLYING }, DisarmCause::ImuLost),
            (Conditions { rc_lost: true, ..FLYING }, DisarmCause::RcLost),
            (Conditions { gesture: Gesture::Disarm, ..FLYING }, DisarmCause::Sticks),
        ];
        for (now, cause) in cases {
            let mut arming = armed();
            assert!(run(&mut arming, FLYING, 5.0).is_empty());
            assert_eq!(run(&mut arming, now, 1.0), [Event::Disarmed(cause)]);
            assert!(arming.permit().is_none());
        }
    }
}
