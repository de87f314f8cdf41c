//! The commands `scenes` and `plan`: what there is, and what runs.

use std::fmt::Write as _;

use input::InputError;
use serde_json::json;
use sim_host::plan;
use sim_host::scene::{BUILT_IN, Scene};

use super::{Answer, PlanArguments, load};

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

pub fn plan(arguments: &PlanArguments) -> Result<Answer, InputError> {
    let scene = load(&arguments.scene, arguments.vehicle.as_deref(), None, None)?;
    let costs = plan::measure(&scene);
    // Of the run: what a tolerance adds is not left out.
    let of_run = scene.of_run(scene.seed).0;
    let left_out = of_run.left_out();
    let mut text =
        format!("{}: {}\n\n  in this order               ns per step\n", scene.name, scene.description);
    for cost in &costs {
        writeln!(text, "  {:<28}{:>11.1}", cost.name, cost.ns_per_step).expect("a String takes everything");
    }
    let total: f64 = costs.iter().map(|cost| cost.ns_per_step).sum();
    write!(text, "  {:<28}{total:>11.1}\n\n  left out: {}", "together", left_out.join(", "))
        .expect("a String takes everything");
    let tolerances = scene.tolerances();
    if !tolerances.is_empty() {
        text.push_str("\n\n  drawn once a run");
        for (name, how) in &tolerances {
            write!(text, "\n  {name:<28}{how}").expect("a String takes everything");
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
