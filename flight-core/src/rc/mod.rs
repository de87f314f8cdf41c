//! Conversion of receiver ticks into stick positions, flight mode and requests.
//!
//! | channel | low | centre | high |
//! |---|---|---|---|
//! | throttle | no thrust | half thrust | full thrust |
//! | roll | left | level | right |
//! | pitch | back: nose up | level | forward: nose down |
//! | yaw | left: anticlockwise from above | hold heading | right: clockwise |
//! | arm switch ([`ArmBy::Switch`]) | disarm | – | arm |
//! | mode switch | [`FlightMode::Angle`] | the same | [`FlightMode::Rate`] |
//!
//! [`link`] detects link loss; [`request`] detects requests to arm and disarm.

pub mod link;
pub mod request;

use crate::arithmetic::max;
use crate::range::{ConfigError, check};
use crate::sample::{LinkStatus, RcFrame};

pub use link::Link;
pub use request::{ArmBy, Requests};

/// Assignment of the receiver's channels, counted from 0 to 15.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ChannelMap {
    /// Channels of throttle, roll, pitch and yaw.
    pub sticks: [u8; 4],
    /// Channel of the arm switch.
    pub arm: u8,
    /// Channel of the mode switch.
    pub mode: u8,
}

impl ChannelMap {
    /// Order roll, pitch, throttle, yaw, arm, mode ("AETR"), with the arm switch on channel 5 (index 4), where ExpressLRS
    /// expects it.
    pub const AETR: Self = Self { sticks: [2, 0, 1, 3], arm: 4, mode: 5 };

    /// Checks the channels.
    ///
    /// # Errors
    /// Returns the first channel above 15.
    pub(crate) fn validate(&self) -> Result<(), ConfigError> {
        for channel in self.sticks.into_iter().chain([self.arm, self.mode]) {
            check("rc.channels", f32::from(channel), 0.0, 15.0)?;
        }
        Ok(())
    }

    /// Returns the frame that a receiver's 16 channels (ticks) contain.
    pub fn frame(&self, channels: &[u16; 16], status: LinkStatus) -> RcFrame {
        // The mask bounds the index without a branch. It changes no channel that `validate` accepts.
        let ticks = |channel: u8| channels[usize::from(channel & 15)];
        RcFrame {
            channels: self.sticks.map(ticks),
            arm_switch: ticks(self.arm),
            mode_switch: ticks(self.mode),
            status,
        }
    }
}

/// The quantity that the roll and pitch sticks command.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum FlightMode {
    /// An angle: with centred sticks the vehicle returns to level.
    #[default]
    Angle,
    /// A rate: with centred sticks the vehicle keeps its attitude.
    Rate,
}

impl FlightMode {
    /// Returns the mode that the mode switch of a frame selects.
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

/// Stick positions. Extended end points of a transmitter (ticks beyond 172 and 1811) read as full deflection.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sticks {
    /// Throttle, 0 to 1.
    pub throttle: f32,
    /// Roll, −1 (left) to 1 (right).
    pub roll: f32,
    /// Pitch, −1 (nose up) to 1 (nose down).
    pub pitch: f32,
    /// Yaw, −1 (anticlockwise seen from above) to 1 (clockwise).
    pub yaw: f32,
}

impl Sticks {
    /// Returns the stick positions of a frame.
    pub fn from_frame(frame: &RcFrame) -> Self {
        const SPAN: f32 = (HIGH_TICKS - LOW_TICKS) as f32;
        const HALF_SPAN: f32 = (HIGH_TICKS - CENTRE_TICKS) as f32;
        let [throttle, roll, pitch, yaw] = frame.channels.map(|t| i32::from(t.clamp(LOW_TICKS, HIGH_TICKS)));
        // 172 is 820 ticks below the centre, 1811 is 819 above it. The limit makes full low stick −1 instead of
        // −1.001.
        let centred = |ticks: i32| max((ticks - i32::from(CENTRE_TICKS)) as f32 / HALF_SPAN, -1.0);
        Self {
            throttle: (throttle - i32::from(LOW_TICKS)) as f32 / SPAN,
            roll: centred(roll),
            pitch: centred(pitch),
            yaw: centred(yaw),
        }
    }

    /// Returns whether the throttle is low: below 5 %.
    #[inline(always)]
    pub fn throttle_is_low(&self) -> bool {
        self.throttle < LOW_THROTTLE
    }

    /// Returns the gesture that the stick positions form.
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

/// The throttle counts as low below this value.
const LOW_THROTTLE: f32 = 0.05;
/// Deflection beyond which the yaw stick counts as fully deflected.
const FULL_YAW: f32 = 0.9;

/// A stick position that requests arming or disarming.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Gesture {
    /// No request.
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
        /// Compares the positions for any ticks with a straight line on either side of the centre. Beyond the ends of
        /// the range the deflection is full.
        #[test]
        fn any_ticks_give_positions_in_range(
            channels in prop::array::uniform4(prop_oneof![
                0..=2047_u16, any::<u16>(), prop::sample::select(&[172, 992, 1811, 253, 254, 1729, 1730][..]),
            ]),
            mode_switch in prop_oneof![4 => any::<u16>(), 1 => 1_401..=1_402_u16],
        ) {
            let frame = RcFrame { channels, arm_switch: 0, mode_switch, status: LinkStatus::Good };
            let sticks = Sticks::from_frame(&frame);
            let line = |ticks: u16, low: f64, high: f64| {
                // The result goes from 0 to 1 over the upper half. Below the centre it has the same slope, and is
                // limited to `low`.
                let at = f64::from(ticks.clamp(172, 1811));
                if high == 1811.0 - 172.0 { (at - 172.0) / high } else { ((at - 992.0) / high).max(low) }
            };
            let near = |ours: f32, exact: f64| (f64::from(ours) - exact).abs() < 1e-7;
            prop_assert!(near(sticks.throttle, line(channels[0], 0.0, 1639.0)));
            for (ours, ticks) in [sticks.roll, sticks.pitch, sticks.yaw].into_iter().zip(&channels[1..]) {
                prop_assert!(near(ours, line(*ticks, -1.0, 819.0)), "{}: {}", ticks, ours);
            }
            // 5 % of 1,639 is 81.95 ticks, 90 % of 819 is 737.1 ticks.
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

        /// Any valid map selects its channels; a map with a channel above 15 is rejected.
        #[test]
        fn any_channel_map_selects_or_is_rejected(
            sticks in prop::array::uniform4(0..20_u8), arm in 0..20_u8, mode in any::<u8>(),
            channels in prop::array::uniform16(any::<u16>()),
        ) {
            let map = ChannelMap { sticks, arm, mode };
            let all = sticks.into_iter().chain([arm, mode]);
            let valid = all.clone().all(|channel| channel < 16);
            prop_assert_eq!(map.validate().is_ok(), valid);
            let frame = map.frame(&channels, LinkStatus::Good);
            if valid {
                let ticks: std::vec::Vec<u16> = all.map(|channel| channels[usize::from(channel)]).collect();
                prop_assert_eq!(&ticks[..4], &frame.channels[..]);
                prop_assert_eq!(&ticks[4..], &[frame.arm_switch, frame.mode_switch][..]);
            }
        }
    }

    #[test]
    fn sticks_at_ends_and_centre() {
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
    fn gesture_needs_sticks_beyond_its_limits() {
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
    fn aetr_selects_channels_and_switches() {
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
