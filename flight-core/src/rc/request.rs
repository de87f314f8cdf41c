//! What the pilot asks of the arm state.

use super::{CENTRE_TICKS, Gesture, HIGH_TICKS, LOW_TICKS};

/// How long the arm gesture, or the arm switch, must be held, µs (PX4's COM_RC_ARM_HYST is the same second).
pub const ARM_HOLD_US: u32 = 1_000_000;
/// How long the disarm gesture must be held, µs.
pub const DISARM_HOLD_US: u32 = 500_000;
/// How long the arm switch must be off, µs: longer than one corrupt frame lasts, shorter than a person waits.
pub const SWITCH_OFF_US: u32 = 100_000;

/// A switch above this is on: three quarters of its travel, so that the middle of three positions is off.
pub const SWITCH_ON_TICKS: u16 = CENTRE_TICKS + (HIGH_TICKS - CENTRE_TICKS) / 2;
/// A switch below this is off.
pub const SWITCH_OFF_TICKS: u16 = LOW_TICKS + (CENTRE_TICKS - LOW_TICKS) / 2;

/// How a pilot arms and disarms.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum ArmBy {
    /// Throttle low and yaw full right; to disarm, full left.
    #[default]
    Sticks,
    /// The arm switch, with the throttle low.
    Switch,
}

/// What is asked at the moment, and since when.
#[derive(Clone, Copy, Debug, Default)]
pub struct Requests {
    asked: Asked,
    held_us: u32,
    /// The arm switch has been seen off since the link is there. One that is on when the transmitter comes on, or
    /// the board, arms nothing.
    seen_off: bool,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Asked {
    #[default]
    Nothing,
    Arm,
    Disarm,
}

impl Requests {
    /// Takes the last frame's gesture and arm switch for a step that comes `dt_us` after the last.
    #[inline]
    pub fn update(&mut self, by: ArmBy, gesture: Gesture, arm_switch: u16, link_lost: bool, dt_us: u32) {
        self.seen_off = !link_lost && (self.seen_off || arm_switch <= SWITCH_ON_TICKS);
        let asked = match by {
            // What a lost link last said is no request.
            _ if link_lost => Asked::Nothing,
            ArmBy::Sticks => match gesture {
                Gesture::None => Asked::Nothing,
                Gesture::Arm => Asked::Arm,
                Gesture::Disarm => Asked::Disarm,
            },
            ArmBy::Switch if arm_switch > SWITCH_ON_TICKS && self.seen_off => Asked::Arm,
            ArmBy::Switch if arm_switch < SWITCH_OFF_TICKS => Asked::Disarm,
            ArmBy::Switch => Asked::Nothing,
        };
        self.held_us = if asked == self.asked { self.held_us.saturating_add(dt_us) } else { 0 };
        self.asked = asked;
    }

    /// Whether the motors are asked for.
    #[inline(always)]
    pub fn arm(&self) -> bool {
        self.asked == Asked::Arm && self.held_us >= ARM_HOLD_US
    }

    /// Whether they are asked to stop.
    #[inline(always)]
    pub fn disarm(&self, by: ArmBy) -> bool {
        let hold_us = match by {
            ArmBy::Sticks => DISARM_HOLD_US,
            ArmBy::Switch => SWITCH_OFF_US,
        };
        self.asked == Asked::Disarm && self.held_us >= hold_us
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// What is asked for is what has been shown in each step since long enough ago, the first of them not counted:
        /// nobody knows since when it has been shown there. The switch asks for the motors only after it has been
        /// seen off.
        #[test]
        fn a_request_is_what_has_been_shown_for_long_enough(
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
            let (mut seen_off, mut shown, mut held_us) = (false, None, 0_u64);
            for (gesture, switch, lost, times, dt_us) in past {
                for _ in 0..times {
                    requests.update(by, gesture, switch, lost, dt_us);
                    // Three quarters of the way up from 172 to 1811 are 1401, a quarter 582.
                    let (on, off) = (switch > 1_401, switch < 582);
                    seen_off = !lost && (seen_off || !on);
                    let now = match by {
                        _ if lost => None,
                        ArmBy::Sticks => match gesture {
                            Gesture::Arm => Some(true),
                            Gesture::Disarm => Some(false),
                            Gesture::None => None,
                        },
                        ArmBy::Switch => if on && seen_off { Some(true) } else if off { Some(false) } else { None },
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
    fn gestures_must_be_held() {
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
    fn a_switch_asks_at_its_ends_and_its_middle_asks_nothing() {
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
    fn a_lost_link_asks_nothing() {
        let mut requests = Requests::default();
        for _ in 0..3_000 {
            requests.update(ArmBy::Switch, Gesture::Arm, HIGH_TICKS, true, 1_000);
        }
        assert!(!requests.arm());
    }
}
