//! Each ESC protocol, by edges at the pads.

use emulator::firmware::Firmware;
use emulator::pads::Protocol;

use super::{assert_healthy, hover, settings};

/// Flies the image that is built with `KESTREL_ESC` set so.
#[track_caller]
fn flies_with(name: &str, protocol: Protocol, rate_hz: f64) {
    let firmware = Firmware::build_with_esc(Some(name)).unwrap();
    let scene = hover("");
    let flown = emulator::flight::fly(&scene, scene.seed, settings(&firmware, &scene, &[]), None).unwrap().0;
    assert_healthy(&flown);
    let seconds = flown.outcome.flown_s();
    for esc in &flown.escs {
        assert_eq!(esc.last().unwrap().protocol, protocol);
        let rate = esc.commands_ns.len() as f64 / seconds;
        assert!((rate / rate_hz - 1.0).abs() < 0.02, "{rate} commands a second");
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
