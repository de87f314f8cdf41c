//! Whether the independent watchdog may be fed.
//!
//! A watchdog that any task feeds only shows that this task runs. Here every task that a flight needs is on a [`CheckIns`]
//! and checks in at the end of each of its runs, saying whether it met its deadline; whoever feeds the
//! watchdog looks at the roll first, and feeds it only if nobody is late.
//!
//! ```text
//!  flight   ─x─x─x─x─x─x─x─x─x─x─x─x─x─x─     x  checked in, deadline met
//!  receiver ───x───x───x───m───x───x───x─     m  checked in, deadline missed
//!  look     ────────F───────────r───────F     F  may feed    r  refused: the receiver is late
//! ```
//!
//! A task is late if its last check-in is older than it is allowed to be (it hangs, or is starved), or if it
//! has missed a deadline since the last look, even though it ran again since (it is overloaded). A single miss
//! costs one feed, and is then forgotten: the watchdog's timeout must hold two looks and more, and then only
//! tasks that stay late, or miss again and again, reset the board.
//!
//! Times are the `u64` microseconds of the rest of this crate. A `u32` would wrap every 71.6 minutes, and make
//! a task that died long ago look fresh for a moment at each wrap.

use core::mem;

/// How a task's run ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Deadline {
    /// In time.
    Met,
    /// Too late.
    Missed,
}

/// The late tasks: bit n for task n.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LateTasks(u32);

impl LateTasks {
    /// Whether `task` is one of them.
    pub fn contains(self, task: usize) -> bool {
        u32::try_from(task).ok().and_then(|task| self.0.checked_shr(task)).is_some_and(|bits| bits & 1 == 1)
    }

    /// Bit n for task n.
    pub fn bits(self) -> u32 {
        self.0
    }
}

/// The periodic tasks (up to 32), numbered from 0.
#[derive(Clone, Debug)]
pub struct CheckIns<const TASKS: usize> {
    allowed_age_us: [u64; TASKS],
    checked_in_us: [Option<u64>; TASKS],
    /// Which have missed a deadline since the last look.
    missed: u32,
    start_us: u64,
    grace_us: u64,
}

impl<const TASKS: usize> CheckIns<TASKS> {
    /// A roll on which nobody has checked in yet.
    ///
    /// - `allowed_age_us`: for each task the age of its last check-in above which it is late: its period, and
    ///   the jitter of its run.
    /// - `grace_us`: how long after `start_us` a task may take to its first check-in; from then on
    ///   `allowed_age_us` holds for it.
    pub const fn new(allowed_age_us: [u64; TASKS], start_us: u64, grace_us: u64) -> Self {
        // An empty roll would always let the watchdog be fed.
        const { assert!(TASKS >= 1 && TASKS <= 32) };
        Self { allowed_age_us, checked_in_us: [None; TASKS], missed: 0, start_us, grace_us }
    }

    /// `task` ends a run. A task that is not on the roll is ignored: the one that was meant becomes late.
    pub fn check_in(&mut self, task: usize, deadline: Deadline, now_us: u64) {
        let Some(checked_in_us) = self.checked_in_us.get_mut(task) else { return };
        *checked_in_us = Some(now_us);
        if deadline == Deadline::Missed {
            self.missed |= 1 << task;
        }
    }

    /// Looks at the roll: whether the watchdog may be fed now. Missed deadlines count until the next look.
    ///
    /// # Errors
    /// Who is late.
    pub fn may_feed(&mut self, now_us: u64) -> Result<(), LateTasks> {
        let mut late = mem::take(&mut self.missed);
        for (task, (checked_in_us, allowed_us)) in
            self.checked_in_us.iter().zip(self.allowed_age_us).enumerate()
        {
            // A task of higher priority may check in between the look's reading of the clock and this line: a
            // check-in from the near future is as fresh as one from the near past. One from the far future
            // comes from a broken clock.
            let overdue = match checked_in_us {
                Some(at_us) => now_us.abs_diff(*at_us) > allowed_us,
                None => now_us.saturating_sub(self.start_us) > self.grace_us,
            };
            late |= u32::from(overdue) << task;
        }
        if late == 0 { Ok(()) } else { Err(LateTasks(late)) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use Deadline::{Met, Missed};
    use proptest::prelude::*;

    proptest! {
        /// Any clock, also one that jumps: a look finds late who has not been heard of for as long as it may be
        /// silent, or has missed a deadline since the last look.
        #[test]
        fn a_look_at_any_time(
            times in prop::collection::vec((
                0..8_usize, any::<bool>(), any::<bool>(), prop_oneof![START_US..START_US + 1_000_000, any::<u64>()],
            ), 1..60),
        ) {
            let mut roll = CheckIns::new(ALLOWED_US, START_US, GRACE_US);
            let mut last: [Option<u64>; TASKS] = [None; TASKS];
            let mut missed = [false; TASKS];
            for (task, misses, looks, now_us) in times {
                if !looks {
                    roll.check_in(task, if misses { Missed } else { Met }, now_us);
                    if task < TASKS {
                        last[task] = Some(now_us);
                        missed[task] |= misses;
                    }
                    continue;
                }
                let now = i128::from(now_us);
                let is_late = |task: usize| missed[task] || match last[task] {
                    Some(at_us) => (now - i128::from(at_us)).abs() > i128::from(ALLOWED_US[task]),
                    None => now > i128::from(START_US + GRACE_US),
                };
                let set: u32 = (0..TASKS).filter(|task| is_late(*task)).map(|task| 1 << task).sum();
                prop_assert_eq!(roll.may_feed(now_us), late(set));
                missed = [false; TASKS];
            }
        }
    }

    const TASKS: usize = 5;
    /// Periods of 1 to 100 ms, and a tenth on top.
    const ALLOWED_US: [u64; TASKS] = [1_100, 4_400, 11_000, 22_000, 110_000];
    const GRACE_US: u64 = 500_000;
    const START_US: u64 = 3_000_000;

    /// A roll after its grace, on which everybody has checked in at the time that comes with it.
    fn all_present() -> (CheckIns<TASKS>, u64) {
        let mut roll = CheckIns::new(ALLOWED_US, START_US, GRACE_US);
        let now_us = START_US + 2 * GRACE_US;
        (0..TASKS).for_each(|task| roll.check_in(task, Met, now_us));
        (roll, now_us)
    }

    fn late(set: u32) -> Result<(), LateTasks> {
        if set == 0 { Ok(()) } else { Err(LateTasks(set)) }
    }

    #[test]
    fn every_combination_of_missed_deadlines() {
        for set in 0..1_u32 << TASKS {
            let (mut roll, now_us) = all_present();
            for task in 0..TASKS {
                roll.check_in(task, if set >> task & 1 == 1 { Missed } else { Met }, now_us);
            }
            // A run in time afterwards does not make up for it within the same look.
            (0..TASKS).for_each(|task| roll.check_in(task, Met, now_us));
            let answer = roll.may_feed(now_us);
            assert_eq!(answer, late(set));
            for task in 0..40 {
                let named = answer.err().is_some_and(|late| late.contains(task));
                assert_eq!(named, task < TASKS && set >> task & 1 == 1);
            }
            assert_eq!(answer.map_or_else(LateTasks::bits, |()| 0), set);
            assert_eq!(roll.may_feed(now_us), Ok(()), "all have met their deadlines since");
        }
    }

    #[test]
    #[cfg_attr(miri, ignore = "millions of microseconds")]
    fn every_combination_of_silent_tasks() {
        for set in 0..1_u32 << TASKS {
            let (mut roll, mut now_us) = all_present();
            // The others go on for as long as the slowest may be silent, and one microsecond.
            for _ in 0..=ALLOWED_US[TASKS - 1] {
                now_us += 1;
                for task in (0..TASKS).filter(|task| set >> task & 1 == 0) {
                    roll.check_in(task, Met, now_us);
                }
                let silent = now_us - (START_US + 2 * GRACE_US);
                if ALLOWED_US.iter().any(|allowed| silent.abs_diff(*allowed) <= 1) {
                    let expected = (0..TASKS)
                        .filter(|task| silent > ALLOWED_US[*task])
                        .map(|task| set & 1 << task)
                        .sum();
                    assert_eq!(roll.may_feed(now_us), late(expected), "after {silent} µs");
                }
            }
            assert_eq!(roll.may_feed(now_us), late(set));
            // A task that comes back is welcome.
            (0..TASKS).for_each(|task| roll.check_in(task, Met, now_us));
            assert_eq!(roll.may_feed(now_us), Ok(()));
        }
    }

    #[test]
    fn every_combination_of_tasks_that_never_start() {
        for set in 0..1_u32 << TASKS {
            let mut roll = CheckIns::new(ALLOWED_US, START_US, GRACE_US);
            assert_eq!(roll.may_feed(START_US + GRACE_US), Ok(()), "nobody need have started yet");
            let now_us = START_US + GRACE_US + 1;
            (0..TASKS).filter(|task| set >> task & 1 == 0).for_each(|task| roll.check_in(task, Met, now_us));
            assert_eq!(roll.may_feed(now_us), late(set));
        }
        // Who has started is no longer graced.
        let mut roll = CheckIns::new(ALLOWED_US, START_US, GRACE_US);
        roll.check_in(0, Met, START_US);
        assert_eq!(roll.may_feed(START_US + ALLOWED_US[0]), Ok(()));
        assert_eq!(roll.may_feed(START_US + ALLOWED_US[0] + 1), late(1));
    }

    #[test]
    fn a_miss_costs_one_feed_and_a_miss_before_each_look_costs_all() {
        for (misses, expected) in [(1..2, 1), (0..100, 100)] {
            let (mut roll, mut now_us) = all_present();
            let mut refused = 0;
            for look in 0..100 {
                for run in 0..10 {
                    now_us += 1_000;
                    roll.check_in(0, if run == 4 && misses.contains(&look) { Missed } else { Met }, now_us);
                    (1..TASKS).for_each(|task| roll.check_in(task, Met, now_us));
                }
                refused += u32::from(roll.may_feed(now_us) == late(1));
            }
            assert_eq!(refused, expected);
        }
    }

    #[test]
    fn where_a_u32_of_microseconds_would_wrap_nothing_happens() {
        let (mut roll, start_us) = all_present();
        let wrap_us = start_us + (1 << 32);
        // Everybody is gone; at the wrap a u32 would show an age of 0.
        for now_us in [wrap_us - 1, wrap_us, wrap_us + 1, wrap_us + 1_000] {
            assert_eq!(roll.may_feed(now_us), late((1 << TASKS) - 1));
        }
        for now_us in (wrap_us - 5_000..wrap_us + 5_000).step_by(1_000) {
            (0..TASKS).for_each(|task| roll.check_in(task, Met, now_us));
            assert_eq!(roll.may_feed(now_us + 1_000), Ok(()));
        }
        let end_us = u64::MAX - 500;
        (0..TASKS).for_each(|task| roll.check_in(task, Met, end_us));
        assert_eq!(roll.may_feed(u64::MAX), Ok(()));
    }

    #[test]
    fn a_check_in_just_after_the_clock_was_read_is_fresh_and_a_clock_that_jumps_is_not() {
        let (mut roll, now_us) = all_present();
        roll.check_in(0, Met, now_us + 3);
        assert_eq!(roll.may_feed(now_us), Ok(()));
        (0..TASKS).for_each(|task| roll.check_in(task, Met, now_us + 10_000_000));
        assert_eq!(roll.may_feed(now_us), late((1 << TASKS) - 1));
    }

    #[test]
    fn who_is_not_on_the_roll_is_ignored() {
        let (mut roll, now_us) = all_present();
        for task in [TASKS, 32, 64, usize::MAX] {
            roll.check_in(task, Missed, now_us);
        }
        assert_eq!(roll.may_feed(now_us), Ok(()));
        let mut full = CheckIns::new([1; 32], 0, 0);
        (0..31).for_each(|task| full.check_in(task, Met, 10));
        assert_eq!(full.may_feed(10), late(1 << 31));
    }
}
