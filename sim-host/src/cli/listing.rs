//! The commands `scenes`, which lists the built-in scenes, and `plan`, which shows the effects of one.

use std::fmt::Write as _;

use input::InputError;
use serde_json::json;
use sim_host::plan;
use sim_host::scene::{BUILT_IN, Scene};

use super::{Answer, PlanArguments, heading, load};

pub fn scenes() -> Result<Answer, InputError> {
    let mut list = Vec::new();
    let mut text = String::new();
    let width = BUILT_IN.iter().map(|scene| scene.name.len()).max().unwrap_or(0) + 2;
    for built_in in BUILT_IN {
        let scene = Scene::parse(built_in.name, built_in.text)?;
        let effects = scene.effects();
        let (name, description) = (&scene.name, &scene.description);
        writeln!(text, "{name:<width$}{description}\n{:width$}effects: {}", "", effects.join(", "))
            .expect("writing to a String does not fail");
        list.push(json!({
            "name": scene.name,
            "description": scene.description,
            "duration_s": scene.duration_s,
            "effects": effects,
        }));
    }
    Ok(Answer { json: json!({ "scenes": list }), text, failed: false })
}

pub fn plan(arguments: &PlanArguments) -> Result<Answer, InputError> {
    let scene = load(&arguments.scene, arguments.vehicle.as_deref(), None, None)?;
    let costs = plan::measure(&scene);
    // The scene of the run with this seed: it includes the effects that tolerances add.
    let run_scene = scene.for_run(scene.seed).0;
    let left_out = run_scene.left_out();
    let mut text = format!(
        "{}\n\n  effects, in this order      ns per step\n",
        heading(&scene.name, &scene.description)
    );
    for cost in &costs {
        writeln!(text, "  {:<28}{:>11.1}", cost.name, cost.ns_per_step)
            .expect("writing to a String does not fail");
    }
    let total: f64 = costs.iter().map(|cost| cost.ns_per_step).sum();
    write!(text, "  {:<28}{total:>11.1}\n\n  left out: {}", "total", left_out.join(", "))
        .expect("writing to a String does not fail");
    let tolerances = scene.tolerances();
    if !tolerances.is_empty() {
        text.push_str("\n\n  drawn once for each run");
        for (name, how) in &tolerances {
            write!(text, "\n  {name:<28}{how}").expect("writing to a String does not fail");
        }
    }
    let tolerances: Vec<_> =
        tolerances.iter().map(|(name, how)| json!({ "name": name, "drawn": how })).collect();
    let effects: Vec<_> =
        costs.iter().map(|cost| json!({ "name": cost.name, "ns_per_step": cost.ns_per_step })).collect();
    Ok(Answer {
        json: json!({ "effects": effects, "left_out": left_out, "tolerances": tolerances }),
        text,
        failed: false,
    })
}
