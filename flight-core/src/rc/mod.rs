//! From receiver ticks to what the pilot wants.
//!
//! | channel | low | centre | high |
//! |---|---|---|---|
//! | throttle | no thrust | half of the thrust | all of it |
//! | roll | left | level | right |
//! | pitch | back: nose up | level | forward: nose down |
//! | yaw | left: anticlockwise from above | hold heading | right: clockwise |
//! | arm switch ([`ArmBy::Switch`]) | stop the motors | – | let them turn |
//! | mode switch | [`FlightMode::Angle`] | the same | [`FlightMode::Rate`] |
//!
//! [`link`] says whether the pilot is there at all, [`request`] what the pilot asks of the arm state.

pub mod link;
pub mod request;

use crate::arithmetic::max;
use crate::range::{ConfigError, check};
use crate::sample::{LinkStatus, RcFrame};

pub use link::Link;
pub use request::{ArmBy, Requests};

/// Which of a receiver's channels is what, counted from 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ChannelMap {
    /// Throttle, roll, pitch, yaw.
    pub sticks: [u8; 4],
    /// Arm switch.
    pub arm: u8,
    /// Mode switch.
    pub mode: u8,
}

impl ChannelMap {
    /// Roll, pitch, throttle, yaw, arm, mode: "AETR", and the arm switch where ExpressLRS wants it.
    pub const AETR: Self = Self { sticks: [2, 0, 1, 3], arm: 4, mode: 5 };

    /// # Errors
    /// A channel that a receiver does not have.
    pub(crate) fn validate(&self) -> Result<(), ConfigError> {
        for channel in self.sticks.into_iter().chain([self.arm, self.mode]) {
            check("rc.channels", f32::from(channel), 0.0, 15.0)?;
        }
        Ok(())
    }

    /// The frame in a receiver's channels (ticks).
    pub fn frame(&self, channels: &[u16; 16], status: LinkStatus) -> RcFrame {
        // The mask keeps an index in range without a branch; `validate` has seen to it that it changes nothing.
        let ticks = |channel: u8| channels[usize::from(channel & 15)];
        RcFrame {
            channels: self.sticks.map(ticks),
            arm_switch: ticks(self.arm),
            mode_switch: ticks(self.mode),
            status,
        }
    }
}

/// What the roll and pitch sticks command.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum FlightMode {
    /// An angle: sticks centred, the vehicle levels itself.
    #[default]
    Angle,
    /// A rate: sticks centred, the vehicle stays as it is.
    Rate,
}

impl FlightMode {
    /// What the mode switch says.
    pub fn from_frame(frame: &RcFrame) -> Self {
        if frame.mode_switch > request::SWITCH_ON_TICKS { Self::Rate } else { Self::Angle }
    }
}

/// Tick of a stick at its low end (SBUS and CRSF: 988 µs).
pub const LOW_TICKS: u16 = 172;
/// Tick of a centred stick (1,500 µs).
pub const CENTRE_TICKS: u16 = 992;
/// Tick of a stick at its high end (2,012 µs).
pub const HIGH_TICKS: u16 = 1811;

/// Stick positions. A transmitter's extended end points (beyond 172 and 1811) read as full deflection.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sticks {
    /// 0 to 1.
    pub throttle: f32,
    /// −1 (left) to 1 (right).
    pub roll: f32,
    /// −1 (nose up) to 1 (nose down).
    pub pitch: f32,
    /// −1 (anticlockwise from above) to 1 (clockwise).
    pub yaw: f32,
}

impl Sticks {
    /// Reads a frame.
    pub fn from_frame(frame: &RcFrame) -> Self {
        const SPAN: f32 = (HIGH_TICKS - LOW_TICKS) as f32;
        const HALF_SPAN: f32 = (HIGH_TICKS - CENTRE_TICKS) as f32;
        let [throttle, roll, pitch, yaw] = frame.channels.map(|t| i32::from(t.clamp(LOW_TICKS, HIGH_TICKS)));
        // 172 is 820 ticks below the centre, 1811 is 819 above: full low stick reads −1, not −1.001.
        let centred = |ticks: i32| max((ticks - i32::from(CENTRE_TICKS)) as f32 / HALF_SPAN, -1.0);
        Self {
            throttle: (throttle - i32::from(LOW_TICKS)) as f32 / SPAN,
            roll: centred(roll),
            pitch: centred(pitch),
            yaw: centred(yaw),
        }
    }

    /// Whether the throttle counts as low.
    #[inline(always)]
    pub fn throttle_is_low(&self) -> bool {
        self.throttle < LOW_THROTTLE
    }

    /// What the sticks ask for by where they are held.
    pub fn gesture(&self) -> Gesture {
        if !self.throttle_is_low() {
            Gesture::None
        } else if self.yaw > FULL_YAW {
            Gesture::Arm
        } else if self.yaw < -FULL_YAW {
            Gesture::Disarm
        } else {
            Gesture::None
        }
    }
}

/// Below this the throttle counts as low.
const LOW_THROTTLE: f32 = 0.05;
/// Beyond this the yaw stick counts as fully deflected.
const FULL_YAW: f32 = 0.9;

/// A wish that the pilot expresses with both sticks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Gesture {
    /// Nothing but flying.
    #[default]
    None,
    /// Throttle low, yaw full right.
    Arm,
    /// Throttle low, yaw full left.
    Disarm,
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Any ticks, also such as no receiver sends: within range, a straight line on either side of the centre, and
        /// full deflection beyond the ends.
        #[test]
        fn sticks_of_any_ticks(
            channels in prop::array::uniform4(prop_oneof![
                0..=2047_u16, any::<u16>(), prop::sample::select(&[172, 992, 1811, 253, 254, 1729, 1730][..]),
            ]),
            mode_switch in prop_oneof![4 => any::<u16>(), 1 => 1_401..=1_402_u16],
        ) {
            let frame = RcFrame { channels, arm_switch: 0, mode_switch, status: LinkStatus::Good };
            let sticks = Sticks::from_frame(&frame);
            let line = |ticks: u16, low: f64, high: f64| {
                // From `low` to 1 over the upper half, and the same slope below, but not below `low`.
                let at = f64::from(ticks.clamp(172, 1811));
                if high == 1811.0 - 172.0 { (at - 172.0) / high } else { ((at - 992.0) / high).max(low) }
            };
            let near = |ours: f32, exact: f64| (f64::from(ours) - exact).abs() < 1e-7;
            prop_assert!(near(sticks.throttle, line(channels[0], 0.0, 1639.0)));
            for (ours, ticks) in [sticks.roll, sticks.pitch, sticks.yaw].into_iter().zip(&channels[1..]) {
                prop_assert!(near(ours, line(*ticks, -1.0, 819.0)), "{}: {}", ticks, ours);
            }
            // 5 % of 1,639 are 81.95 ticks, 90 % of 819 are 737.1.
            let low = channels[0] < 254;
            prop_assert_eq!(sticks.throttle_is_low(), low);
            let gesture = match channels[3] {
                1730.. if low => Gesture::Arm,
                ..=254 if low => Gesture::Disarm,
                _ => Gesture::None,
            };
            prop_assert_eq!(sticks.gesture(), gesture);
            let rate = mode_switch > 1_401;
            prop_assert_eq!(FlightMode::from_frame(&frame), if rate { FlightMode::Rate } else { FlightMode::Angle });
        }

        /// Any map gives a frame; one of channels that a receiver does not have is refused.
        #[test]
        fn maps_of_any_channels(
            sticks in prop::array::uniform4(0..20_u8), arm in 0..20_u8, mode in any::<u8>(),
            channels in prop::array::uniform16(any::<u16>()),
        ) {
            let map = ChannelMap { sticks, arm, mode };
            let all = sticks.into_iter().chain([arm, mode]);
            let good = all.clone().all(|channel| channel < 16);
            prop_assert_eq!(map.validate().is_ok(), good);
            let frame = map.frame(&channels, LinkStatus::Good);
            if good {
                let ticks: std::vec::Vec<u16> = all.map(|channel| channels[usize::from(channel)]).collect();
                prop_assert_eq!(&ticks[..4], &frame.channels[..]);
                prop_assert_eq!(&ticks[4..], &[frame.arm_switch, frame.mode_switch][..]);
            }
        }
    }

    #[test]
    fn ends_and_centre() {
        let frame = |channels| RcFrame {
            channels,
            arm_switch: LOW_TICKS,
            mode_switch: LOW_TICKS,
            status: LinkStatus::Good,
        };
        let low = Sticks::from_frame(&frame([LOW_TICKS; 4]));
        assert_eq!(low, Sticks { throttle: 0.0, roll: -1.0, pitch: -1.0, yaw: -1.0 });
        assert_eq!(low.gesture(), Gesture::Disarm);
        let high = Sticks::from_frame(&frame([2047; 4]));
        assert_eq!(high, Sticks { throttle: 1.0, roll: 1.0, pitch: 1.0, yaw: 1.0 });
        assert_eq!(high.gesture(), Gesture::None);
        let arm = Sticks::from_frame(&frame([LOW_TICKS, CENTRE_TICKS, CENTRE_TICKS, HIGH_TICKS]));
        assert_eq!((arm.gesture(), arm.roll, arm.pitch), (Gesture::Arm, 0.0, 0.0));
    }

    #[test]
    fn a_gesture_is_beyond_its_limits_and_not_at_them() {
        let sticks = |throttle, yaw| Sticks { throttle, yaw, ..Sticks::default() };
        for (throttle, yaw, gesture) in [
            (0.05, 1.0, Gesture::None),
            (0.05_f32.next_down(), 1.0, Gesture::Arm),
            (0.0, 0.9, Gesture::None),
            (0.0, 0.9_f32.next_up(), Gesture::Arm),
            (0.0, -0.9, Gesture::None),
            (0.0, -(0.9_f32.next_up()), Gesture::Disarm),
            (f32::NAN, 1.0, Gesture::None),
            (0.0, f32::NAN, Gesture::None),
        ] {
            assert_eq!(sticks(throttle, yaw).gesture(), gesture, "{throttle} {yaw}");
        }
    }

    #[test]
    fn channels_of_a_receiver() {
        let mut channels = [0; 16];
        for (index, channel) in channels.iter_mut().enumerate() {
            *channel = 1_000 + index as u16;
        }
        let frame = ChannelMap::AETR.frame(&channels, LinkStatus::FrameLost);
        assert_eq!(frame.channels, [1_002, 1_000, 1_001, 1_003]);
        assert_eq!((frame.arm_switch, frame.mode_switch), (1_004, 1_005));
        assert_eq!(frame.status, LinkStatus::FrameLost);
        assert_eq!(FlightMode::from_frame(&frame), FlightMode::Angle);
        assert_eq!(FlightMode::from_frame(&RcFrame { mode_switch: HIGH_TICKS, ..frame }), FlightMode::Rate);
        let map = ChannelMap { mode: 16, ..ChannelMap::AETR };
        assert_eq!(map.validate().unwrap_err().field, "rc.channels");
    }
}
