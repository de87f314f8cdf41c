//! Whether the link to the pilot holds.

use crate::sample::{LinkStatus, RcFrame};

/// Age of the last frame at which the link counts as lost, µs: 25 frames of the slowest receivers (50 Hz).
pub const RC_LOST_US: u32 = 500_000;
/// How long frames must have come again before the link counts as back, µs. Noise on the receiver's port that
/// happens to look like a frame does not go on for so long.
pub const RC_BACK_US: u32 = 500_000;

/// The age of the last frame, and since when frames have come.
#[derive(Clone, Copy, Debug)]
pub struct Link {
    age_us: u32,
    good_us: u32,
}

impl Default for Link {
    /// Before the first frame: lost.
    fn default() -> Self {
        Self { age_us: u32::MAX, good_us: 0 }
    }
}

impl Link {
    /// Takes what arrived in a step that comes `dt_us` after the last. Returns the frame if its sticks are the
    /// pilot's: the link holds, and the frame is no repetition and no substitute.
    #[inline]
    pub fn take<'a>(&mut self, frame: Option<&'a RcFrame>, dt_us: u32) -> Option<&'a RcFrame> {
        self.age_us = self.age_us.saturating_add(dt_us);
        self.good_us = self.good_us.saturating_add(dt_us);
        let fresh = match frame {
            Some(frame) => match frame.status {
                LinkStatus::Good => Some(frame),
                // The receiver repeats the last frame that it got.
                LinkStatus::FrameLost => None,
                LinkStatus::Failsafe => {
                    *self = Self::default();
                    return None;
                }
            },
            None => None,
        };
        if self.age_us > RC_LOST_US {
            // What comes after a loss begins anew.
            self.good_us = 0;
        }
        if fresh.is_some() {
            self.age_us = 0;
        }
        fresh.filter(|_| !self.lost())
    }

    /// Whether the pilot is out of reach.
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
        /// From the times of the good frames alone: the link holds while there is no gap of more than half a second
        /// in them, from a frame half a second ago up to now.
        #[test]
        fn a_link_is_half_a_second_of_frames_without_a_gap(
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
            // The first and the last of the frames that hang together.
            let mut chain: Option<(u64, u64)> = None;
            for (status, dt_us) in past {
                now_us += u64::from(dt_us);
                let frame = status.map(|status| RcFrame { status, ..FRAME });
                let taken = link.take(frame.as_ref(), dt_us);
                if status == Some(LinkStatus::Failsafe) {
                    chain = None;
                }
                chain = chain.filter(|(_, last_us)| now_us - last_us <= 500_000);
                if status == Some(LinkStatus::Good) {
                    chain = Some((chain.map_or(now_us, |(first_us, _)| first_us), now_us));
                }
                let holds = chain.is_some_and(|(first_us, _)| now_us - first_us >= 500_000);
                prop_assert_eq!(link.lost(), !holds);
                prop_assert_eq!(taken, frame.as_ref().filter(|frame| holds && frame.status == LinkStatus::Good));
            }
        }
    }

    /// Runs milliseconds; a frame of this status every 20th, and none for `None`. Returns whether it is lost at the
    /// end, and how many frames were the pilot's.
    fn run(link: &mut Link, status: Option<LinkStatus>, ms: u32) -> (bool, u32) {
        let mut sticks = 0;
        for t in 0..ms {
            let frame = status.filter(|_| t % 20 == 0).map(|status| RcFrame { status, ..FRAME });
            sticks += u32::from(link.take(frame.as_ref(), 1_000).is_some());
        }
        (link.lost(), sticks)
    }

    #[test]
    fn a_link_holds_after_half_a_second_of_frames() {
        let mut link = Link::default();
        assert_eq!(run(&mut link, None, 2_000), (true, 0));
        assert_eq!(run(&mut link, Some(LinkStatus::Good), 500), (true, 0));
        assert_eq!(run(&mut link, Some(LinkStatus::Good), 500), (false, 25));
    }

    #[test]
    fn it_is_lost_half_a_second_after_the_last_frame_and_back_half_a_second_after_the_next() {
        for silence in [None, Some(LinkStatus::FrameLost)] {
            let mut link = Link::default();
            run(&mut link, Some(LinkStatus::Good), 1_001);
            // The last frame came in the last step.
            assert_eq!(run(&mut link, silence, 500), (false, 0));
            assert_eq!(run(&mut link, silence, 1), (true, 0));
            assert_eq!(run(&mut link, Some(LinkStatus::Good), 500), (true, 0));
            assert_eq!(run(&mut link, Some(LinkStatus::Good), 1), (false, 1));
        }
    }

    #[test]
    fn a_receiver_that_says_so_is_believed_at_once() {
        let mut link = Link::default();
        run(&mut link, Some(LinkStatus::Good), 1_000);
        assert_eq!(run(&mut link, Some(LinkStatus::Failsafe), 1), (true, 0));
        assert_eq!(run(&mut link, Some(LinkStatus::Good), 500), (true, 0));
        assert!(!run(&mut link, Some(LinkStatus::Good), 1).0);
    }

    #[test]
    fn single_frames_far_apart_never_make_a_link() {
        let mut link = Link::default();
        for _ in 0..100 {
            assert_eq!(run(&mut link, Some(LinkStatus::Good), 1), (true, 0));
            assert_eq!(run(&mut link, None, 501), (true, 0));
        }
    }
}
