use std::vec::Vec;

use proptest::num::f32::ANY;
use proptest::prelude::*;

use super::table::{Conditions, Row, decide, rows};
use super::{ArmState, Arming, BenchMotor, Cause, Event};
use ArmState::*;
use Conditions as C;

/// Conditions that prevent arming, in the order in which they are reported.
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

/// The specified transition of a state, written a second time, as nested decisions instead of a table.
fn specified(state: ArmState, now: C) -> Option<(ArmState, Cause)> {
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
    let received = |request| is(request) && !is(C::RC_LOST);
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
            if received(C::DISARM) {
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

fn decided(rows: &[Row], now: C) -> Option<(ArmState, Cause)> {
    decide(rows, now).map(|row| (row.to, row.cause))
}

#[test]
#[cfg_attr(miri, ignore = "2^19 combinations of each state")]
fn every_state_and_condition_set_is_as_specified() {
    assert_eq!(C::all().bits(), (1 << 19) - 1);
    for state in ArmState::ALL {
        for now in every_combination() {
            assert_eq!(decided(rows(state), now), specified(state, now), "{state:?} {now:?}");
        }
    }
}

#[test]
#[cfg_attr(miri, ignore = "2^19 combinations of each state")]
fn every_row_is_needed() {
    for state in ArmState::ALL {
        for index in 0..rows(state).len() {
            let mut without = rows(state).to_vec();
            let row = without.remove(index);
            let detected = every_combination().any(|now| decided(&without, now) != specified(state, now));
            assert!(detected, "not needed: {row:?}");
        }
    }
}

#[test]
fn rows_in_flight_use_only_conditions_in_flight() {
    for row in rows(Armed).iter().chain(rows(Descent)) {
        assert!(C::IN_FLIGHT.contains(row.when | row.unless), "{row:?}");
    }
}

#[test]
fn rows_have_their_state_and_no_contradiction() {
    for state in ArmState::ALL {
        assert!(rows(state).iter().all(|row| row.from == state && !row.when.intersects(row.unless)));
    }
}

/// Properties that do not depend on the rows, to find a mistake that is in both versions above.
#[test]
#[cfg_attr(miri, ignore = "2^19 combinations of each state")]
fn safety_properties_hold_in_every_state() {
    for state in ArmState::ALL {
        for now in every_combination() {
            let to = decided(rows(state), now).map_or(state, |(to, _)| to);
            let turning = |s: ArmState| s.flies() || s == Bench;
            if turning(to) && !turning(state) {
                // Stopped motors start only by a checked arming or a bench command.
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
                // The tilt limit applies only in flight.
                assert!(!(state.flies() && now.contains(C::TILT_LIMIT)), "{state:?} {now:?}");
            }
            if to == Maintenance {
                assert!(!turning(state) && state != Arming);
            }
            // With a link, the pilot can always stop the motors.
            if now.contains(C::DISARM) && !now.contains(C::RC_LOST) {
                assert!(!turning(to), "{state:?} {now:?}");
            }
        }
    }
}

/// Updates an [`Arming`] once per millisecond for `ms` milliseconds, and returns its events.
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
fn refusal_is_reported_once_until_released() {
    let mut arming = super::Arming::new(1);
    run(&mut arming, C::empty(), 1);
    assert_eq!(run(&mut arming, C::ARM | C::NOT_LEVEL, 3_000), [event(Disarmed, Disarmed, Cause::NotLevel)]);
    assert!(run(&mut arming, C::ARM, 3_000).is_empty(), "level now, but the request is old");
    run(&mut arming, C::empty(), 1);
    assert_eq!(run(&mut arming, C::ARM, 1), [event(Disarmed, Arming, Cause::Pilot)]);
}

#[test]
#[cfg_attr(miri, ignore = "10,000 steps")]
fn request_present_from_the_start_is_ignored() {
    let mut arming = super::Arming::new(1);
    assert!(run(&mut arming, C::ARM, 10_000).is_empty());
}

#[test]
#[cfg_attr(miri, ignore = "1,400 steps of each obstacle")]
fn condition_that_appears_while_arming_disarms() {
    for (obstacle, cause) in OBSTACLES {
        let mut arming = super::Arming::new(1);
        run(&mut arming, C::empty(), 1);
        run(&mut arming, C::ARM, 400);
        let events = run(&mut arming, C::ARM | obstacle, 1_000);
        assert_eq!(events[0], event(Arming, Disarmed, cause));
        assert!(events[1..].iter().all(|event| event.to == Bench), "{events:?}");
        assert!(events[0].is_refusal());
    }
}

#[test]
#[cfg_attr(miri, ignore = "8,000 steps")]
fn descent_ends_after_its_time_or_with_the_link() {
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
fn bench_permit_turns_one_motor_up_to_its_limit() {
    let mut arming = super::Arming::new(1);
    run(&mut arming, C::BENCH_COMMAND, 1);
    assert_eq!(arming.state(), Bench);
    let motor = BenchMotor { rotor: 2, limit_us: 1_300.0 };
    let permit = arming.permit(|| Some(motor)).unwrap();
    assert_eq!(permit.apply([1_900.0; 4], 1_000.0), [1_000.0, 1_000.0, 1_300.0, 1_000.0]);
    let permit = arming.permit(|| Some(motor)).unwrap();
    assert_eq!(permit.apply([1_200.0; 4], 1_000.0), [1_000.0, 1_000.0, 1_200.0, 1_000.0]);
    assert!(arming.permit(|| None).is_none());
    // In flight the motor of a bench command has no effect.
    let permit = armed().permit(|| Some(motor)).unwrap();
    assert_eq!(permit.apply([1_900.0; 4], 1_000.0), [1_900.0; 4]);
}

/// Sequences of conditions, few of them at a time, with step times and repetitions.
fn sequence() -> impl Strategy<Value = Vec<(C, u32, usize)>> {
    let few = || (any::<u32>(), any::<u32>(), any::<u32>()).prop_map(|(a, b, c)| a & b & c);
    let request = prop_oneof![2 => Just(C::ARM), 1 => Just(C::empty()), 1 => Just(C::DISARM)];
    let bits = prop_oneof![few(), Just(0), Just(C::RC_LOST.union(C::THROTTLE_UP).bits())];
    let now = (bits, request)
        .prop_map(|(bits, request)| (C::from_bits_truncate(bits) | request).difference(C::TIME_UP));
    let dt_us = prop_oneof![4 => 0..200_000_u32, 2 => Just(250_000), 1 => Just(500_000), 1 => Just(u32::MAX)];
    prop::collection::vec((now, dt_us, 1..4_usize), 1..40)
}

proptest! {
    /// Compares the arming with a second implementation of the table, of the time in the present state and of
    /// requests that are answered once. It does not have the shortcut for unchanged conditions.
    #[test]
    fn any_sequence_is_decided_as_specified(sequence in sequence()) {
        let mut arming = super::Arming::new(1_000_000);
        let (mut state, mut in_state_us, mut answered) = (Disarmed, 0_u64, true);
        for (shown, dt_us, times) in sequence {
            for _ in 0..times {
                in_state_us += u64::from(dt_us);
                let over = matches!(state, Arming if in_state_us >= 500_000)
                    || matches!(state, Descent if in_state_us >= 1_000_000);
                answered &= shown.contains(C::ARM);
                let mut now = shown;
                now.set(C::TIME_UP, over);
                now.set(C::ARM, shown.contains(C::ARM) && !answered);
                let expected = specified(state, now).map(|(to, cause)| event(state, to, cause));
                prop_assert_eq!(arming.update(shown, dt_us), expected, "{:?} in {:?}", shown, state);
                if let Some(Event { from, to, cause }) = expected {
                    // A request is answered by starting or by a refusal.
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

    /// For any pulses: on the bench every motor except one gets the stop pulse. That motor gets at most its limit,
    /// also for a NaN pulse.
    #[test]
    fn any_pulses_are_limited_by_the_bench_permit(
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
fn refusal_is_no_change_or_arming_to_disarmed() {
    let all = || ArmState::ALL.into_iter();
    for (from, to) in all().flat_map(|from| all().map(move |to| (from, to))) {
        let refused = from == to || (from, to) == (Arming, Disarmed);
        assert_eq!(event(from, to, Cause::Pilot).is_refusal(), refused, "{from:?} {to:?}");
    }
}

/// Texts for display: each state has its own name, each cause its own text.
#[test]
fn states_and_causes_have_distinct_texts() {
    assert!(ArmState::ALL.iter().all(|state| state.name() == std::format!("{state:?}")));
    let mut texts: Vec<(&str, Cause)> = Vec::new();
    for row in ArmState::ALL.into_iter().flat_map(rows) {
        let text = row.cause.text();
        assert!(
            text.len() > 4 && texts.iter().all(|(known, cause)| (*known == text) == (*cause == row.cause))
        );
        texts.push((text, row.cause));
    }
    let causes =
        texts.iter().enumerate().filter(|(n, (text, _))| texts[..*n].iter().all(|(known, _)| known != text));
    assert_eq!(causes.count(), 23);
}

#[test]
fn condition_set_is_the_union_of_those_that_hold() {
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
