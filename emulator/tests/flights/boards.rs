//! The other boards, each from its file: pads on other timers and ports and with complementary outputs, other pins of the
//! sensors, and other mountings in the vehicle.

use std::sync::Arc;

use ::board::Board;
use emulator::board::Wiring;
use emulator::faults::Fault;
use emulator::firmware::Firmware;
use emulator::flight::{self, Flown, Settings};
use emulator::pads::Protocol;
use sim_host::scene::Scene;

use super::{assert_healthy, hover, settings};

/// Builds the image for a board and an ESC protocol, and flies a scene with it.
fn fly_board(board: &str, esc: &str, scene: &Scene, faults: &[(f64, Fault)]) -> Flown {
    let firmware = Firmware::build(&[("KESTREL_BOARD", board), ("KESTREL_ESC", esc)]).unwrap();
    let wiring = Arc::new(Wiring::new(Board::load(board).unwrap(), &scene.design));
    let settings = Settings { wiring, ..settings(&firmware, scene, faults) };
    flight::fly(scene, scene.seed, settings, None).unwrap().0
}

#[test]
fn speedybee_mini_flies() {
    let flown = fly_board("speedybee-f405-mini", "dshot300", &hover(""), &[]);
    assert_healthy(&flown);
    assert!(flown.led.len() > 2, "the LED must change");
}

/// The Matek's pads use TIM8 and TIM1, which have twice the clock and need their main output enabled; one pad is a complementary
/// output.
#[test]
fn matek_flies_with_each_esc_protocol() {
    for (esc, protocol) in
        [("dshot600", Protocol::DShot600), ("oneshot125", Protocol::OneShot125), ("pwm", Protocol::Pwm)]
    {
        let flown = fly_board("matek-f405-te", esc, &hover(""), &[]);
        assert_healthy(&flown);
        assert!(
            flown.escs.iter().all(|esc| esc.last().is_some_and(|last| last.protocol == protocol)),
            "{esc}"
        );
        super::protocols::assert_commands_match_records(&flown, protocol);
    }
}

/// On this board the motor timers and the IMU use the same DMA controller.
#[test]
fn fault_on_matek_stops_the_motors() {
    let flown = fly_board(
        "matek-f405-te",
        "dshot300",
        &hover(""),
        &[(super::faults::AT_S, Fault::Undefined("EXTI15_10"))],
    );
    super::faults::pads_stop(&flown, 0.002);
}

/// The default board is rotated by 90° to the right, and the magnetometer by 90° to the left.
#[test]
fn board_with_another_mounting_flies() {
    let scene = hover(
        "[vehicle.mounting]\nboard = [\"right\", \"backward\", \"down\"]\n\
         magnetometer = [\"left\", \"forward\", \"down\"]\n",
    );
    let flown = fly_board(::board::DEFAULT, "dshot300", &scene, &[]);
    assert_healthy(&flown);
}
