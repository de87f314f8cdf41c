//! Requests of the pilot to arm and disarm.

use super::{CENTRE_TICKS, Gesture, HIGH_TICKS, LOW_TICKS};

/// Time for which the arm gesture or the arm switch must be held, µs. PX4 has the same 1 s (COM_RC_ARM_HYST).
pub const ARM_HOLD_US: u32 = 1_000_000;
/// Time for which the disarm gesture must be held, µs.
pub const DISARM_HOLD_US: u32 = 500_000;
/// Time for which the arm switch must be off to disarm, µs: longer than one corrupt frame lasts, but short for the
/// pilot.
pub const SWITCH_OFF_US: u32 = 100_000;

/// A switch is on above this position, ticks: three quarters of its travel, so that the middle of three is off.
pub const SWITCH_ON_TICKS: u16 = CENTRE_TICKS + (HIGH_TICKS - CENTRE_TICKS) / 2;
/// A switch is off for disarming below this position, ticks: a quarter of its travel.
pub const SWITCH_OFF_TICKS: u16 = LOW_TICKS + (CENTRE_TICKS - LOW_TICKS) / 2;

/// The control with which the pilot arms and disarms.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum ArmBy {
    /// Stick gestures: throttle low and yaw full right to arm, full left to disarm.
    #[default]
    Sticks,
    /// The arm switch. Arming also needs a low throttle.
    Switch,
}

/// The present request and the time for which it has been held.
#[derive(Clone, Copy, Debug, Default)]
pub struct Requests {
    present: Request,
    held_us: u32,
    /// Whether the arm switch has been off since the link came up. A switch that is already on when the transmitter
    /// or the board is switched on does not arm.
    switch_was_off: bool,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Request {
    #[default]
    None,
    Arm,
    Disarm,
}

impl Requests {
    /// Updates the request from the gesture and the arm switch (ticks) of the last frame, for a step that comes
    /// `dt_us` (µs) after the last one.
    #[inline]
    pub fn update(&mut self, by: ArmBy, gesture: Gesture, arm_switch: u16, link_lost: bool, dt_us: u32) {
        self.switch_was_off = !link_lost && (self.switch_was_off || arm_switch <= SWITCH_ON_TICKS);
        let shown = match by {
            // With a lost link the last frame is no request.
            _ if link_lost => Request::None,
            ArmBy::Sticks => match gesture {
                Gesture::None => Request::None,
                Gesture::Arm => Request::Arm,
                Gesture::Disarm => Request::Disarm,
            },
            ArmBy::Switch if arm_switch > SWITCH_ON_TICKS && self.switch_was_off => Request::Arm,
            ArmBy::Switch if arm_switch < SWITCH_OFF_TICKS => Request::Disarm,
            ArmBy::Switch => Request::None,
        };
        self.held_us = if shown == self.present { self.held_us.saturating_add(dt_us) } else { 0 };
        self.present = shown;
    }

    /// Returns whether arming is requested.
    #[inline(always)]
    pub fn arm(&self) -> bool {
        self.present == Request::Arm && self.held_us >= ARM_HOLD_US
    }

    /// Returns whether disarming is requested, for the control `by`.
    #[inline(always)]
    pub fn disarm(&self, by: ArmBy) -> bool {
        let hold_us = match by {
            ArmBy::Sticks => DISARM_HOLD_US,
            ArmBy::Switch => SWITCH_OFF_US,
        };
        self.present == Request::Disarm && self.held_us >= hold_us
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// A request holds if it has been shown in every step for long enough. The time before the first of these
        /// steps does not count, because the request may have begun at any moment in it. The switch can arm only
        /// after it has been off.
        #[test]
        fn request_holds_when_shown_long_enough(
            by in prop::sample::select(&[ArmBy::Sticks, ArmBy::Switch][..]),
            past in prop::collection::vec((
                prop::sample::select(&[Gesture::Arm, Gesture::Disarm, Gesture::None][..]),
                prop_oneof![
                    4 => prop::sample::select(&[LOW_TICKS, CENTRE_TICKS, HIGH_TICKS, 1_401, 1_402, 581, 582][..]),
                    1 => any::<u16>(),
                ],
                prop::bool::weighted(0.05),
                1..8_usize,
                prop_oneof![3 => 0..200_000_u32, 2 => Just(100_000), 1 => Just(250_000), 1 => Just(1_000_000), 1 => Just(u32::MAX)],
            ), 1..20),
        ) {
            let mut requests = Requests::default();
            let (mut switch_was_off, mut shown, mut held_us) = (false, None, 0_u64);
            for (gesture, switch, lost, times, dt_us) in past {
                for _ in 0..times {
                    requests.update(by, gesture, switch, lost, dt_us);
                    // The range is 172 to 1811 ticks. Three quarters of it end at 1401, a quarter at 582.
                    let (on, off) = (switch > 1_401, switch < 582);
                    switch_was_off = !lost && (switch_was_off || !on);
                    let now = match by {
                        _ if lost => None,
                        ArmBy::Sticks => match gesture {
                            Gesture::Arm => Some(true),
                            Gesture::Disarm => Some(false),
                            Gesture::None => None,
                        },
                        ArmBy::Switch => if on && switch_was_off { Some(true) } else if off { Some(false) } else { None },
                    };
                    held_us = if now == shown { held_us + u64::from(dt_us) } else { 0 };
                    shown = now;
                    let disarm_us = if by == ArmBy::Sticks { 500_000 } else { 100_000 };
                    prop_assert_eq!(requests.arm(), shown == Some(true) && held_us >= 1_000_000);
                    prop_assert_eq!(requests.disarm(by), shown == Some(false) && held_us >= disarm_us);
                }
            }
        }
    }

    #[test]
    fn gestures_must_be_held_for_their_time() {
        let mut requests = Requests::default();
        let mut hold = |gesture, ms: u32| {
            for _ in 0..ms {
                requests.update(ArmBy::Sticks, gesture, CENTRE_TICKS, false, 1_000);
            }
            (requests.arm(), requests.disarm(ArmBy::Sticks))
        };
        assert_eq!(hold(Gesture::Arm, 1_000), (false, false));
        assert_eq!(hold(Gesture::None, 1), (false, false));
        assert_eq!(hold(Gesture::Arm, 1_000), (false, false));
        assert_eq!(hold(Gesture::Arm, 1), (true, false));
        assert_eq!(hold(Gesture::Disarm, 500), (false, false));
        assert_eq!(hold(Gesture::Disarm, 1), (false, true));
    }

    #[test]
    fn switch_arms_and_disarms_only_at_its_ends() {
        let mut requests = Requests::default();
        let mut hold = |ticks, ms: u32| {
            for _ in 0..ms {
                requests.update(ArmBy::Switch, Gesture::Arm, ticks, false, 1_000);
            }
            (requests.arm(), requests.disarm(ArmBy::Switch))
        };
        assert_eq!(hold(HIGH_TICKS, 2_000), (false, false), "on from the start");
        assert_eq!(hold(CENTRE_TICKS, 1), (false, false));
        assert_eq!(hold(HIGH_TICKS, 1_000), (false, false));
        assert_eq!(hold(HIGH_TICKS, 1), (true, false));
        assert_eq!(hold(CENTRE_TICKS, 2_000), (false, false));
        assert_eq!(hold(LOW_TICKS, 100), (false, false));
        assert_eq!(hold(LOW_TICKS, 1), (false, true));
    }

    #[test]
    fn lost_link_requests_nothing() {
        let mut requests = Requests::default();
        for _ in 0..3_000 {
            requests.update(ArmBy::Switch, Gesture::Arm, HIGH_TICKS, true, 1_000);
        }
        assert!(!requests.arm());
    }
}
