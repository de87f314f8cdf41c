//! The study `sensors`: which effects a scene needs.
//!
//! A scene is flown with all its effects, with each one left out, and with only the most influential ones, added one
//! after the other. The error is how far the outcome is from that of the complete scene; the cost is simulation time.

use super::{Axis, Options, Progress, Setting, Study};
use input::InputError;
use sim_host::flight::Flight;
use sim_host::plan;
use sim_host::scene::Scene;

/// Returns the attitude error over the seeds, ° RMSE.
fn outcome(scene: &Scene, seeds: u64) -> f64 {
    let squares: f64 = (0..seeds)
        .map(|seed| Flight::new(scene, seed).run(&mut ()).attitude_rmse_deg)
        .map(|error| error * error)
        .sum();
    libm::sqrt(squares / seeds as f64)
}

/// Runs the study.
///
/// # Errors
/// A built-in scene cannot be read; this does not happen.
pub fn study(options: &Options, progress: Progress) -> Result<Study, InputError> {
    let all = ["windy-landing", "shaky-frame", "magnetic-site"];
    let (scenes, seeds) = if options.quick { (&all[..1], 2) } else { (&all[..], 20) };
    let mut settings = Vec::new();
    for (n, name) in scenes.iter().enumerate() {
        let scene = Scene::load(name)?;
        let complete = outcome(&scene, seeds);
        let effects = scene.effects();
        let at = |done: usize| {
            progress((n as f64 + 0.5 * done as f64 / effects.len() as f64) / scenes.len() as f64)
        };
        let mut shares: Vec<(&'static str, f64)> = Vec::new();
        for effect in &effects {
            if let Some(without) = scene.without(effect) {
                shares.push((effect, outcome(&without, seeds) - complete));
            }
            at(shares.len());
        }
        // The most influential first; equal ones in the scene's order.
        shares.sort_by(|a, b| b.1.abs().total_cmp(&a.1.abs()));
        let costs = if options.timed { plan::measure(&scene) } else { Vec::new() };
        let cost = |effect: &str| -> Option<f64> {
            // A kind of fault may occur more than once.
            let of = costs.iter().filter(|cost| cost.name == effect).map(|cost| cost.ns_per_step);
            options.timed.then(|| of.sum())
        };
        let mut total = options.timed.then_some(0.0);
        for kept in 0..=shares.len() {
            let mut fewer = scene.clone();
            for (effect, _) in &shares[kept..] {
                fewer = fewer.without(effect).unwrap_or(fewer);
            }
            let added = kept.checked_sub(1).map(|last| shares[last]);
            let own = added.and_then(|(effect, _)| cost(effect));
            total = total.map(|total| total + own.unwrap_or(0.0));
            settings.push(Setting {
                problem: name,
                series: (*name).into(),
                setting: added.map_or("no effect".into(), |(effect, _)| format!("+ {effect}")),
                error: Some((outcome(&fewer, seeds) - complete).abs()),
                error_unit: "° from the RMSE with all effects",
                host_ns: total,
                host_ns_added: own,
                also: added.map(|(_, share)| ("change_if_left_out_deg", share)).into_iter().collect(),
                default: kept == shares.len(),
                ..Setting::default()
            });
            at(shares.len() + kept);
        }
    }
    Ok(Study {
        name: "sensors",
        title: "Which effects a scene needs",
        about: format!(
            "Each scene is flown with {seeds} seeds. A row has its own effect and those of the rows above. The error is the \
             difference of the attitude error (RMSE) from that of the scene with all effects. The last column is the change when \
             this effect alone is left out. No effect alters another effect's random draws, so each difference belongs to its effect."
        ),
        reference: "The same scene with all its effects, on the same seeds. Each flight is judged on the simulated \
                    truth."
            .into(),
        per: "a step of the simulation",
        axis: Axis::Host,
        axis_title: "time on this machine, ns per step for the effects",
        settings,
        remarks: vec![
            "Effects are added in the order of the change that each causes when it alone is left out. Two effects that belong \
             together (a wind and the drag by which it acts, hard iron and its calibration) may make the error rise until the \
             second one is added."
                .into(),
        ],
    })
}
