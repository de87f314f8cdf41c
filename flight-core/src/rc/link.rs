//! Detection of link loss between pilot and vehicle.

use crate::sample::{LinkStatus, RcFrame};

/// The link counts as lost if its last frame is older than this, µs: 25 frames of the slowest receivers (50 Hz).
pub const RC_LOST_US: u32 = 500_000;
/// Time for which frames must have arrived again before the link counts as restored, µs. Noise on the receiver's port
/// that looks like a frame does not last that long.
pub const RC_BACK_US: u32 = 500_000;

/// The age of the last frame, and the time for which frames have arrived without a gap.
#[derive(Clone, Copy, Debug)]
pub struct Link {
    age_us: u32,
    good_us: u32,
}

impl Default for Link {
    /// The state before the first frame: lost.
    fn default() -> Self {
        Self { age_us: u32::MAX, good_us: 0 }
    }
}

impl Link {
    /// Updates the link with the frame of a step, if there is one; the step comes `dt_us` (µs) after the last one.
    /// Returns the frame if its sticks are valid: the link is not lost, and the frame is neither a repetition nor a
    /// substitute.
    #[inline]
    pub fn update<'a>(&mut self, frame: Option<&'a RcFrame>, dt_us: u32) -> Option<&'a RcFrame> {
        self.age_us = self.age_us.saturating_add(dt_us);
        self.good_us = self.good_us.saturating_add(dt_us);
        let fresh = match frame {
            Some(frame) => match frame.status {
                LinkStatus::Good => Some(frame),
                // The receiver repeats the last frame that it received.
                LinkStatus::FrameLost => None,
                LinkStatus::Failsafe => {
                    *self = Self::default();
                    return None;
                }
            },
            None => None,
        };
        if self.age_us > RC_LOST_US {
            // After a loss the time without a gap starts at 0.
            self.good_us = 0;
        }
        if fresh.is_some() {
            self.age_us = 0;
        }
        fresh.filter(|_| !self.lost())
    }

    /// Returns whether the link is lost.
    #[inline(always)]
    pub fn lost(&self) -> bool {
        self.age_us > RC_LOST_US || self.good_us < RC_BACK_US
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rc::CENTRE_TICKS;
    use crate::sample::LinkStatus::Good;
    use proptest::prelude::*;

    const FRAME: RcFrame = RcFrame {
        channels: [CENTRE_TICKS; 4],
        arm_switch: CENTRE_TICKS,
        mode_switch: CENTRE_TICKS,
        status: LinkStatus::Good,
    };

    proptest! {
        /// The test computes the state of the link from the times of the good frames alone. The link holds if good
        /// frames, at most 0.5 s apart, reach from 0.5 s ago up to now.
        #[test]
        fn link_holds_after_half_a_second_without_a_gap(
            past in prop::collection::vec((
                prop::option::weighted(0.6, prop::sample::select(
                    &[Good, Good, Good, Good, LinkStatus::FrameLost, LinkStatus::Failsafe][..],
                )),
                prop_oneof![6 => 0..100_000_u32, 2 => Just(250_000), 1 => Just(500_000), 1 => Just(500_001), 1 => Just(u32::MAX)],
            ), 1..80),
        ) {
            let mut link = Link::default();
            prop_assert!(link.lost());
            let mut now_us = 0_u64;
            // Times of the first and the last frame of the sequence without a gap.
            let mut sequence: Option<(u64, u64)> = None;
            for (status, dt_us) in past {
                now_us += u64::from(dt_us);
                let frame = status.map(|status| RcFrame { status, ..FRAME });
                let valid = link.update(frame.as_ref(), dt_us);
                if status == Some(LinkStatus::Failsafe) {
                    sequence = None;
                }
                sequence = sequence.filter(|(_, last_us)| now_us - last_us <= 500_000);
                if status == Some(LinkStatus::Good) {
                    sequence = Some((sequence.map_or(now_us, |(first_us, _)| first_us), now_us));
                }
                let holds = sequence.is_some_and(|(first_us, _)| now_us - first_us >= 500_000);
                prop_assert_eq!(link.lost(), !holds);
                prop_assert_eq!(valid, frame.as_ref().filter(|frame| holds && frame.status == LinkStatus::Good));
            }
        }
    }

    /// Runs `ms` steps of a millisecond, with a frame of this status in every 20th one; `None` sends no frames.
    /// Returns whether the link is lost at the end, and the number of frames with valid sticks.
    fn run(link: &mut Link, status: Option<LinkStatus>, ms: u32) -> (bool, u32) {
        let mut valid = 0;
        for t in 0..ms {
            let frame = status.filter(|_| t % 20 == 0).map(|status| RcFrame { status, ..FRAME });
            valid += u32::from(link.update(frame.as_ref(), 1_000).is_some());
        }
        (link.lost(), valid)
    }

    #[test]
    fn link_holds_after_half_a_second_of_frames() {
        let mut link = Link::default();
        assert_eq!(run(&mut link, None, 2_000), (true, 0));
        assert_eq!(run(&mut link, Some(LinkStatus::Good), 500), (true, 0));
        assert_eq!(run(&mut link, Some(LinkStatus::Good), 500), (false, 25));
    }

    #[test]
    fn link_is_lost_and_restored_after_half_a_second() {
        for silence in [None, Some(LinkStatus::FrameLost)] {
            let mut link = Link::default();
            run(&mut link, Some(LinkStatus::Good), 1_001);
            // The last frame arrived in the last step.
            assert_eq!(run(&mut link, silence, 500), (false, 0));
            assert_eq!(run(&mut link, silence, 1), (true, 0));
            assert_eq!(run(&mut link, Some(LinkStatus::Good), 500), (true, 0));
            assert_eq!(run(&mut link, Some(LinkStatus::Good), 1), (false, 1));
        }
    }

    #[test]
    fn reported_failsafe_loses_the_link_at_once() {
        let mut link = Link::default();
        run(&mut link, Some(LinkStatus::Good), 1_000);
        assert_eq!(run(&mut link, Some(LinkStatus::Failsafe), 1), (true, 0));
        assert_eq!(run(&mut link, Some(LinkStatus::Good), 500), (true, 0));
        assert!(!run(&mut link, Some(LinkStatus::Good), 1).0);
    }

    #[test]
    fn single_frames_never_restore_the_link() {
        let mut link = Link::default();
        for _ in 0..100 {
            assert_eq!(run(&mut link, Some(LinkStatus::Good), 1), (true, 0));
            assert_eq!(run(&mut link, None, 501), (true, 0));
        }
    }
}
