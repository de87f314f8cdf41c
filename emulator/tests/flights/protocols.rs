//! Each ESC protocol, by edges at the pads.

use emulator::firmware::Firmware;
use emulator::flight::Flown;
use emulator::pads::Protocol;

use super::{assert_healthy, hover, settings};

/// Flies the image that is built with `KESTREL_ESC` set so.
#[track_caller]
fn flies_with(name: &str, protocol: Protocol, rate_hz: f64) {
    let firmware = match std::env::var_os("KESTREL_IMAGE") {
        // A mutant's, of this protocol.
        Some(path) => Firmware::read(std::path::Path::new(&path)).unwrap(),
        None => Firmware::build(&[("KESTREL_ESC", name)]).unwrap(),
    };
    let scene = hover("");
    let flown = emulator::flight::fly(&scene, scene.seed, settings(&firmware, &scene, &[]), None).unwrap().0;
    assert_healthy(&flown);
    let seconds = flown.outcome.flown_s();
    for esc in &flown.escs {
        assert_eq!(esc.last().unwrap().protocol, protocol);
        let rate = esc.commands.len() as f64 / seconds;
        assert!((rate / rate_hz - 1.0).abs() < 0.02, "{rate} commands a second");
    }
    every_command_is_one_that_was_given(&flown, protocol);
}

/// Whatever arrives at a pad is what the flight controller had given for that rotor shortly before: nothing in between
/// two commands, and nothing of another rotor.
pub fn every_command_is_one_that_was_given(flown: &Flown, protocol: Protocol) {
    // Counts are 1/21 µs for PWM and 8/84 µs for OneShot125, and edges come at whole ns; DShot has steps of 0.5 µs, and the
    // two scales begin half a step apart.
    let tolerance_us = match protocol {
        Protocol::Pwm => 0.05,
        Protocol::OneShot125 => 0.15,
        _ => 0.8,
    };
    for (esc, pad) in flown.escs.iter().zip(&flown.wiring.pads) {
        let mut strange = 0;
        for command in &esc.commands {
            // A pulse of PWM ends up to 5 ms after its command; the firmware's clock starts some ms after the supply.
            let (from_us, to_us) =
                ((command.at_ns / 1_000).saturating_sub(12_000), command.at_ns / 1_000 + 1_000);
            let first = flown.records.partition_point(|record| record.time_us < from_us);
            let given = flown.records[first..].iter().take_while(|record| record.time_us <= to_us);
            let us = 1_000.0 + 1_000.0 * command.throttle;
            let known = given.map(|record| match record.outcome.driven {
                true => f64::from(record.outcome.pulses_us[pad.rotor]),
                false => 1_000.0,
            });
            if first > 0 && !known.into_iter().any(|known_us| (known_us - us).abs() <= tolerance_us) {
                strange += 1;
            }
        }
        assert_eq!(strange, 0, "{}: of {} commands", pad.name, esc.commands.len());
    }
}

#[test]
fn pwm_flies() {
    flies_with("pwm", Protocol::Pwm, 400.0);
}

#[test]
fn oneshot125_flies() {
    flies_with("oneshot125", Protocol::OneShot125, 1_000.0);
}

#[test]
fn dshot300_flies() {
    flies_with("dshot300", Protocol::DShot300, 1_000.0);
}

#[test]
fn dshot600_flies() {
    flies_with("dshot600", Protocol::DShot600, 1_000.0);
}
