//! The built-in scenes fly the same flight, bit for bit, in every build and on every machine.
//!
//! The digests below were printed by a release build; this test runs in whatever profile it is built in. A
//! change to what flies or to the world moves them: then `sim-host fly SCENE --json` prints the new ones, and
//! the change says why they moved.

use sim_host::flight::Flight;
use sim_host::scene::{BUILT_IN, Scene};

/// Hash of the truth and the pulses of every step, at the scene's own seed.
const DIGESTS: [(&str, &str); 13] = [
    ("hover", "bce7513b39338e40"),
    ("steps", "7e7d4b1a74caf7fc"),
    ("stand-steps", "e1befd1555c792b2"),
    ("static", "d8e4bfed58eb698d"),
    ("windy-landing", "f57c5cd3a9f0784f"),
    ("hot-day", "ffa4af92afe526c6"),
    ("weak-battery", "f8a262342b4fe609"),
    ("magnetic-site", "7961697100dd709f"),
    ("motor-out", "a94d9f36a9c39874"),
    ("shaky-frame", "f33c4beea465a027"),
    ("bad-link", "4d119ee79270a104"),
    ("rough-sampling", "14495cce2b397d85"),
    ("whole-drive", "2b7f05616d79a981"),
];

#[test]
fn every_scene_flies_the_flight_that_was_written_down() {
    let mut moved = Vec::new();
    for (name, digest) in DIGESTS {
        let scene = Scene::load(name).unwrap();
        let flown = format!("{:016x}", Flight::new(&scene, scene.seed).run(&mut ()).digest);
        if flown != digest {
            moved.push(format!("{name} {flown}"));
        }
    }
    assert!(moved.is_empty(), "moved: {moved:?}");
}

#[test]
fn every_scene_but_the_hour_on_the_bench_is_written_down() {
    let names = DIGESTS.map(|(name, _)| name);
    for scene in BUILT_IN.iter().filter(|scene| scene.name != "bench-static") {
        assert!(names.contains(&scene.name), "{}", scene.name);
    }
}
