//! From receiver ticks to what the pilot wants.
//!
//! | channel | low | centre | high |
//! |---|---|---|---|
//! | throttle | no thrust | half of the thrust | all of it |
//! | roll | left | level | right |
//! | pitch | back: nose up | level | forward: nose down |
//! | yaw | left: anticlockwise from above | hold heading | right: clockwise |

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
        let [throttle, roll, pitch, yaw] = frame.channels.map(|t| t.clamp(LOW_TICKS, HIGH_TICKS));
        // 172 is 820 ticks below the centre, 1811 is 819 above: full low stick reads −1, not −1.001.
        let centred = |ticks: u16| ((f32::from(ticks) - f32::from(CENTRE_TICKS)) / HALF_SPAN).max(-1.0);
        Self {
            throttle: (f32::from(throttle) - f32::from(LOW_TICKS)) / SPAN,
            roll: centred(roll),
            pitch: centred(pitch),
            yaw: centred(yaw),
        }
    }

    /// Whether the throttle is at its low end.
    pub fn throttle_low(&self) -> bool {
        self.throttle < 0.05
    }

    /// Whether the sticks ask to arm: throttle low, yaw full right.
    pub fn ask_to_arm(&self) -> bool {
        self.throttle_low() && self.yaw > 0.9
    }

    /// Whether the sticks ask to disarm: throttle low, yaw full left.
    pub fn ask_to_disarm(&self) -> bool {
        self.throttle_low() && self.yaw < -0.9
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ends_and_centre() {
        let low = Sticks::from_frame(&RcFrame { channels: [LOW_TICKS; 4] });
        assert_eq!(low, Sticks { throttle: 0.0, roll: -1.0, pitch: -1.0, yaw: -1.0 });
        assert!(low.ask_to_disarm() && !low.ask_to_arm());
        let high = Sticks::from_frame(&RcFrame { channels: [2047; 4] });
        assert_eq!(high, Sticks { throttle: 1.0, roll: 1.0, pitch: 1.0, yaw: 1.0 });
        assert!(!high.ask_to_arm() && !high.ask_to_disarm());
        let arm =
            Sticks::from_frame(&RcFrame { channels: [LOW_TICKS, CENTRE_TICKS, CENTRE_TICKS, HIGH_TICKS] });
        assert!(arm.ask_to_arm() && arm.roll == 0.0 && arm.pitch == 0.0);
    }
}
