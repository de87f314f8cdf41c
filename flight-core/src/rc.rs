//! From receiver ticks to what the pilot wants.
//!
//! | channel | low | centre | high |
//! |---|---|---|---|
//! | throttle | no thrust | half of the thrust | all of it |
//! | roll | left | level | right |
//! | pitch | back: nose up | level | forward: nose down |
//! | yaw | left: anticlockwise from above | hold heading | right: clockwise |

use crate::arithmetic::max;
use crate::sample::RcFrame;

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

    /// What the sticks ask for by where they are held.
    pub fn gesture(&self) -> Gesture {
        if self.throttle >= LOW_THROTTLE {
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

    #[test]
    fn ends_and_centre() {
        let low = Sticks::from_frame(&RcFrame { channels: [LOW_TICKS; 4] });
        assert_eq!(low, Sticks { throttle: 0.0, roll: -1.0, pitch: -1.0, yaw: -1.0 });
        assert_eq!(low.gesture(), Gesture::Disarm);
        let high = Sticks::from_frame(&RcFrame { channels: [2047; 4] });
        assert_eq!(high, Sticks { throttle: 1.0, roll: 1.0, pitch: 1.0, yaw: 1.0 });
        assert_eq!(high.gesture(), Gesture::None);
        let arm =
            Sticks::from_frame(&RcFrame { channels: [LOW_TICKS, CENTRE_TICKS, CENTRE_TICKS, HIGH_TICKS] });
        assert_eq!((arm.gesture(), arm.roll, arm.pitch), (Gesture::Arm, 0.0, 0.0));
    }
}
