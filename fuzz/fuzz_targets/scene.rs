//! Fuzzes a scene, the file that it includes, and its IMU preset: three texts, separated by zero bytes.
//!
//! A refusal is one line. An accepted scene names each effect once, can be flown without any one of them, draws finite
//! vehicles, and flies the same flight twice.
#![no_main]

mod short_flight;

use std::path::Path;

use libfuzzer_sys::{Corpus, fuzz_target};
use sim_host::scene::Scene;

fuzz_target!(|data: &[u8]| -> Corpus {
    let Ok(text) = std::str::from_utf8(data) else { return Corpus::Reject };
    let mut texts = text.splitn(3, '\0');
    let [scene, included, preset] = [(); 3].map(|()| texts.next().unwrap_or(""));
    let read =
        |path: &Path| Ok(if path.ends_with("preset.toml") { preset.into() } else { String::from(included) });
    let scene = match Scene::parse_with("scene.toml", scene, &read) {
        Ok(scene) => scene,
        Err(error) => {
            let message = error.to_string();
            assert!(!message.is_empty() && !message.contains('\n'), "{message:?}");
            return Corpus::Keep;
        }
    };
    let named = scene.effects();
    for effect in &named {
        assert!(!scene.left_out().contains(effect), "{effect} is named and left out");
        let without = scene.without(effect).expect("a scene without one of its effects");
        assert_eq!(without.effects().len() + 1, named.len());
    }
    let (_, drawn) = scene.for_run(scene.seed);
    assert!(drawn.iter().all(|(_, value)| value.is_finite()), "{drawn:?}");
    assert_eq!(short_flight::fly(&scene, 120), short_flight::fly(&scene, 120));
    Corpus::Keep
});
