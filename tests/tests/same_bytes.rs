//! The built-in scenes fly the same flight, bit for bit, in every build and on every machine.
//!
//! The digests below come from a release build; this test runs in any build profile. A change of the
//! flight code or of the simulated world changes them. Then `sim-host fly SCENE --json` prints the new ones, and the
//! commit must explain why they changed.

use sim_host::flight::Flight;
use sim_host::scene::{BUILT_IN, Scene};

/// Scenes, and the digest of truth and pulses of every step, at the scene's own seed.
const DIGESTS: [(&str, &str); 13] = [
    ("hover", "8f1265a8d54903b1"),
    ("steps", "80a2d59bcb125610"),
    ("stand-steps", "8f60f81bbab0b1ae"),
    ("static", "d8e4bfed58eb698d"),
    ("windy-landing", "d3ed717adc090adc"),
    ("hot-day", "a041e8901dd77b4f"),
    ("weak-battery", "6b32d1bf500a931d"),
    ("magnetic-site", "0d1b1f9c1c6f68de"),
    ("motor-out", "40e935faa6b43d2e"),
    ("shaky-frame", "7adfd32bd9af71af"),
    ("bad-link", "45d3dccd41c72dc5"),
    ("rough-sampling", "97016dbe4557aa45"),
    ("whole-drive", "8d9d694959ea98bc"),
];

#[test]
fn every_scene_flies_its_recorded_digest() {
    let mut changed = Vec::new();
    for (name, digest) in DIGESTS {
        let scene = Scene::load(name).unwrap();
        let flown = format!("{:016x}", Flight::new(&scene, scene.seed).run(&mut ()).digest);
        if flown != digest {
            changed.push(format!("{name} {flown}"));
        }
    }
    assert!(changed.is_empty(), "changed: {changed:?}");
}

#[test]
fn every_scene_but_bench_static_has_a_digest() {
    let names = DIGESTS.map(|(name, _)| name);
    for scene in BUILT_IN.iter().filter(|scene| scene.name != "bench-static") {
        assert!(names.contains(&scene.name), "{}", scene.name);
    }
}
