//! Other functions of the board: rates, timing, priorities, LED and pads; and what it refuses.

use std::path::Path;

use emulator::faults::Fault;
use emulator::firmware::Firmware;
use emulator::pads::Line;
use emulator::rc_receiver::Protocol;
use flight_core::ArmState;

use super::{assert_healthy, firmware, fly, hover, scene, settings, story};

/// Returns the figures of the log's health lines, one list of `(name, value)` for each line.
fn health(log: &[String]) -> Vec<Vec<(String, i64)>> {
    let lines = log.iter().filter(|line| line.contains("imu lost"));
    lines
        .map(|line| {
            let words: Vec<&str> = line.split([' ', ',']).filter(|word| !word.is_empty()).collect();
            let pairs = words.windows(2).filter_map(|pair| Some((pair[0].to_owned(), pair[1].parse().ok()?)));
            pairs.collect()
        })
        .collect()
}

fn value(line: &[(String, i64)], name: &str) -> i64 {
    line.iter().find(|(found, _)| found == name).unwrap_or_else(|| panic!("no {name} in {line:?}")).1
}

#[test]
fn sensors_and_tasks_run_at_their_rates() {
    let flown = fly(&hover(""), &[]);
    assert_healthy(&flown);
    let lines = health(&flown.log);
    assert!(lines.len() >= 19, "{}", story(&flown));
    for line in &lines[3..] {
        for never in
            ["lost", "polled", "late", "repeated", "invalid", "unreadable", "errors", "bad", "missed"]
        {
            assert_eq!(value(line, never), 0, "{never}: {line:?}");
        }
        assert!((99..=101).contains(&value(line, "mag")), "{line:?}");
        assert!((49..=51).contains(&value(line, "rc")), "{line:?}");
        // The battery has 11.1 V, behind a divider of 11. A count is 0.8 mV.
        assert!((11_080..=11_120).contains(&value(line, "battery")), "{line:?}");
    }

    // The software tasks of a priority share a handler, so a task with another priority changes the runs of two handlers.
    let handlers = flown.wiring.handlers.iter().zip(&flown.timing.runs);
    let runs: Vec<(&str, f64)> =
        handlers.map(|(handler, runs)| (handler.task, runs.count() as f64)).collect();
    let of = |task: &str| runs.iter().find(|(name, _)| *name == task).unwrap().1;
    let seconds = flown.outcome.flown_s();
    for (task, rate_hz) in [("battery", 50.0), ("magnetometer", 200.0)] {
        assert!((of(task) - rate_hz * seconds).abs() <= 3.0, "{runs:?}");
    }
    // `health` runs once a second. The other 61 runs are the steps of the sensor's set-up, one each millisecond, and the
    // changes of state.
    assert!((of("imu_setup, health, log_event") - seconds - 61.0).abs() <= 8.0, "{runs:?}");
}

#[test]
fn samples_are_stamped_and_processed_in_time() {
    let flown = fly(&hover(""), &[]);
    assert_healthy(&flown);
    let timing = &flown.timing;
    assert!(timing.latency_ns.count() > 19_000);
    // The receiver's handler has the same priority and can delay the entry by its thirty or so instructions.
    assert!(timing.entry_ns.max <= 2_000, "{:?}", timing.entry_ns);
    assert!(timing.latency_instructions.max <= 3_400, "{:?}", timing.latency_instructions);
    // Time stamps are a millisecond apart, with a tolerance for that delay.
    let armed: Vec<u64> = flown.records.iter().skip(1_000).map(|record| record.time_us).collect();
    for pair in armed.windows(2) {
        assert!((997..=1_003).contains(&(pair[1] - pair[0])), "{pair:?}");
    }
}

/// Compares the tables of docs/timing.md with measurements of the flash image: means within 3 %, maxima within 10 %.
#[test]
fn timing_page_matches_measured_figures() {
    let page = include_str!("../../../docs/timing.md");
    let row = |first: &str| -> Vec<&str> {
        let row = page
            .lines()
            .find(|line| line.starts_with(&format!("| {first}")) && line.matches('|').count() >= 5);
        row.unwrap_or_else(|| panic!("no row {first}")).split('|').map(str::trim).collect()
    };
    let number = |cell: &str| -> f64 { cell.replace([',', '%'], "").trim().parse().unwrap() };
    let near = |what: &str, page: f64, measured: f64, share: f64, and: f64| {
        assert!(
            (page - measured).abs() <= share * measured + and,
            "{what}: {page} on the page, {measured} measured"
        );
    };
    let flown = fly(&scene("hover", None), &[]);
    assert_healthy(&flown);
    let timing = &flown.timing;
    for (handler, runs) in flown.wiring.handlers.iter().zip(&timing.runs) {
        let row = row(&format!("{} | {} | {} |", handler.vector, handler.task, handler.priority));
        near(handler.vector, number(row[4]), runs.count() as f64, 0.01, 1.0);
        near(handler.vector, number(row[5]), runs.mean(), 0.03, 0.5);
        near(handler.vector, number(row[6]), runs.max as f64, 0.1, 0.0);
        let share = runs.share_of_time(flown.outcome.flown_s());
        near(handler.vector, number(row[7]), 100.0 * share, 0.05, 0.005);
    }
    let entry = row("to the handler's first instruction");
    near("entry", number(entry[2]), timing.entry_ns.min as f64 * 1e-3, 0.0, 0.01);
    near("entry", number(entry[4]), timing.entry_ns.max as f64 * 1e-3, 0.1, 0.01);
    let latency = row("to the last write to a motor's timer");
    near("latency", number(latency[3]), timing.latency_instructions.mean(), 0.03, 0.0);
    near("latency", number(latency[4]), timing.latency_instructions.max as f64, 0.1, 0.0);
    let latency = row("the same, µs");
    near("latency, µs", number(latency[3]), timing.latency_ns.mean() * 1e-3, 0.03, 0.0);
    near("latency, µs", number(latency[4]), timing.latency_ns.max as f64 * 1e-3, 0.1, 0.0);
    // The jitter is at most the resolution of 1 µs plus the maximum delay of the handler's entry.
    let limit_ns = 1_000 + timing.entry_ns.max as i64;
    assert!(timing.stamp_jitter_ns() <= limit_ns, "{} ns", timing.stamp_jitter_ns());
}

#[test]
fn interrupt_priorities_match_the_task_table() {
    // The vehicle is on the ground, before the pilot arms.
    let flown = fly(&hover(""), &[(2.0, Fault::AllInterrupts)]);
    let handlers = flown.wiring.handlers;
    let pairs = |n: usize| {
        let by =
            flown.timing.interrupted.iter().filter(move |(below, _)| *below == n).map(|(_, on_top)| *on_top);
        // A handler that seems to interrupt itself has ended by a return that is not watched.
        by.filter(|on_top| *on_top != n && handlers[*on_top].exception >= 16).collect::<Vec<_>>()
    };
    for (n, below) in handlers.iter().enumerate() {
        let above = (0..handlers.len()).filter(|m| handlers[*m].priority > below.priority);
        let expected: Vec<usize> = above.filter(|m| handlers[*m].exception >= 16).collect();
        assert_eq!(pairs(n), expected, "{} is interrupted by", below.vector);
    }
}

/// On the ground the LED flashes for 50 ms each second; in flight it is lit.
#[test]
fn led_flashes_on_ground_and_is_lit_in_flight() {
    let flown = fly(&hover(""), &[]);
    assert_healthy(&flown);
    let state_at = |wanted: ArmState| flown.states.iter().find(|(_, state)| *state == wanted).unwrap().0;
    let armed_s = state_at(ArmState::Armed);
    let on_ground: Vec<_> =
        flown.led.iter().filter(|(at_s, _)| (0.5..armed_s - 1.0).contains(at_s)).collect();
    let flashes: Vec<f64> =
        on_ground.windows(2).filter(|pair| pair[0].1).map(|pair| pair[1].0 - pair[0].0).collect();
    assert!(flashes.len() >= 2, "{:?}", flown.led);
    assert!(flashes.iter().all(|flash_s| (0.048..0.052).contains(flash_s)), "{flashes:?}");
    let lit_s = flown.led.iter().find(|(at_s, lit)| *lit && *at_s >= armed_s - 0.01).unwrap().0;
    let dark_s = flown.led.iter().find(|(at_s, lit)| !lit && *at_s > lit_s).unwrap().0;
    assert!(lit_s < armed_s + 0.01 && dark_s > 12.0, "lit from {lit_s} to {dark_s} s: {}", story(&flown));
}

#[test]
fn attitude_has_the_right_signs_and_axes() {
    // With a wrong sign or axis of the IMU's mounting the vehicle crashes; a wrong mounting of the magnetometer gives a
    // heading error.
    let flown = fly(&scene("steps", Some(26.0)), &[]);
    assert_healthy(&flown);
    assert!(
        flown.outcome.heading_rmse_deg < 1.0 && flown.outcome.inclination_rmse_deg < 1.0,
        "{}",
        story(&flown)
    );
}

#[test]
fn motor_pads_do_not_float_after_start() {
    let flown = fly(&hover(""), &[]);
    let floats = flown.pads_floated_until_ns;
    // The firmware enables the pull-downs a few hundred instructions after the reset.
    assert!(floats < 50_000, "a pad floats until {floats} ns");
    assert!(flown.escs.iter().all(|esc| esc.line() != Line::Floating));
}

#[test]
fn sbus_receiver_is_found_and_flies() {
    let scene = hover("");
    let settings =
        emulator::flight::Settings { receiver: Protocol::Sbus, ..settings(firmware(), &scene, &[]) };
    let flown = emulator::flight::fly(&scene, scene.seed, settings, None).unwrap().0;
    assert_healthy(&flown);
}

#[test]
fn board_without_configuration_refuses_to_arm() {
    let scene = hover("");
    let settings = emulator::flight::Settings { config: None, ..settings(firmware(), &scene, &[]) };
    let flown = emulator::flight::fly(&scene, scene.seed, settings, None).unwrap().0;
    assert!(!flown.armed, "{}", story(&flown));
    assert!(flown.log.iter().any(|line| line.contains("refused: not calibrated")), "{}", story(&flown));
    assert_eq!(flown.outcome.final_state, ArmState::Disarmed);
}

#[test]
fn files_that_are_not_flight_images_are_refused() {
    let elf = firmware().elf();
    let refusal = |elf: Vec<u8>| Firmware::parse(Path::new("x.elf"), elf).unwrap_err().to_string();
    assert!(refusal(b"no ELF".to_vec()).contains("must be an ELF image"));
    // Byte 18 is the machine of the ELF header.
    let mut other = elf.to_vec();
    other[18] = 62;
    assert!(refusal(other).contains("Arm"));
    for length in [10, 40, 60, 1_000, 40_000] {
        refusal(elf[..length].to_vec());
    }
    // Change the image's name to that of a bench image.
    let name = b"speedybee-f405-v4\0";
    let at = elf.windows(name.len()).position(|window| window == name).unwrap();
    let mut bench = elf.to_vec();
    let end = at + name.len() - 1;
    bench[end - 7..end].copy_from_slice(b", bench");
    assert!(refusal(bench).contains("must be the flight image"));
}
