//! The built-in scenes fly the same flight, bit for bit, in every build and on every machine.
//!
//! The digests below were printed by a release build; this test runs in whatever profile it is built in. A
//! change to what flies or to the world moves them: then `sim-host fly SCENE --json` prints the new ones, and
//! the change says why they moved.

use sim_host::flight::Flight;
use sim_host::scene::{BUILT_IN, Scene};

/// Hash of the truth and the pulses of every step, at the scene's own seed.
const DIGESTS: [(&str, &str); 13] = [
    ("hover", "cce2992cba476ef8"),
    ("steps", "409d5c8148d98bb6"),
    ("stand-steps", "9b841f05fb2bddbb"),
    ("static", "d8e4bfed58eb698d"),
    ("windy-landing", "0b30eb8380525be1"),
    ("hot-day", "a70dcd4f83ece4e2"),
    ("weak-battery", "91c655f9553c561a"),
    ("magnetic-site", "2aac3f1193eabd9d"),
    ("motor-out", "5a45e4f954670ba7"),
    ("shaky-frame", "a4780208c330e681"),
    ("bad-link", "1c0a02a5d4005ff6"),
    ("rough-sampling", "2e47740f6862d0d1"),
    ("whole-drive", "1e84da4f3c4556e1"),
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
