//! The built-in scenes fly the same flight, bit for bit, in every build and on every machine.
//!
//! The digests below were printed by a release build; this test runs in whatever profile it is built in. A
//! change to what flies or to the world moves them: then `sim-host fly SCENE --json` prints the new ones, and
//! the change says why they moved.

use sim_host::flight::Flight;
use sim_host::scene::{BUILT_IN, Scene};

/// Hash of the truth and the pulses of every step, at the scene's own seed.
const DIGESTS: [(&str, &str); 13] = [
    ("hover", "0220e95ebf3d88c6"),
    ("steps", "7ea91827d9e376b7"),
    ("stand-steps", "9d14a596bff6c8dc"),
    ("static", "d8e4bfed58eb698d"),
    ("windy-landing", "114e2662204f6e59"),
    ("hot-day", "2fa498d640b8815d"),
    ("weak-battery", "c359169bb6f36265"),
    ("magnetic-site", "c1e3ee6a9310e3d1"),
    ("motor-out", "1f5c4f5463b298e1"),
    ("shaky-frame", "b350b6962c92b061"),
    ("bad-link", "6e464b9d264a77b2"),
    ("rough-sampling", "139657224a859e54"),
    ("whole-drive", "24676c98ead619b1"),
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
