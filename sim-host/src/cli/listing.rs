//! The command `scenes`.

use std::fmt::Write as _;

use serde_json::json;
use sim_host::input_error::InputError;
use sim_host::scene::{BUILT_IN, Scene};

use super::Answer;

pub fn scenes() -> Result<Answer, InputError> {
    let mut list = Vec::new();
    let mut text = String::new();
    for built_in in BUILT_IN {
        let scene = Scene::parse(built_in.name, built_in.text)?;
        let effects = scene.effects();
        writeln!(text, "{:<14}{}\n{:14}effects: {}", scene.name, scene.description, "", effects.join(", "))
            .expect("a String takes everything");
        list.push(json!({
            "name": scene.name,
            "description": scene.description,
            "duration_s": scene.duration_s,
            "effects": effects,
        }));
    }
    Ok(Answer { json: json!({ "scenes": list }), text, failed: false })
}
