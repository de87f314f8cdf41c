//! Fuzzes an IMU preset, with scenes that each name one effect without values of their own.
//!
//! An accepted preset has converters. Every effect for which it has all values can be flown.
#![no_main]

mod short_flight;

use libfuzzer_sys::{Corpus, fuzz_target};
use sim_host::scene::Scene;

const BARE: &str = "[scene]\nduration_s = 1.0\nseed = 1\nvehicle = \"os4\"\nimu = \"preset.toml\"\n";

fuzz_target!(|preset: &[u8]| -> Corpus {
    let Ok(preset) = std::str::from_utf8(preset) else { return Corpus::Reject };
    let parse = |scene: &str| Scene::parse_with("scene.toml", scene, &|_| Ok(preset.into()));
    let bare = match parse(BARE) {
        Ok(scene) => scene,
        Err(error) => {
            let message = error.to_string();
            assert!(!message.is_empty() && !message.contains('\n'), "{message:?}");
            return Corpus::Keep;
        }
    };
    for converter in bare.converters {
        let per_count = converter.per_count();
        assert!(per_count > 0.0 && per_count.is_finite(), "{per_count}");
    }
    assert!(bare.effects().is_empty(), "a preset names effects");
    for effect in bare.left_out() {
        if let Ok(scene) = parse(&format!("{BARE}[effects.{effect}]\n")) {
            assert_eq!(scene.effects(), [effect]);
            short_flight::fly(&scene, 30);
        }
    }
    Corpus::Keep
});
