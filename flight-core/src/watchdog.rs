//! Supervision of the tasks: decides whether the independent watchdog may be fed.
//!
//! A watchdog that one task feeds only shows that this task runs. Here every task that a flight needs reports to a
//! [`CheckIns`] at the end of each run and states whether it met its deadline. The task that feeds the watchdog
//! checks these reports first, and feeds it only if no task is late.
//!
//! ```text
//!  control  ─x─x─x─x─x─x─x─x─x─x─x─x─x─x─     x  checked in, deadline met
//!  receiver ───x───x───x───m───x───x───x─     m  checked in, deadline missed
//!  check    ────────F───────────r───────F     F  may feed    r  refused: the receiver is late
//! ```
//!
//! A task is late if its last check-in is older than allowed (the task hangs or gets no processor time), or if it has
//! missed a deadline since the last check, even though it has run again since (the task is overloaded). A single miss
//! costs one feed and is then cleared. The timeout of the watchdog must therefore be longer than two check intervals;
//! then only tasks that stay late, or miss deadlines repeatedly, reset the board.
//!
//! Times are `u64` microseconds, as in the rest of this crate. A `u32` would wrap every 71.6 minutes, and at each
//! wrap a task that stopped long ago would look recent for a moment.

use core::mem;

/// Result of a run of a task.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Deadline {
    /// The run ended in time.
    Met,
    /// The run ended too late.
    Missed,
}

/// The set of late tasks: bit n for task n.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LateTasks(u32);

impl LateTasks {
    /// Returns whether `task` is late.
    pub fn contains(self, task: usize) -> bool {
        u32::try_from(task).ok().and_then(|task| self.0.checked_shr(task)).is_some_and(|bits| bits & 1 == 1)
    }

    /// Returns the set as bits, bit n for task n.
    pub fn bits(self) -> u32 {
        self.0
    }
}

/// Check-ins of the periodic tasks (1 to 32), numbered from 0.
#[derive(Clone, Debug)]
pub struct CheckIns<const TASKS: usize> {
    allowed_age_us: [u64; TASKS],
    checked_in_us: [Option<u64>; TASKS],
    /// Tasks that have missed a deadline since the last check, bit n for task n.
    missed: u32,
    start_us: u64,
    grace_us: u64,
}

impl<const TASKS: usize> CheckIns<TASKS> {
    /// Creates the state in which no task has checked in yet.
    ///
    /// - `allowed_age_us`: for each task the largest allowed age of its last check-in, µs: its period plus the jitter
    ///   of its runs.
    /// - `grace_us`: each task must check in for the first time within this time after `start_us`, µs. After its first
    ///   check-in `allowed_age_us` applies.
    pub const fn new(allowed_age_us: [u64; TASKS], start_us: u64, grace_us: u64) -> Self {
        // Without tasks the watchdog could always be fed.
        const { assert!(TASKS >= 1 && TASKS <= 32) };
        Self { allowed_age_us, checked_in_us: [None; TASKS], missed: 0, start_us, grace_us }
    }

    /// Records the end of a run of `task` at `now_us` (µs). An unknown task number is ignored: the task that was
    /// meant becomes late.
    pub fn check_in(&mut self, task: usize, deadline: Deadline, now_us: u64) {
        let Some(checked_in_us) = self.checked_in_us.get_mut(task) else { return };
        *checked_in_us = Some(now_us);
        if deadline == Deadline::Missed {
            self.missed |= 1 << task;
        }
    }

    /// Checks all tasks and decides whether the watchdog may be fed at `now_us` (µs). Missed deadlines count until
    /// the next check.
    ///
    /// # Errors
    /// Returns the late tasks.
    pub fn may_feed(&mut self, now_us: u64) -> Result<(), LateTasks> {
        let mut late = mem::take(&mut self.missed);
        for (task, (checked_in_us, allowed_us)) in
            self.checked_in_us.iter().zip(self.allowed_age_us).enumerate()
        {
            // A task of higher priority may check in after the caller has read the clock: a check-in slightly in the
            // future is as recent as one slightly in the past. A check-in far in the future comes from a faulty
            // clock.
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
        /// This holds for any clock, also one that jumps: a task is late if its last check-in is older than allowed, or
        /// if it has missed a deadline since the last check.
        #[test]
        fn late_tasks_follow_from_the_history(
            times in prop::collection::vec((
                0..8_usize, any::<bool>(), any::<bool>(), prop_oneof![START_US..START_US + 1_000_000, any::<u64>()],
            ), 1..60),
        ) {
            let mut check_ins = CheckIns::new(ALLOWED_US, START_US, GRACE_US);
            let mut last: [Option<u64>; TASKS] = [None; TASKS];
            let mut missed = [false; TASKS];
            for (task, misses, checks, now_us) in times {
                if !checks {
                    check_ins.check_in(task, if misses { Missed } else { Met }, now_us);
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
                prop_assert_eq!(check_ins.may_feed(now_us), late(set));
                missed = [false; TASKS];
            }
        }
    }

    const TASKS: usize = 5;
    /// Periods of 1 to 100 ms, plus 10 %.
    const ALLOWED_US: [u64; TASKS] = [1_100, 4_400, 11_000, 22_000, 110_000];
    const GRACE_US: u64 = 500_000;
    const START_US: u64 = 3_000_000;

    /// Returns check-ins after the grace time, and the time at which all tasks have checked in.
    fn all_checked_in() -> (CheckIns<TASKS>, u64) {
        let mut check_ins = CheckIns::new(ALLOWED_US, START_US, GRACE_US);
        let now_us = START_US + 2 * GRACE_US;
        (0..TASKS).for_each(|task| check_ins.check_in(task, Met, now_us));
        (check_ins, now_us)
    }

    fn late(set: u32) -> Result<(), LateTasks> {
        if set == 0 { Ok(()) } else { Err(LateTasks(set)) }
    }

    #[test]
    fn any_missed_deadlines_refuse_one_feed() {
        for set in 0..1_u32 << TASKS {
            let (mut check_ins, now_us) = all_checked_in();
            for task in 0..TASKS {
                check_ins.check_in(task, if set >> task & 1 == 1 { Missed } else { Met }, now_us);
            }
            // A later run in time does not clear the miss before the next check.
            (0..TASKS).for_each(|task| check_ins.check_in(task, Met, now_us));
            let result = check_ins.may_feed(now_us);
            assert_eq!(result, late(set));
            for task in 0..40 {
                let named = result.err().is_some_and(|late| late.contains(task));
                assert_eq!(named, task < TASKS && set >> task & 1 == 1);
            }
            assert_eq!(result.map_or_else(LateTasks::bits, |()| 0), set);
            assert_eq!(check_ins.may_feed(now_us), Ok(()), "all tasks have met their deadlines since");
        }
    }

    #[test]
    #[cfg_attr(miri, ignore = "millions of microseconds")]
    fn any_silent_tasks_become_late() {
        for set in 0..1_u32 << TASKS {
            let (mut check_ins, mut now_us) = all_checked_in();
            // The other tasks continue for the longest allowed age plus one microsecond.
            for _ in 0..=ALLOWED_US[TASKS - 1] {
                now_us += 1;
                for task in (0..TASKS).filter(|task| set >> task & 1 == 0) {
                    check_ins.check_in(task, Met, now_us);
                }
                let silent = now_us - (START_US + 2 * GRACE_US);
                if ALLOWED_US.iter().any(|allowed| silent.abs_diff(*allowed) <= 1) {
                    let expected = (0..TASKS)
                        .filter(|task| silent > ALLOWED_US[*task])
                        .map(|task| set & 1 << task)
                        .sum();
                    assert_eq!(check_ins.may_feed(now_us), late(expected), "after {silent} µs");
                }
            }
            assert_eq!(check_ins.may_feed(now_us), late(set));
            // A task that checks in again is no longer late.
            (0..TASKS).for_each(|task| check_ins.check_in(task, Met, now_us));
            assert_eq!(check_ins.may_feed(now_us), Ok(()));
        }
    }

    #[test]
    fn tasks_that_never_start_are_late_after_grace() {
        for set in 0..1_u32 << TASKS {
            let mut check_ins = CheckIns::new(ALLOWED_US, START_US, GRACE_US);
            assert_eq!(check_ins.may_feed(START_US + GRACE_US), Ok(()), "the grace time has not passed");
            let now_us = START_US + GRACE_US + 1;
            (0..TASKS)
                .filter(|task| set >> task & 1 == 0)
                .for_each(|task| check_ins.check_in(task, Met, now_us));
            assert_eq!(check_ins.may_feed(now_us), late(set));
        }
        // The grace time ends with the first check-in.
        let mut check_ins = CheckIns::new(ALLOWED_US, START_US, GRACE_US);
        check_ins.check_in(0, Met, START_US);
        assert_eq!(check_ins.may_feed(START_US + ALLOWED_US[0]), Ok(()));
        assert_eq!(check_ins.may_feed(START_US + ALLOWED_US[0] + 1), late(1));
    }

    #[test]
    fn each_check_after_a_miss_refuses_one_feed() {
        for (misses, expected) in [(1..2, 1), (0..100, 100)] {
            let (mut check_ins, mut now_us) = all_checked_in();
            let mut refused = 0;
            for check in 0..100 {
                for run in 0..10 {
                    now_us += 1_000;
                    check_ins.check_in(
                        0,
                        if run == 4 && misses.contains(&check) { Missed } else { Met },
                        now_us,
                    );
                    (1..TASKS).for_each(|task| check_ins.check_in(task, Met, now_us));
                }
                refused += u32::from(check_ins.may_feed(now_us) == late(1));
            }
            assert_eq!(refused, expected);
        }
    }

    #[test]
    fn wrap_of_u32_microseconds_has_no_effect() {
        let (mut check_ins, start_us) = all_checked_in();
        let wrap_us = start_us + (1 << 32);
        // No task checks in any more; at the wrap a u32 would show an age of 0.
        for now_us in [wrap_us - 1, wrap_us, wrap_us + 1, wrap_us + 1_000] {
            assert_eq!(check_ins.may_feed(now_us), late((1 << TASKS) - 1));
        }
        for now_us in (wrap_us - 5_000..wrap_us + 5_000).step_by(1_000) {
            (0..TASKS).for_each(|task| check_ins.check_in(task, Met, now_us));
            assert_eq!(check_ins.may_feed(now_us + 1_000), Ok(()));
        }
        let end_us = u64::MAX - 500;
        (0..TASKS).for_each(|task| check_ins.check_in(task, Met, end_us));
        assert_eq!(check_ins.may_feed(u64::MAX), Ok(()));
    }

    #[test]
    fn slightly_future_check_in_counts_far_future_not() {
        let (mut check_ins, now_us) = all_checked_in();
        check_ins.check_in(0, Met, now_us + 3);
        assert_eq!(check_ins.may_feed(now_us), Ok(()));
        (0..TASKS).for_each(|task| check_ins.check_in(task, Met, now_us + 10_000_000));
        assert_eq!(check_ins.may_feed(now_us), late((1 << TASKS) - 1));
    }

    #[test]
    fn unknown_task_numbers_are_ignored() {
        let (mut check_ins, now_us) = all_checked_in();
        for task in [TASKS, 32, 64, usize::MAX] {
            check_ins.check_in(task, Missed, now_us);
        }
        assert_eq!(check_ins.may_feed(now_us), Ok(()));
        let mut full = CheckIns::new([1; 32], 0, 0);
        (0..31).for_each(|task| full.check_in(task, Met, 10));
        assert_eq!(full.may_feed(10), late(1 << 31));
    }
}
