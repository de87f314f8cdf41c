use std::vec::Vec;

use proptest::num::f32::ANY;
use proptest::prelude::*;

use super::table::{Conditions, Row, decide, rows};
use super::{ArmState, Arming, BenchMotor, Cause, Event};
use ArmState::*;
use Conditions as C;

/// What stands against arming, in the order in which it is told.
const OBSTACLES: [(C, Cause); 11] = [
    (C::BENCH_LOCK, Cause::BenchLock),
    (C::BENCH_COMMAND, Cause::BenchCommand),
    (C::RC_LOST, Cause::RcLost),
    (C::THROTTLE_UP, Cause::ThrottleUp),
    (C::IMU_LOST, Cause::ImuLost),
    (C::IMU_STUCK, Cause::ImuStuck),
    (C::NO_CALIBRATION, Cause::NoCalibration),
    (C::NOT_STILL, Cause::NotStill),
    (C::NOT_LEVEL, Cause::NotLevel),
    (C::BATTERY_LOW, Cause::BatteryLow),
    (C::OVERLOAD, Cause::Overload),
];

/// What should happen, written down a second time and in another way: as a person would say it.
fn promised(state: ArmState, now: C) -> Option<(ArmState, Cause)> {
    let is = |condition: C| now.contains(condition);
    let obstacle = || OBSTACLES.iter().find(|(condition, _)| is(*condition)).map(|&(_, cause)| cause);
    let fault = || {
        let faults = [
            (C::BENCH_LOCK, Cause::BenchLock),
            (C::IMU_LOST, Cause::ImuLost),
            (C::IMU_STUCK, Cause::ImuStuck),
            (C::TILT_LIMIT, Cause::TiltLimit),
        ];
        faults.into_iter().find(|(condition, _)| is(*condition)).map(|(_, cause)| (Terminated, cause))
    };
    let heard = |request| is(request) && !is(C::RC_LOST);
    match state {
        Disarmed => {
            if is(C::WATCHDOG_RESET) {
                return Some((Terminated, Cause::WatchdogReset));
            }
            if is(C::MAINTENANCE) {
                return Some((Maintenance, Cause::Maintenance));
            }
            if is(C::ARM) {
                return Some(obstacle().map_or((Arming, Cause::Pilot), |cause| (Disarmed, cause)));
            }
            (is(C::BENCH_COMMAND) && !is(C::BENCH_EXPIRED) && !is(C::DISARM))
                .then_some((Bench, Cause::BenchCommand))
        }
        Arming => {
            if is(C::MAINTENANCE) {
                return Some((Disarmed, Cause::Maintenance));
            }
            if let Some(cause) = obstacle() {
                return Some((Disarmed, cause));
            }
            if is(C::DISARM) {
                return Some((Disarmed, Cause::Pilot));
            }
            is(C::TIME_UP).then_some((Armed, Cause::Checked))
        }
        Armed => {
            if let Some(stop) = fault() {
                return Some(stop);
            }
            if is(C::RC_LOST) {
                let to = if is(C::THROTTLE_UP) { Descent } else { Terminated };
                return Some((to, Cause::RcLost));
            }
            if is(C::DISARM) {
                return Some((Disarmed, Cause::Pilot));
            }
            is(C::BATTERY_CRITICAL).then_some((Descent, Cause::BatteryCritical))
        }
        Descent => {
            if let Some(stop) = fault() {
                return Some(stop);
            }
            if is(C::RC_LOST) {
                return is(C::TIME_UP).then_some((Terminated, Cause::DescentOver));
            }
            if is(C::DISARM) {
                return Some((Disarmed, Cause::Pilot));
            }
            (!is(C::BATTERY_CRITICAL)).then_some((Armed, Cause::RcBack))
        }
        Terminated => {
            if heard(C::DISARM) {
                return Some((Disarmed, Cause::Pilot));
            }
            is(C::ARM).then_some((Terminated, Cause::NotAcknowledged))
        }
        Bench => {
            if is(C::MAINTENANCE) {
                Some((Disarmed, Cause::Maintenance))
            } else if is(C::DISARM) {
                Some((Disarmed, Cause::Pilot))
            } else if is(C::ARM) {
                Some((Disarmed, Cause::BenchCommand))
            } else if is(C::BENCH_EXPIRED) {
                Some((Disarmed, Cause::BenchExpired))
            } else if !is(C::BENCH_COMMAND) {
                Some((Disarmed, Cause::BenchSilent))
            } else {
                None
            }
        }
        Maintenance => {
            if !is(C::MAINTENANCE) {
                Some((Disarmed, Cause::MaintenanceOver))
            } else {
                is(C::ARM).then_some((Maintenance, Cause::Maintenance))
            }
        }
    }
}

fn every_combination() -> impl Iterator<Item = C> {
    (0..=C::all().bits()).map(C::from_bits_retain)
}

fn followed(rows: &[Row], now: C) -> Option<(ArmState, Cause)> {
    decide(rows, now).map(|row| (row.to, row.cause))
}

#[test]
#[cfg_attr(miri, ignore = "2^19 combinations of each state")]
fn every_state_under_every_combination_of_conditions_does_what_is_promised() {
    assert_eq!(C::all().bits(), (1 << 19) - 1);
    for state in ArmState::ALL {
        for now in every_combination() {
            assert_eq!(followed(rows(state), now), promised(state, now), "{state:?} {now:?}");
        }
    }
}

#[test]
#[cfg_attr(miri, ignore = "2^19 combinations of each state")]
fn no_row_can_be_left_out() {
    for state in ArmState::ALL {
        for index in 0..rows(state).len() {
            let mut without = rows(state).to_vec();
            let row = without.remove(index);
            let noticed = every_combination().any(|now| followed(&without, now) != promised(state, now));
            assert!(noticed, "nobody misses {row:?}");
        }
    }
}

#[test]
fn in_flight_nothing_else_is_looked_at() {
    for row in rows(Armed).iter().chain(rows(Descent)) {
        assert!(C::IN_FLIGHT.contains(row.when | row.unless), "{row:?}");
    }
}

#[test]
fn every_row_stands_with_its_state_and_asks_for_no_condition_that_it_excludes() {
    for state in ArmState::ALL {
        assert!(rows(state).iter().all(|row| row.from == state && !row.when.intersects(row.unless)));
    }
}

/// Properties that hold whatever the rows say, so that a mistake made in both versions above is found.
#[test]
#[cfg_attr(miri, ignore = "2^19 combinations of each state")]
fn what_must_never_happen_does_not() {
    for state in ArmState::ALL {
        for now in every_combination() {
            let to = followed(rows(state), now).map_or(state, |(to, _)| to);
            let turning = |s: ArmState| s.flies() || s == Bench;
            if turning(to) && !turning(state) {
                // From rest the motors start by a checked arming or a bench command, and by nothing else.
                match to {
                    Armed => {
                        assert_eq!(state, Arming);
                        assert!(OBSTACLES.iter().all(|(obstacle, _)| !now.contains(*obstacle)));
                    }
                    Bench => assert!(state == Disarmed && now.contains(C::BENCH_COMMAND)),
                    other => panic!("{state:?} to {other:?}"),
                }
            }
            if to.flies() {
                assert!(!now.intersects(C::BENCH_LOCK | C::IMU_LOST | C::IMU_STUCK), "{state:?} {now:?}");
                // Who does not fly yet cannot have failed to follow.
                assert!(!(state.flies() && now.contains(C::TILT_LIMIT)), "{state:?} {now:?}");
            }
            if to == Maintenance {
                assert!(!turning(state) && state != Arming);
            }
            // The pilot, if heard, can always stop the motors.
            if now.contains(C::DISARM) && !now.contains(C::RC_LOST) {
                assert!(!turning(to), "{state:?} {now:?}");
            }
        }
    }
}

/// Drives an [`Arming`] for milliseconds.
fn run(arming: &mut Arming, now: C, ms: u32) -> Vec<Event> {
    (0..ms).filter_map(|_| arming.update(now, 1_000)).collect()
}

fn event(from: ArmState, to: ArmState, cause: Cause) -> Event {
    Event { from, to, cause }
}

fn armed() -> Arming {
    let mut arming = super::Arming::new(5_000_000);
    run(&mut arming, C::empty(), 1);
    assert_eq!(run(&mut arming, C::ARM, 500), [event(Disarmed, Arming, Cause::Pilot)]);
    assert!(arming.permit(|| None).is_none());
    assert_eq!(run(&mut arming, C::ARM, 1), [event(Arming, Armed, Cause::Checked)]);
    assert!(arming.permit(|| None).is_some());
    arming
}

#[test]
#[cfg_attr(miri, ignore = "6,000 steps")]
fn a_refusal_is_said_once_and_the_pilot_must_let_go_before_the_next_try() {
    let mut arming = super::Arming::new(1);
    run(&mut arming, C::empty(), 1);
    assert_eq!(run(&mut arming, C::ARM | C::NOT_LEVEL, 3_000), [event(Disarmed, Disarmed, Cause::NotLevel)]);
    assert!(run(&mut arming, C::ARM, 3_000).is_empty(), "level by now, but the request is old");
    run(&mut arming, C::empty(), 1);
    assert_eq!(run(&mut arming, C::ARM, 1), [event(Disarmed, Arming, Cause::Pilot)]);
}

#[test]
#[cfg_attr(miri, ignore = "10,000 steps")]
fn what_is_asked_from_the_start_is_no_request() {
    let mut arming = super::Arming::new(1);
    assert!(run(&mut arming, C::ARM, 10_000).is_empty());
}

#[test]
#[cfg_attr(miri, ignore = "1,400 steps of each obstacle")]
fn an_obstacle_that_comes_up_while_arming_takes_it_back() {
    for (obstacle, cause) in OBSTACLES {
        let mut arming = super::Arming::new(1);
        run(&mut arming, C::empty(), 1);
        run(&mut arming, C::ARM, 400);
        let told = run(&mut arming, C::ARM | obstacle, 1_000);
        assert_eq!(told[0], event(Arming, Disarmed, cause));
        assert!(told[1..].iter().all(|event| event.to == Bench), "{told:?}");
        assert!(told[0].is_refusal());
    }
}

#[test]
#[cfg_attr(miri, ignore = "8,000 steps")]
fn a_descent_without_a_link_ends_after_its_time_and_with_one_in_the_pilots_hands() {
    let lost = C::RC_LOST | C::THROTTLE_UP;
    let mut arming = armed();
    assert_eq!(run(&mut arming, lost, 5_000), [event(Armed, Descent, Cause::RcLost)]);
    assert!(arming.permit(|| None).is_some());
    assert_eq!(run(&mut arming, lost, 1), [event(Descent, Terminated, Cause::DescentOver)]);
    assert!(arming.permit(|| None).is_none());
    assert_eq!(run(&mut arming, C::ARM, 1), [event(Terminated, Terminated, Cause::NotAcknowledged)]);
    assert_eq!(run(&mut arming, C::DISARM, 1), [event(Terminated, Disarmed, Cause::Pilot)]);

    let mut arming = armed();
    run(&mut arming, lost, 1_000);
    assert_eq!(run(&mut arming, C::THROTTLE_UP, 1), [event(Descent, Armed, Cause::RcBack)]);
}

#[test]
fn the_permit_of_the_bench_turns_one_motor_up_to_its_limit() {
    let mut arming = super::Arming::new(1);
    run(&mut arming, C::BENCH_COMMAND, 1);
    assert_eq!(arming.state(), Bench);
    let motor = BenchMotor { rotor: 2, limit_us: 1_300.0 };
    let permit = arming.permit(|| Some(motor)).unwrap();
    assert_eq!(permit.apply([1_900.0; 4], 1_000.0), [1_000.0, 1_000.0, 1_300.0, 1_000.0]);
    let permit = arming.permit(|| Some(motor)).unwrap();
    assert_eq!(permit.apply([1_200.0; 4], 1_000.0), [1_000.0, 1_000.0, 1_200.0, 1_000.0]);
    assert!(arming.permit(|| None).is_none());
    // In flight the bench's motor means nothing.
    let permit = armed().permit(|| Some(motor)).unwrap();
    assert_eq!(permit.apply([1_900.0; 4], 1_000.0), [1_900.0; 4]);
}

/// Conditions that come and go, few of them at a time.
fn moments() -> impl Strategy<Value = Vec<(C, u32, usize)>> {
    let few = || (any::<u32>(), any::<u32>(), any::<u32>()).prop_map(|(a, b, c)| a & b & c);
    let asking = prop_oneof![2 => Just(C::ARM), 1 => Just(C::empty()), 1 => Just(C::DISARM)];
    let bits = prop_oneof![few(), Just(0), Just(C::RC_LOST.union(C::THROTTLE_UP).bits())];
    let now = (bits, asking)
        .prop_map(|(bits, asking)| (C::from_bits_truncate(bits) | asking).difference(C::TIME_UP));
    let dt_us = prop_oneof![4 => 0..200_000_u32, 2 => Just(250_000), 1 => Just(500_000), 1 => Just(u32::MAX)];
    prop::collection::vec((now, dt_us, 1..4_usize), 1..40)
}

proptest! {
    /// The table, with the clock of the present state and a request that is answered once: told a second time, and
    /// without looking at what was the same in the last step.
    #[test]
    fn whatever_comes_and_goes_is_decided_as_promised(moments in moments()) {
        let mut arming = super::Arming::new(1_000_000);
        let (mut state, mut in_state_us, mut answered) = (Disarmed, 0_u64, true);
        for (shown, dt_us, times) in moments {
            for _ in 0..times {
                in_state_us += u64::from(dt_us);
                let over = matches!(state, Arming if in_state_us >= 500_000)
                    || matches!(state, Descent if in_state_us >= 1_000_000);
                answered &= shown.contains(C::ARM);
                let mut now = shown;
                now.set(C::TIME_UP, over);
                now.set(C::ARM, shown.contains(C::ARM) && !answered);
                let expected = promised(state, now).map(|(to, cause)| event(state, to, cause));
                prop_assert_eq!(arming.update(shown, dt_us), expected, "{:?} in {:?}", shown, state);
                if let Some(Event { from, to, cause }) = expected {
                    // Who asks is answered by the motors, or by a refusal.
                    answered |= match from {
                        Disarmed => matches!(to, Arming | Disarmed),
                        Bench => cause == Cause::BenchCommand,
                        Terminated | Maintenance => from == to,
                        _ => false,
                    };
                    if from != to {
                        (state, in_state_us) = (to, 0);
                    }
                }
                prop_assert_eq!(arming.state(), state);
                let permit = arming.permit(|| Some(BenchMotor { rotor: 0, limit_us: 1_200.0 }));
                prop_assert_eq!(permit.is_some(), matches!(state, Armed | Descent | Bench));
                prop_assert_eq!(state.flies(), matches!(state, Armed | Descent));
            }
        }
    }

    /// Whatever the pulses are: on the bench no motor but one gets more than the stop, and that one no more than its
    /// limit, which is also what it gets for a pulse that is not a number.
    #[test]
    fn any_pulses_through_the_permit_of_the_bench(
        pulses_us in prop::array::uniform4(ANY), rotor in 0..6_usize, limit_us in 1_000.0..2_000.0_f32,
    ) {
        let mut arming = super::Arming::new(1);
        run(&mut arming, C::BENCH_COMMAND, 1);
        let permit = arming.permit(|| Some(BenchMotor { rotor, limit_us })).unwrap();
        for (index, (out, us)) in permit.apply(pulses_us, 1_000.0).into_iter().zip(pulses_us).enumerate() {
            let expected = if index == rotor { us.min(limit_us) } else { 1_000.0 };
            prop_assert_eq!(out, expected);
        }
    }
}

#[test]
fn a_refusal_is_what_leaves_the_motors_stopped_although_the_pilot_asked() {
    let all = || ArmState::ALL.into_iter();
    for (from, to) in all().flat_map(|from| all().map(move |to| (from, to))) {
        let refused = from == to || (from, to) == (Arming, Disarmed);
        assert_eq!(event(from, to, Cause::Pilot).is_refusal(), refused, "{from:?} {to:?}");
    }
}

/// What people are told: each state by its own name, each cause in words of its own.
#[test]
fn states_and_causes_can_be_told_apart() {
    assert!(ArmState::ALL.iter().all(|state| state.name() == std::format!("{state:?}")));
    let mut told: Vec<(&str, Cause)> = Vec::new();
    for row in ArmState::ALL.into_iter().flat_map(rows) {
        let text = row.cause.text();
        assert!(
            text.len() > 4 && told.iter().all(|(known, cause)| (*known == text) == (*cause == row.cause))
        );
        told.push((text, row.cause));
    }
    let causes =
        told.iter().enumerate().filter(|(n, (text, _))| told[..*n].iter().all(|(known, _)| known != text));
    assert_eq!(causes.count(), 23);
}

#[test]
fn conditions_are_those_that_hold_named_once_or_twice() {
    for bits in 0..16_u32 {
        let [a, b, c, d] = [0, 1, 2, 3].map(|n| bits >> n & 1 == 1);
        let held = C::of([(C::ARM, a), (C::TILT_LIMIT, b), (C::RC_LOST, c), (C::ARM, d)]);
        assert_eq!(
            (held.contains(C::ARM), held.contains(C::TILT_LIMIT), held.contains(C::RC_LOST)),
            (a || d, b, c)
        );
        assert!((C::ARM | C::TILT_LIMIT | C::RC_LOST).contains(held));
    }
}
