//! The other boards, each from its file: pads on other timers, with complementary outputs and on other ports, other pins of
//! the sensors, and how all that is built into a vehicle.

use std::sync::Arc;

use ::board::Board;
use emulator::board::Wiring;
use emulator::faults::Fault;
use emulator::firmware::Firmware;
use emulator::flight::{self, Flown, Settings};
use emulator::pads::Protocol;
use sim_host::scene::Scene;

use super::{assert_healthy, hover, settings};

/// Flies the image that is built for a board, with the ESCs driven so.
fn flies(board: &str, esc: &str, scene: &Scene, faults: &[(f64, Fault)]) -> Flown {
    let firmware = Firmware::build(&[("KESTREL_BOARD", board), ("KESTREL_ESC", esc)]).unwrap();
    let wiring = Arc::new(Wiring::new(Board::load(board).unwrap(), &scene.design));
    let settings = Settings { wiring, ..settings(&firmware, scene, faults) };
    flight::fly(scene, scene.seed, settings, None).unwrap().0
}

#[test]
fn the_mini_flies() {
    let flown = flies("speedybee-f405-mini", "dshot300", &hover(""), &[]);
    assert_healthy(&flown);
    assert!(flown.led.len() > 2, "its LED says something");
}

/// TIM8 and TIM1, which have twice the clock and must be let out; one pad is a complementary output.
#[test]
fn the_matek_flies_with_each_protocol() {
    for (esc, protocol) in
        [("dshot600", Protocol::DShot600), ("oneshot125", Protocol::OneShot125), ("pwm", Protocol::Pwm)]
    {
        let flown = flies("matek-f405-te", esc, &hover(""), &[]);
        assert_healthy(&flown);
        assert!(
            flown.escs.iter().all(|esc| esc.last().is_some_and(|last| last.protocol == protocol)),
            "{esc}"
        );
        super::protocols::every_command_is_one_that_was_given(&flown, protocol);
    }
}

/// Timers of the motors and streams of the inertial sensor have one controller of DMA there.
#[test]
fn a_fault_on_the_matek_stops_the_motors() {
    let flown = flies(
        "matek-f405-te",
        "dshot300",
        &hover(""),
        &[(super::faults::AT_S, Fault::Undefined("EXTI15_10"))],
    );
    super::faults::pads_stop(&flown, 0.002);
}

/// The same board on its side in another vehicle, and the magnetometer upside down.
#[test]
fn a_board_that_is_mounted_otherwise_flies() {
    let scene = hover(
        "[vehicle.mounting]\nboard = [\"right\", \"backward\", \"down\"]\n\
         magnetometer = [\"left\", \"forward\", \"down\"]\n",
    );
    let flown = flies(::board::DEFAULT, "dshot300", &scene, &[]);
    assert_healthy(&flown);
}
