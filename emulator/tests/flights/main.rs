//! Flights of the flash image: all scenes with a pilot, all ESC protocols, and faults in flight.
//!
//! The image is that of `cargo flash-fw`; the pilot arms it, and the truth decides the outcome. `KESTREL_IMAGE` names
//! another image to test: `emulator/mutants` uses it.

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

/// Returns the image under test, which is built once.
fn firmware() -> &'static Firmware {
    static BUILT: OnceLock<Firmware> = OnceLock::new();
    BUILT.get_or_init(|| match std::env::var_os("KESTREL_IMAGE") {
        Some(path) => Firmware::read(&PathBuf::from(path)).unwrap(),
        None => Firmware::build(&[]).unwrap(),
    })
}

/// Returns a built-in scene, with this duration (s) if one is given.
fn scene(name: &str, duration_s: Option<f64>) -> Scene {
    let mut scene = Scene::load(name).unwrap();
    if let Some(duration_s) = duration_s {
        scene.set_duration(duration_s).unwrap();
    }
    scene
}

/// Returns the scene `hover`, shortened, with additional tables: it takes off at 5 s and descends from 12 s on.
fn hover(tables: &str) -> Scene {
    let mut scene = Scene::parse("altered", &format!("include = \"hover\"\n{tables}")).unwrap();
    scene.set_duration(20.0).unwrap();
    scene
}

/// Returns the wiring of the default board in the scene's vehicle.
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
        // For mutants: a flight that can no longer succeed ends early.
        fail_fast: std::env::var_os("KESTREL_ONCE").is_some() && faults.is_empty(),
    }
}

/// Flies a scene with these faults, each with its time, s.
fn fly(scene: &Scene, faults: &[(f64, Fault)]) -> Flown {
    flight::fly(scene, scene.seed, settings(firmware(), scene, faults), None).unwrap().0
}

/// Flies a scene twice, and checks that edges at the pads, records and log are equal. With `KESTREL_ONCE`, which
/// `emulator/mutants` sets, it flies only once.
fn fly_twice(scene: &Scene, faults: &[(f64, Fault)]) -> Flown {
    if std::env::var_os("KESTREL_ONCE").is_some() {
        return fly(scene, faults);
    }
    let (first, second) = (fly(scene, faults), fly(scene, faults));
    assert_eq!(first.pads_digest, second.pads_digest, "the edges at the pads differ");
    assert_eq!(first.outcome.digest, second.outcome.digest, "the flights differ");
    assert!(first.records == second.records, "the step records differ");
    assert_eq!(first.log, second.log, "the logs differ");
    first
}

/// Checks what must hold in every flight, also with faults.
#[track_caller]
fn assert_sound(flown: &Flown) {
    assert_eq!(flown.aborted, None, "{}", story(flown));
    assert_eq!(flown.gaps, [""; 0], "{}", story(flown));
    assert_eq!(flown.unserved, [""; 0], "{}", story(flown));
}

/// Checks what must hold in a flight without faults.
#[track_caller]
fn assert_healthy(flown: &Flown) {
    assert_sound(flown);
    let story = story(flown);
    assert!(flown.armed && flown.took_off != Some(false), "{story}");
    assert_eq!((flown.resets.len(), flown.missed_deadlines), (0, 0), "{story}");
    assert_eq!((flown.outcome.crash, flown.outcome.final_state), (None, ArmState::Disarmed), "{story}");
    assert_eq!(flown.escs.iter().map(|esc| esc.invalid).sum::<u64>(), 0, "{story}");
}

/// Returns the arm states after `Armed`, each with its time (s) and its cause.
fn after_arming(flown: &Flown) -> Vec<(f64, ArmState, Cause)> {
    let events = flown.records.iter().filter_map(|record| {
        Some((record.time_us as f64 * 1e-6, record.outcome.event?)).filter(|(_, event)| !event.is_refusal())
    });
    let mut after = events.skip_while(|(_, event)| event.to != ArmState::Armed);
    after.next();
    after.map(|(at_s, event)| (at_s, event.to, event.cause)).collect()
}

/// Describes a flight, for the message of an assertion.
fn story(flown: &Flown) -> String {
    let mut story = format!("{:?}\nresets {:?}\n", flown.outcome, flown.resets);
    for line in flown.log.iter().filter(|line| !line.contains("imu lost")) {
        story += &format!("  {line}\n");
    }
    story
}
