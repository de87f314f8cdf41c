//! The ESC protocols, decoded from the edges at the pads.

use emulator::firmware::Firmware;
use emulator::flight::Flown;
use emulator::pads::Protocol;

use super::{assert_healthy, hover, settings};

/// Flies the image for an ESC protocol, and checks protocol, rate and values of the commands.
#[track_caller]
fn fly_with_protocol(name: &str, protocol: Protocol, rate_hz: f64) {
    let firmware = match std::env::var_os("KESTREL_IMAGE") {
        // The image of a mutant, built for this protocol.
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
    assert_commands_match_records(&flown, protocol);
}

/// Checks that each command at a pad equals a recent output of the flight controller for that rotor. Other values, such as a
/// mix of two outputs or the output for another rotor, are errors.
pub fn assert_commands_match_records(flown: &Flown, protocol: Protocol) {
    // A count of the timer is 1/21 µs for PWM and 8/84 µs for OneShot125, and edges are at whole ns. DShot has steps of
    // 0.5 µs, and the two scales begin half a step apart.
    let tolerance_us = match protocol {
        Protocol::Pwm => 0.05,
        Protocol::OneShot125 => 0.15,
        _ => 0.8,
    };
    for (esc, pad) in flown.escs.iter().zip(&flown.wiring.pads) {
        let mut unknown = 0;
        for command in &esc.commands {
            // A pulse of PWM ends up to 5 ms after its command. The firmware's clock starts a few ms after power-on.
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
                unknown += 1;
            }
        }
        assert_eq!(unknown, 0, "{}: of {} commands", pad.name, esc.commands.len());
    }
}

#[test]
fn pwm_flies() {
    fly_with_protocol("pwm", Protocol::Pwm, 400.0);
}

#[test]
fn oneshot125_flies() {
    fly_with_protocol("oneshot125", Protocol::OneShot125, 1_000.0);
}

#[test]
fn dshot300_flies() {
    fly_with_protocol("dshot300", Protocol::DShot300, 1_000.0);
}

#[test]
fn dshot600_flies() {
    fly_with_protocol("dshot600", Protocol::DShot600, 1_000.0);
}
