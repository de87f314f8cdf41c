//! Faults in flight and the states in which they end: see docs/safety.md.
//!
//! Most flights are flown twice, and must have equal edges at the pads, records and logs.

use emulator::faults::Fault;
use emulator::flight::Flown;
use flight_core::ArmState::{self, Descent, Disarmed, Terminated};
use flight_core::arming::Cause;

use emulator::timing::INSTRUCTIONS_PER_SECOND;

use super::{after_arming, assert_sound, fly, fly_twice, hover, story};

/// Time of the faults, s: in the middle of the hover.
pub const AT_S: f64 = 9.0;

/// Checks that the first event after arming is this one, and comes within `limit_s` after the fault.
#[track_caller]
fn ends_in(flown: &Flown, limit_s: f64, state: ArmState, cause: Cause) {
    let events = after_arming(flown);
    let story = story(flown);
    let (at_s, to, found) = *events.first().unwrap_or_else(|| panic!("no event: {story}"));
    assert_eq!((to, found), (state, cause), "{story}");
    assert!((AT_S - 0.01..AT_S + limit_s).contains(&at_s), "at {at_s} s: {story}");
}

/// Checks that each ESC receives a stop within `limit_s` after the fault, and only stops after that.
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
fn silent_receiver_in_flight_starts_descent() {
    let flown = fly_twice(&hover(""), &[(AT_S, Fault::ReceiverSilent(true))]);
    assert_sound(&flown);
    ends_in(&flown, 0.53, Descent, Cause::RcLost);
}

#[test]
fn receiver_garbage_in_flight_starts_descent() {
    let faults = [(AT_S, Fault::ReceiverSilent(true)), (AT_S, Fault::ReceiverGarbage(4_000))];
    let flown = fly_twice(&hover(""), &faults);
    assert_sound(&flown);
    ends_in(&flown, 0.53, Descent, Cause::RcLost);
}

#[test]
fn receiver_connected_late_is_found() {
    // The pilot arms at 3 s. The search for the protocol takes at most a second and three frames.
    let flown =
        fly_twice(&hover(""), &[(0.0, Fault::ReceiverSilent(true)), (1.5, Fault::ReceiverSilent(false))]);
    assert_sound(&flown);
    assert!(
        flown.armed && flown.took_off == Some(true) && flown.outcome.final_state == Disarmed,
        "{}",
        story(&flown)
    );
}

// The IMU.

#[test]
fn absent_imu_at_power_up_prevents_arming_without_reset() {
    let flown = fly_twice(&hover(""), &[(0.0, Fault::ImuDead(true))]);
    assert_sound(&flown);
    assert!(!flown.armed && flown.resets.is_empty(), "{}", story(&flown));
    assert_eq!(flown.outcome.final_state, Disarmed);
}

#[test]
fn imu_connected_late_is_set_up() {
    let flown = fly_twice(&hover(""), &[(0.0, Fault::ImuDead(true)), (1.0, Fault::ImuDead(false))]);
    assert_sound(&flown);
    assert!(flown.armed && flown.took_off == Some(true), "{}", story(&flown));
}

#[test]
fn imu_failure_in_flight_terminates() {
    let flown = fly_twice(&hover(""), &[(AT_S, Fault::ImuDead(true))]);
    assert_sound(&flown);
    ends_in(&flown, 0.12, Terminated, Cause::ImuLost);
    pads_stop(&flown, 0.12);
}

#[test]
fn imu_reset_in_flight_is_set_up_again() {
    let flown = fly_twice(&hover(""), &[(AT_S, Fault::ImuReset)]);
    assert_sound(&flown);
    assert_eq!(flown.outcome.crash, None, "{}", story(&flown));
    assert_eq!(after_arming(&flown).last().map(|event| event.1), Some(Disarmed), "{}", story(&flown));
    let set_up = flown.log.iter().filter(|line| line.contains("IMU: set-up done")).count();
    assert!(set_up >= 2, "{}", story(&flown));
}

#[test]
fn flight_survives_bit_errors_on_the_imu_bus() {
    let flown = fly_twice(&hover(""), &[(6.0, Fault::ImuBitErrors(Some(10_000)))]);
    assert_sound(&flown);
    assert_eq!(flown.outcome.crash, None, "{}", story(&flown));
    assert!(flown.outcome.inclination_rmse_deg < 1.0, "{}", story(&flown));
}

#[test]
fn flight_survives_stuck_data_ready_line() {
    for level in [false, true] {
        let flown = fly_twice(&hover(""), &[(AT_S, Fault::ReadyStuck(Some(level)))]);
        assert_sound(&flown);
        assert_eq!(flown.outcome.crash, None, "stuck at {level}: {}", story(&flown));
        assert_eq!(flown.outcome.final_state, Disarmed, "stuck at {level}: {}", story(&flown));
    }
}

// The magnetometer.

#[test]
fn flight_survives_held_magnetometer_bus() {
    let flown = fly_twice(&hover(""), &[(AT_S, Fault::MagnetometerBusHeld(true))]);
    assert_sound(&flown);
    assert_eq!((flown.outcome.crash, flown.outcome.final_state), (None, Disarmed), "{}", story(&flown));
    assert!(flown.resets.is_empty());
    assert!(flown.log.iter().any(|line| line.contains("magnetometer lost")), "{}", story(&flown));
}

#[test]
fn magnetometer_connected_late_is_found() {
    let faults = [(0.0, Fault::MagnetometerAbsent(true)), (1.0, Fault::MagnetometerAbsent(false))];
    let flown = fly_twice(&hover(""), &faults);
    assert_sound(&flown);
    assert_eq!((flown.outcome.crash, flown.outcome.final_state), (None, Disarmed), "{}", story(&flown));
    assert!(flown.log.iter().any(|line| line.contains("magnetometer found")), "{}", story(&flown));
}

/// A run of the magnetometer's driver has a time limit of 4 ms, also on a held bus.
#[test]
fn held_magnetometer_bus_does_not_extend_a_run() {
    let flown = fly(&hover(""), &[(AT_S, Fault::MagnetometerBusHeld(true))]);
    let magnetometer = flown.wiring.handlers.iter().position(|handler| handler.vector == "CRYP").unwrap();
    let max_ms = flown.timing.runs[magnetometer].max as f64 / INSTRUCTIONS_PER_SECOND as f64 * 1e3;
    assert!((3.0..4.3).contains(&max_ms), "{max_ms} ms: {}", story(&flown));
}

#[test]
fn interrupted_magnetometer_byte_is_clocked_out() {
    let flown = fly_twice(&hover(""), &[(AT_S, Fault::MagnetometerInterrupted(8))]);
    assert_sound(&flown);
    assert_eq!((flown.outcome.crash, flown.outcome.final_state), (None, Disarmed), "{}", story(&flown));
    let lines = |text: &str| flown.log.iter().filter(|line| line.contains(text)).count();
    assert_eq!((lines("magnetometer lost"), lines("magnetometer found")), (1, 2), "{}", story(&flown));
}

// The DMA of the IMU.

/// The memory address of a DMA stream is unmapped: the burst fails, or does not end. The fault lasts 20 ms; a flight is
/// terminated after 100 ms without samples.
#[test]
fn flight_survives_20_ms_of_failed_bursts() {
    for stream in [0, 3] {
        let faults = [
            (AT_S, Fault::StreamAddressUnmapped(stream, true)),
            (AT_S + 0.02, Fault::StreamAddressUnmapped(stream, false)),
        ];
        let flown = fly_twice(&hover(""), &faults);
        let story = story(&flown);
        assert_eq!(
            (flown.outcome.crash, flown.outcome.final_state),
            (None, Disarmed),
            "stream {stream}: {story}"
        );
        assert!(flown.resets.is_empty(), "stream {stream}: {story}");
        assert_eq!(flown.unserved, [""; 0], "stream {stream}: {story}");
        // Only the accesses that the fault made are gaps.
        assert!(flown.gaps.iter().all(|gap| gap.contains("at 0x6")), "stream {stream}: {:?}", flown.gaps);
        let lost =
            flown.records.iter().filter(|record| record.imu.is_none() && record.time_us > 6_000_000).count();
        // Samples are lost during the fault and during the sensor's set-up after it, which takes 57 ms.
        assert!((20..=90).contains(&lost), "stream {stream}: {lost} lost: {story}");
        // An error is handled at once, and not only at the next sample.
        assert_eq!(counted(&flown, "late"), 0, "stream {stream}: {story}");
    }
}

/// One burst of either stream fails; the next burst delivers its sample.
#[test]
fn one_failed_burst_loses_one_sample() {
    for stream in [0, 3] {
        let faults = [
            (AT_S, Fault::StreamAddressUnmapped(stream, true)),
            (AT_S + 0.0011, Fault::StreamAddressUnmapped(stream, false)),
        ];
        let flown = fly(&hover(""), &faults);
        let lost = flown.records.iter().filter(|record| record.imu.is_none() && record.time_us > 6_000_000);
        let lost = lost.count();
        assert!((1..=2).contains(&lost), "stream {stream}: {lost} lost: {}", story(&flown));
        assert!(flown.gaps.iter().all(|gap| gap.contains("at 0x6")), "stream {stream}: {:?}", flown.gaps);
        assert_eq!(flown.outcome.final_state, Disarmed, "{}", story(&flown));
    }
}

/// Returns the sum of a counter over the log's health lines.
fn counted(flown: &Flown, name: &str) -> u32 {
    let lines = flown.log.iter().filter(|line| line.contains("imu lost"));
    let counts = lines.map(|line| {
        let mut words = line.split([' ', ',']);
        words.find(|word| *word == name);
        words
            .next()
            .and_then(|count| count.parse::<u32>().ok())
            .unwrap_or_else(|| panic!("no {name} in {line}"))
    });
    counts.sum()
}

// The supply.

#[test]
fn critical_battery_in_flight_starts_descent() {
    let flown = fly_twice(&hover(""), &[(AT_S, Fault::Battery(Some(8.5)))]);
    assert_sound(&flown);
    // The filtered voltage must be below 9 V for 3 s.
    ends_in(&flown, 4.5, Descent, Cause::BatteryCritical);
}

#[test]
fn low_battery_refuses_to_arm() {
    let flown = fly_twice(&hover(""), &[(0.0, Fault::Battery(Some(10.0)))]);
    assert_sound(&flown);
    assert!(!flown.armed);
    assert!(flown.log.iter().any(|line| line.contains("refused: battery low")), "{}", story(&flown));
}

#[test]
fn power_cut_in_flight_restarts_with_motors_stopped() {
    let flown = fly_twice(&hover(""), &[(AT_S, Fault::Power(false)), (AT_S + 0.2, Fault::Power(true))]);
    assert_eq!(flown.resets.len(), 1, "{}", story(&flown));
    assert!(flown.log.iter().any(|line| line.contains("reset by power")), "{}", story(&flown));
    for esc in &flown.escs {
        assert!(esc.last_driven_ns.unwrap() as f64 * 1e-9 <= AT_S + 0.001, "{}", story(&flown));
    }
    assert_eq!(flown.states.last().unwrap().1, Disarmed, "{}", story(&flown));
}

// The program.

/// Checks that the watchdog resets the firmware, which then starts in `Terminated` with stopped motors.
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
    assert_commands_continue(flown, *reset_s, pads_limit_s.min(0.03));
}

/// Checks that each ESC receives commands until the reset, so that none depends on its own time-out. Commands are at most
/// `max_gap_s` apart, and the last one is less than 3 ms before the reset. (PWM's period is 2.5 ms; the longest pause
/// between two stops of the other protocols is 1.7 ms.)
#[track_caller]
fn assert_commands_continue(flown: &Flown, reset_s: f64, max_gap_s: f64) {
    for esc in &flown.escs {
        let at_s = esc.commands.iter().map(|command| command.at_ns as f64 * 1e-9);
        let before: Vec<f64> = at_s.filter(|at_s| (AT_S - 0.01..reset_s).contains(at_s)).collect();
        let gap_s = before.windows(2).map(|pair| pair[1] - pair[0]).fold(0.0, f64::max);
        let last_s = before.last().copied().unwrap_or(0.0);
        assert!(gap_s <= max_gap_s && reset_s - last_s <= 0.003, "{gap_s} s, {last_s} s: {}", story(flown));
    }
}

/// Flies with an endless loop as a task's first instruction, which is restored after `duration_s`.
fn fly_with_hang(task: &'static str, duration_s: f64) -> Flown {
    fly_twice(&hover(""), &[(AT_S, Fault::Hang(task)), (AT_S + duration_s, Fault::Restored(task))])
}

#[test]
fn hanging_control_loop_stops_motors_and_resets() {
    // The motors stop after twenty wake-ups without an end of the run, which take 20 ms, and up to a period of PWM.
    // After that only the stop runs, so restoring the task before the reset does not matter.
    watchdog_resets(&fly_with_hang("DMA2_STREAM0", 0.5), 0.025);
}

#[test]
fn pin_reset_after_watchdog_reset_is_reported_as_pin() {
    let task = "DMA2_STREAM0";
    let faults =
        [(AT_S, Fault::Hang(task)), (AT_S + 0.5, Fault::Restored(task)), (AT_S + 2.5, Fault::ResetPin)];
    let flown = fly_twice(&hover(""), &faults);
    assert_eq!(flown.resets.len(), 2, "{}", story(&flown));
    let lines = |text: &str| flown.log.iter().filter(|line| line.contains(text)).count();
    assert_eq!((lines("reset by watchdog"), lines("reset by pin")), (1, 1), "{}", story(&flown));
    assert_eq!(flown.states.last().unwrap().1, Disarmed, "{}", story(&flown));
}

#[test]
fn hanging_tick_resets() {
    let flown = fly_with_hang("SysTick", 2.5);
    watchdog_resets(&flown, 2.2);
}

#[test]
fn flight_survives_hanging_magnetometer_task() {
    let flown = fly_twice(&hover(""), &[(AT_S, Fault::Hang("CRYP"))]);
    assert_eq!((flown.outcome.crash, flown.resets.len()), (None, 0), "{}", story(&flown));
    assert_eq!(flown.outcome.final_state, Disarmed, "{}", story(&flown));
}

#[test]
fn undefined_instruction_stops_the_motors() {
    for task in ["DMA2_STREAM0", "SysTick", "EXTI4"] {
        let faults = [(AT_S, Fault::Undefined(task)), (AT_S + 0.5, Fault::Restored(task))];
        let flown = fly_twice(&hover(""), &faults);
        // The motors stop at once, which is within a PWM period of 2.5 ms or within a DShot frame.
        watchdog_resets(&flown, 0.006);
    }
}

#[test]
fn flipped_pointer_stops_the_motors() {
    // The fault is in the pointer to the queue of the receiver's bytes. With bit 27 inverted, the address is unmapped,
    // which causes a bus fault.
    let flown = fly_twice(&hover(""), &[(AT_S, Fault::FlippedPointer("::VAR", 27))]);
    watchdog_resets(&flown, 0.03);
}

#[test]
fn program_that_reads_unmapped_memory_is_aborted() {
    let flown = fly(&hover(""), &[(AT_S, Fault::ReadUnmapped("EXTI4"))]);
    let reason = flown.aborted.as_deref().unwrap_or_default();
    assert!(reason.contains("unmapped addresses"), "{reason}: {}", story(&flown));
    assert!((AT_S..AT_S + 0.2).contains(&flown.outcome.flown_s()), "{}", story(&flown));
}

#[test]
fn low_supply_voltage_stops_the_motors() {
    // The voltage is below the voltage detector's level of 2.66 V, and above the processor's minimum supply.
    let faults = [(AT_S, Fault::Supply(2_600)), (AT_S + 0.01, Fault::Supply(3_300))];
    let flown = fly_twice(&hover(""), &faults);
    assert_sound(&flown);
    watchdog_resets(&flown, 0.006);
    assert!(flown.log.iter().any(|line| line.contains("supply below 2.7 V")), "{}", story(&flown));
}
