//! What fails in flight, and the state in which it ends: docs/safety.md.
//!
//! Every flight here is flown twice, with equal edges at the pads, records and logs.

use emulator::faults::Fault;
use emulator::flight::Flown;
use flight_core::ArmState::{self, Descent, Disarmed, Terminated};
use flight_core::arming::Cause;

use emulator::timing::INSTRUCTIONS_PER_SECOND;

use super::{after_arming, assert_sound, fly, fly_twice, hover, story};

/// In the middle of the hover.
pub const AT_S: f64 = 9.0;

/// The only event after arming, if it comes within `limit_s` of the fault.
#[track_caller]
fn ends_in(flown: &Flown, limit_s: f64, state: ArmState, cause: Cause) {
    let events = after_arming(flown);
    let story = story(flown);
    let (at_s, to, why) = *events.first().unwrap_or_else(|| panic!("nothing happened: {story}"));
    assert_eq!((to, why), (state, cause), "{story}");
    assert!((AT_S - 0.01..AT_S + limit_s).contains(&at_s), "at {at_s} s: {story}");
}

/// Every ESC has got a stop within `limit_s` after the fault, and nothing but stops since.
#[track_caller]
pub fn pads_stop(flown: &Flown, limit_s: f64) {
    for esc in &flown.escs {
        let last_s = esc.last_driven_ns.expect("it flew") as f64 * 1e-9;
        assert!(last_s <= AT_S + limit_s, "driven until {last_s} s: {}", story(flown));
        let command = esc.last().unwrap();
        assert!(command.throttle == 0.0 && command.at_ns as f64 * 1e-9 > AT_S, "{command:?}");
    }
}

// The receiver.

#[test]
fn a_silent_receiver_ends_in_descent() {
    let flown = fly_twice(&hover(""), &[(AT_S, Fault::RadioSilent(true))]);
    assert_sound(&flown);
    ends_in(&flown, 0.53, Descent, Cause::RcLost);
}

#[test]
fn garbage_from_the_receiver_is_no_command() {
    let faults = [(AT_S, Fault::RadioSilent(true)), (AT_S, Fault::RadioGarbage(4_000))];
    let flown = fly_twice(&hover(""), &faults);
    assert_sound(&flown);
    ends_in(&flown, 0.53, Descent, Cause::RcLost);
}

#[test]
fn a_receiver_that_is_plugged_in_late_is_found() {
    // The pilot arms at 3 s; the search for the protocol takes a second and three frames.
    let flown = fly_twice(&hover(""), &[(0.0, Fault::RadioSilent(true)), (1.5, Fault::RadioSilent(false))]);
    assert_sound(&flown);
    assert!(
        flown.armed && flown.took_off == Some(true) && flown.outcome.final_state == Disarmed,
        "{}",
        story(&flown)
    );
}

// The inertial sensor.

#[test]
fn a_sensor_that_is_absent_at_power_up_is_no_flight_and_no_reset() {
    let flown = fly_twice(&hover(""), &[(0.0, Fault::ImuDead(true))]);
    assert_sound(&flown);
    assert!(!flown.armed && flown.resets.is_empty(), "{}", story(&flown));
    assert_eq!(flown.outcome.final_state, Disarmed);
}

#[test]
fn a_sensor_that_comes_late_is_set_up() {
    let flown = fly_twice(&hover(""), &[(0.0, Fault::ImuDead(true)), (1.0, Fault::ImuDead(false))]);
    assert_sound(&flown);
    assert!(flown.armed && flown.took_off == Some(true), "{}", story(&flown));
}

#[test]
fn a_sensor_that_dies_in_flight_ends_terminated() {
    let flown = fly_twice(&hover(""), &[(AT_S, Fault::ImuDead(true))]);
    assert_sound(&flown);
    ends_in(&flown, 0.12, Terminated, Cause::ImuLost);
    pads_stop(&flown, 0.12);
}

#[test]
fn a_sensor_that_resets_itself_is_set_up_again_in_flight() {
    let flown = fly_twice(&hover(""), &[(AT_S, Fault::ImuResetsItself)]);
    assert_sound(&flown);
    assert_eq!(flown.outcome.crash, None, "{}", story(&flown));
    assert_eq!(after_arming(&flown).last().map(|event| event.1), Some(Disarmed), "{}", story(&flown));
    let set_up = flown.log.iter().filter(|line| line.contains("inertial sensor: set up")).count();
    assert!(set_up >= 2, "{}", story(&flown));
}

#[test]
fn a_flipped_bit_in_ten_thousand_words_is_flown_through() {
    let flown = fly_twice(&hover(""), &[(6.0, Fault::ImuFlips(Some(10_000)))]);
    assert_sound(&flown);
    assert_eq!(flown.outcome.crash, None, "{}", story(&flown));
    assert!(flown.outcome.inclination_rmse_deg < 1.0, "{}", story(&flown));
}

#[test]
fn a_data_ready_line_that_sticks_is_flown_through() {
    for level in [false, true] {
        let flown = fly_twice(&hover(""), &[(AT_S, Fault::ReadyStuck(Some(level)))]);
        assert_sound(&flown);
        assert_eq!(flown.outcome.crash, None, "stuck at {level}: {}", story(&flown));
        assert_eq!(flown.outcome.final_state, Disarmed, "stuck at {level}: {}", story(&flown));
    }
}

// The magnetometer.

#[test]
fn a_magnetometer_bus_that_is_held_low_does_not_end_the_flight() {
    let flown = fly_twice(&hover(""), &[(AT_S, Fault::MagnetometerBusHeld(true))]);
    assert_sound(&flown);
    assert_eq!((flown.outcome.crash, flown.outcome.final_state), (None, Disarmed), "{}", story(&flown));
    assert!(flown.resets.is_empty());
    assert!(flown.log.iter().any(|line| line.contains("magnetometer lost")), "{}", story(&flown));
}

#[test]
fn a_magnetometer_that_comes_and_goes_is_found_again() {
    let faults = [(0.0, Fault::MagnetometerAbsent(true)), (1.0, Fault::MagnetometerAbsent(false))];
    let flown = fly_twice(&hover(""), &faults);
    assert_sound(&flown);
    assert_eq!((flown.outcome.crash, flown.outcome.final_state), (None, Disarmed), "{}", story(&flown));
    assert!(flown.log.iter().any(|line| line.contains("magnetometer found")), "{}", story(&flown));
}

/// The magnetometer's driver gives its run four milliseconds, whatever the wires do.
#[test]
fn a_held_bus_takes_no_more_than_the_time_of_a_run() {
    let flown = fly(&hover(""), &[(AT_S, Fault::MagnetometerBusHeld(true))]);
    let magnetometer = flown.wiring.handlers.iter().position(|handler| handler.vector == "CRYP").unwrap();
    let most_ms = flown.timing.runs[magnetometer].most as f64 / INSTRUCTIONS_PER_SECOND as f64 * 1e3;
    assert!((3.0..4.3).contains(&most_ms), "{most_ms} ms: {}", story(&flown));
}

#[test]
fn a_magnetometer_that_was_cut_off_in_a_byte_gets_its_clocks() {
    let flown = fly_twice(&hover(""), &[(AT_S, Fault::MagnetometerCutOff(8))]);
    assert_sound(&flown);
    assert_eq!((flown.outcome.crash, flown.outcome.final_state), (None, Disarmed), "{}", story(&flown));
    let said = |what: &str| flown.log.iter().filter(|line| line.contains(what)).count();
    assert_eq!((said("magnetometer lost"), said("magnetometer found")), (1, 2), "{}", story(&flown));
}

// What moves the bytes of the inertial sensor.

/// DMA that reaches for an address where nothing is: the burst fails, or does not end. For 20 ms, of the 100 that a
/// flight lasts without samples.
#[test]
fn bursts_that_fail_are_flown_through() {
    for stream in [0, 3] {
        let faults =
            [(AT_S, Fault::StreamAstray(stream, true)), (AT_S + 0.02, Fault::StreamAstray(stream, false))];
        let flown = fly_twice(&hover(""), &faults);
        let story = story(&flown);
        assert_eq!(
            (flown.outcome.crash, flown.outcome.final_state),
            (None, Disarmed),
            "stream {stream}: {story}"
        );
        assert!(flown.resets.is_empty(), "stream {stream}: {story}");
        assert_eq!(flown.unserved, [""; 0], "stream {stream}: {story}");
        // The accesses that the fault made, and nothing else.
        assert!(flown.gaps.iter().all(|gap| gap.contains("at 0x6")), "stream {stream}: {:?}", flown.gaps);
        let lost =
            flown.records.iter().filter(|record| record.imu.is_none() && record.time_us > 6_000_000).count();
        // The fault, and the sensor's set-up after it, which takes 57 ms.
        assert!((20..=90).contains(&lost), "stream {stream}: {lost} lost: {story}");
        // An error is told at once, and not found when the next sample comes.
        assert_eq!(counted(&flown, "late"), 0, "stream {stream}: {story}");
    }
}

/// One burst fails, of either stream: the next one brings its sample.
#[test]
fn one_burst_that_fails_costs_one_sample() {
    for stream in [0, 3] {
        let faults =
            [(AT_S, Fault::StreamAstray(stream, true)), (AT_S + 0.0011, Fault::StreamAstray(stream, false))];
        let flown = fly(&hover(""), &faults);
        let lost = flown.records.iter().filter(|record| record.imu.is_none() && record.time_us > 6_000_000);
        let lost = lost.count();
        assert!((1..=2).contains(&lost), "stream {stream}: {lost} lost: {}", story(&flown));
        assert!(flown.gaps.iter().all(|gap| gap.contains("at 0x6")), "stream {stream}: {:?}", flown.gaps);
        assert_eq!(flown.outcome.final_state, Disarmed, "{}", story(&flown));
    }
}

/// The sum of a count over the log's health lines.
fn counted(flown: &Flown, what: &str) -> u32 {
    let lines = flown.log.iter().filter(|line| line.contains("imu lost"));
    let counts = lines.map(|line| {
        let mut words = line.split([' ', ',']);
        words.find(|word| *word == what);
        words
            .next()
            .and_then(|count| count.parse::<u32>().ok())
            .unwrap_or_else(|| panic!("no {what} in {line}"))
    });
    counts.sum()
}

// The supply.

#[test]
fn a_critical_battery_ends_in_descent() {
    let flown = fly_twice(&hover(""), &[(AT_S, Fault::Battery(Some(8.5)))]);
    assert_sound(&flown);
    // Below 9 V for 3 s, behind the filter of the voltage.
    ends_in(&flown, 4.5, Descent, Cause::BatteryCritical);
}

#[test]
fn a_battery_that_is_too_low_refuses_to_arm() {
    let flown = fly_twice(&hover(""), &[(0.0, Fault::Battery(Some(10.0)))]);
    assert_sound(&flown);
    assert!(!flown.armed);
    assert!(flown.log.iter().any(|line| line.contains("refused: battery low")), "{}", story(&flown));
}

#[test]
fn a_supply_that_is_cut_in_flight_starts_anew_without_motors() {
    let flown = fly_twice(&hover(""), &[(AT_S, Fault::Power(false)), (AT_S + 0.2, Fault::Power(true))]);
    assert_eq!(flown.resets.len(), 1, "{}", story(&flown));
    assert!(flown.log.iter().any(|line| line.contains("reset by power")), "{}", story(&flown));
    for esc in &flown.escs {
        assert!(esc.last_driven_ns.unwrap() as f64 * 1e-9 <= AT_S + 0.001, "{}", story(&flown));
    }
    assert_eq!(flown.states.last().unwrap().1, Disarmed, "{}", story(&flown));
}

// The program.

/// After the watchdog's reset the firmware starts terminated, and with the motors stopped.
#[track_caller]
fn watchdog_resets(flown: &Flown, pads_limit_s: f64) {
    let story = story(flown);
    assert_eq!(flown.resets.len(), 1, "{story}");
    let (reset_s, cause) = &flown.resets[0];
    assert!(cause.contains("IWDG"), "{story}");
    assert!((AT_S..AT_S + 2.2).contains(reset_s), "{story}");
    assert!(flown.log.iter().any(|line| line.contains("reset by watchdog")), "{story}");
    assert!(flown.log.iter().any(|line| line.contains("Disarmed -> Terminated: watchdog reset")), "{story}");
    pads_stop(flown, pads_limit_s);
    commands_go_on(flown, *reset_s, pads_limit_s.min(0.03));
}

/// Until the reset every ESC keeps getting commands, so that none is left to its own time-out. They are at most
/// `widest_s` apart, and the last comes less than 3 ms before the reset (PWM's period is 2.5 ms, the longest pause
/// between two stops of the other protocols 1.7 ms).
#[track_caller]
fn commands_go_on(flown: &Flown, reset_s: f64, widest_s: f64) {
    for esc in &flown.escs {
        let at_s = esc.commands.iter().map(|command| command.at_ns as f64 * 1e-9);
        let before: Vec<f64> = at_s.filter(|at_s| (AT_S - 0.01..reset_s).contains(at_s)).collect();
        let gap_s = before.windows(2).map(|pair| pair[1] - pair[0]).fold(0.0, f64::max);
        let last_s = before.last().copied().unwrap_or(0.0);
        assert!(gap_s <= widest_s && reset_s - last_s <= 0.003, "{gap_s} s, {last_s} s: {}", story(flown));
    }
}

/// A task's first instruction is an endless loop, until `mended_s` later.
fn hangs(task: &'static str, mended_s: f64) -> Flown {
    fly_twice(&hover(""), &[(AT_S, Fault::Hang(task)), (AT_S + mended_s, Fault::Mended(task))])
}

#[test]
fn a_control_loop_that_hangs_stops_the_motors_and_is_reset() {
    // Twenty wake-ups without an end of its run: 20 ms, and a period of PWM.
    // From then on the stop is all that runs, so that the task may be mended before the reset.
    watchdog_resets(&hangs("DMA2_STREAM0", 0.5), 0.025);
}

#[test]
fn a_pin_reset_after_the_watchdogs_is_no_watchdog_reset() {
    let task = "DMA2_STREAM0";
    let faults =
        [(AT_S, Fault::Hang(task)), (AT_S + 0.5, Fault::Mended(task)), (AT_S + 2.5, Fault::ResetPin)];
    let flown = fly_twice(&hover(""), &faults);
    assert_eq!(flown.resets.len(), 2, "{}", story(&flown));
    let said = |what: &str| flown.log.iter().filter(|line| line.contains(what)).count();
    assert_eq!((said("reset by watchdog"), said("reset by pin")), (1, 1), "{}", story(&flown));
    assert_eq!(flown.states.last().unwrap().1, Disarmed, "{}", story(&flown));
}

#[test]
fn a_tick_that_hangs_is_reset() {
    let flown = hangs("SysTick", 2.5);
    watchdog_resets(&flown, 2.2);
}

#[test]
fn a_magnetometer_that_hangs_ends_no_flight() {
    let flown = fly_twice(&hover(""), &[(AT_S, Fault::Hang("CRYP"))]);
    assert_eq!((flown.outcome.crash, flown.resets.len()), (None, 0), "{}", story(&flown));
    assert_eq!(flown.outcome.final_state, Disarmed, "{}", story(&flown));
}

#[test]
fn an_undefined_instruction_stops_the_motors() {
    for task in ["DMA2_STREAM0", "SysTick", "EXTI4"] {
        let faults = [(AT_S, Fault::Undefined(task)), (AT_S + 0.5, Fault::Mended(task))];
        let flown = fly_twice(&hover(""), &faults);
        // At once; a PWM period of 2.5 ms, or a DShot frame.
        watchdog_resets(&flown, 0.006);
    }
}

#[test]
fn a_flipped_pointer_stops_the_motors() {
    // The queue of the receiver's bytes; bit 27 makes its address one where nothing is: a bus fault.
    let flown = fly_twice(&hover(""), &[(AT_S, Fault::FlippedPointer("::VAR", 27))]);
    watchdog_resets(&flown, 0.03);
}

#[test]
fn a_program_that_strays_through_the_address_space_is_broken_off() {
    let flown = fly(&hover(""), &[(AT_S, Fault::Strays("EXTI4"))]);
    let why = flown.broken_off.as_deref().unwrap_or_default();
    assert!(why.contains("addresses where nothing is"), "{why}: {}", story(&flown));
    assert!((AT_S..AT_S + 0.2).contains(&flown.outcome.flown_s()), "{}", story(&flown));
}

#[test]
fn a_supply_that_sags_stops_the_motors() {
    // Below the voltage detector's 2.66 V, and above what the processor needs.
    let faults = [(AT_S, Fault::Supply(2_600)), (AT_S + 0.01, Fault::Supply(3_300))];
    let flown = fly_twice(&hover(""), &faults);
    assert_sound(&flown);
    watchdog_resets(&flown, 0.006);
    assert!(flown.log.iter().any(|line| line.contains("supply below 2.7 V")), "{}", story(&flown));
}
