//! `hil --firmware-log` on QEMU: the firmware's log, decoded, with the time of the flight.
#![cfg(feature = "firmware-log")]

use std::process::{Command, Output};

use serde_json::Value;

fn hover(further: &[&str]) -> (Value, String) {
    let Output { status, stdout, stderr } = Command::new(env!("CARGO_BIN_EXE_sim-host"))
        .args(["hil", "hover", "--duration", "14", "--qemu", "--json"])
        .args(further)
        .output()
        .unwrap();
    let stderr = String::from_utf8(stderr).unwrap();
    assert!(status.success(), "{stderr}");
    (serde_json::from_slice(&stdout).unwrap(), stderr)
}

#[test]
#[ignore = "needs qemu-system-arm, and builds the firmware"]
fn log_covers_the_flight_and_does_not_change_it() {
    let (flown, log) = hover(&["--firmware-log"]);
    let (without, empty) = hover(&[]);
    assert_eq!(empty, "");
    for key in ["digest", "instructions_max", "instructions_mean", "image_sha256"] {
        assert_eq!(flown[key], without[key], "{key}");
    }

    // Time in seconds, level, message.
    let lines: Vec<(f64, &str, &str)> = log
        .lines()
        .map(|line| {
            let (time, rest) = line.trim_start().split_once(' ').unwrap();
            let (level, message) = rest.split_once(' ').unwrap();
            (time.parse().unwrap_or_else(|_| panic!("{line}")), level, message.trim_start())
        })
        .collect();
    assert!(lines.is_sorted_by_key(|&(time, ..)| time), "{log}");
    let (time, level, message) = lines[0];
    assert_eq!((time, level), (0.0, "info"), "{log}");
    assert!(message.starts_with("kestrel ") && message.ends_with("on QEMU netduinoplus2, reset by power"));
    // The health line is logged once a second, also at the start.
    assert_eq!(lines.iter().filter(|(.., message)| message.starts_with("imu lost 0 ")).count(), 14, "{log}");
    let at = |wanted: &str| lines.iter().find(|(.., message)| *message == wanted).map(|&(time, ..)| time);
    // The gesture of the pilot is complete after 4 s, and the checks take 0.5 s.
    let (arming, armed) = (at("Disarmed -> Arming: by the pilot"), at("Arming -> Armed: checks passed"));
    assert_eq!(arming.map(|time| (time * 1e3).round()), Some(4_001.0), "{log}");
    assert_eq!(armed.map(|time| (time * 1e3).round()), Some(4_501.0), "{log}");
}
