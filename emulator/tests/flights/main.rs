//! The flash image flies: every scene that flies, every ESC protocol, and what fails in flight.
//!
//! Every flight is that of `cargo flash-fw`'s image, armed by the pilot, judged on the truth. `KESTREL_IMAGE` names
//! another image to be tried, as the mutants are (`emulator/mutants`).

mod board;
mod boards;
mod command_line;
mod faults;
mod protocols;
mod scenes;
mod vehicles;

use std::path::PathBuf;
use std::sync::{Arc, OnceLock};

use ::board::Board;
use emulator::board::Wiring;
use emulator::faults::Fault;
use emulator::firmware::Firmware;
use emulator::flight::{self, Flown, Settings};
use emulator::rc_receiver::Protocol;
use flight_core::ArmState;
use flight_core::arming::Cause;
use sim_host::scene::Scene;

/// The image under test, built once.
fn firmware() -> &'static Firmware {
    static BUILT: OnceLock<Firmware> = OnceLock::new();
    BUILT.get_or_init(|| match std::env::var_os("KESTREL_IMAGE") {
        Some(path) => Firmware::read(&PathBuf::from(path)).unwrap(),
        None => Firmware::build(&[]).unwrap(),
    })
}

/// A built-in scene, of this length (s).
fn scene(name: &str, duration_s: Option<f64>) -> Scene {
    let mut scene = Scene::load(name).unwrap();
    if let Some(duration_s) = duration_s {
        scene.set_duration(duration_s).unwrap();
    }
    scene
}

/// `hover`, short: up at 5 s, down from 12 s, with these tables on top.
fn hover(tables: &str) -> Scene {
    let mut scene = Scene::parse("altered", &format!("include = \"hover\"\n{tables}")).unwrap();
    scene.set_duration(20.0).unwrap();
    scene
}

/// The default board in the scene's vehicle.
fn wiring(scene: &Scene) -> Arc<Wiring> {
    Arc::new(Wiring::new(Board::load(::board::DEFAULT).unwrap(), &scene.design))
}

fn settings<'a>(firmware: &'a Firmware, scene: &Scene, faults: &[(f64, Fault)]) -> Settings<'a> {
    Settings {
        firmware,
        wiring: wiring(scene),
        receiver: Protocol::Crsf,
        config: Some(scene.board_config()),
        print_log: false,
        after_crash_s: 3.0,
        faults: faults.to_vec(),
        // The mutants' flights: what does not arm by itself need not be flown to the end.
        fail_fast: std::env::var_os("KESTREL_ONCE").is_some() && faults.is_empty(),
    }
}

/// Flies a scene with these faults (at s).
fn fly(scene: &Scene, faults: &[(f64, Fault)]) -> Flown {
    flight::fly(scene, scene.seed, settings(firmware(), scene, faults), None).unwrap().0
}

/// Flies it twice: the same edges at the pads, the same records, the same log. Once with `KESTREL_ONCE`, which the
/// mutants set.
fn fly_twice(scene: &Scene, faults: &[(f64, Fault)]) -> Flown {
    if std::env::var_os("KESTREL_ONCE").is_some() {
        return fly(scene, faults);
    }
    let (first, second) = (fly(scene, faults), fly(scene, faults));
    assert_eq!(first.pads_digest, second.pads_digest, "other edges at the pads");
    assert_eq!(first.outcome.digest, second.outcome.digest, "another flight");
    assert!(first.records == second.records, "other steps");
    assert_eq!(first.log, second.log, "another log");
    first
}

/// What must hold in every flight, whatever fails.
#[track_caller]
fn assert_sound(flown: &Flown) {
    assert_eq!(flown.broken_off, None, "{}", story(flown));
    assert_eq!(flown.gaps, [""; 0], "{}", story(flown));
    assert_eq!(flown.unserved, [""; 0], "{}", story(flown));
}

/// What must hold in a flight in which nothing fails.
#[track_caller]
fn assert_healthy(flown: &Flown) {
    assert_sound(flown);
    let story = story(flown);
    assert!(flown.armed && flown.took_off != Some(false), "{story}");
    assert_eq!((flown.resets.len(), flown.missed_deadlines), (0, 0), "{story}");
    assert_eq!((flown.outcome.crash, flown.outcome.final_state), (None, ArmState::Disarmed), "{story}");
    assert_eq!(flown.escs.iter().map(|esc| esc.garbled).sum::<u64>(), 0, "{story}");
}

/// States in turn after `Armed`: when (s of the flight), which, and why.
fn after_arming(flown: &Flown) -> Vec<(f64, ArmState, Cause)> {
    let events = flown.records.iter().filter_map(|record| {
        Some((record.time_us as f64 * 1e-6, record.outcome.event?)).filter(|(_, event)| !event.is_refusal())
    });
    let mut after = events.skip_while(|(_, event)| event.to != ArmState::Armed);
    after.next();
    after.map(|(at_s, event)| (at_s, event.to, event.cause)).collect()
}

/// The flight in words, for the message of an assertion.
fn story(flown: &Flown) -> String {
    let mut story = format!("{:?}\nresets {:?}\n", flown.outcome, flown.resets);
    for line in flown.log.iter().filter(|line| !line.contains("imu lost")) {
        story += &format!("  {line}\n");
    }
    story
}
