//! The study `sensors`: which effects a scene needs.
//!
//! A scene is flown with all its effects, with each left out, and then with the most telling ones alone, one
//! after the other: how far is the outcome from that of the whole scene, and what does the simulation save?

use super::{Axis, Options, Progress, Setting, Study};
use input::InputError;
use sim_host::flight::Flight;
use sim_host::plan;
use sim_host::scene::Scene;

/// Attitude error over the seeds, ° RMSE.
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
/// None of the built-in scenes that it flies.
pub fn study(options: &Options, progress: Progress) -> Result<Study, InputError> {
    let all = ["windy-landing", "shaky-frame", "magnetic-site"];
    let (scenes, seeds) = if options.quick { (&all[..1], 2) } else { (&all[..], 20) };
    let mut settings = Vec::new();
    for (n, name) in scenes.iter().enumerate() {
        let scene = Scene::load(name)?;
        let whole = outcome(&scene, seeds);
        let effects = scene.effects();
        let at = |done: usize| {
            progress((n as f64 + 0.5 * done as f64 / effects.len() as f64) / scenes.len() as f64)
        };
        let mut shares: Vec<(&'static str, f64)> = Vec::new();
        for effect in &effects {
            if let Some(without) = scene.without(effect) {
                shares.push((effect, outcome(&without, seeds) - whole));
            }
            at(shares.len());
        }
        // The most telling first; equal ones as the scene has them.
        shares.sort_by(|a, b| b.1.abs().total_cmp(&a.1.abs()));
        let costs = if options.timed { plan::measure(&scene) } else { Vec::new() };
        let cost = |effect: &str| -> Option<f64> {
            // A kind of fault may be there more than once.
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
                error: Some((outcome(&fewer, seeds) - whole).abs()),
                error_unit: "° off the whole scene's RMSE",
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
            "Each scene is flown with {seeds} seeds. A row has its effect and those above it; the error is how far the \
             attitude error (RMSE) then is from that of the whole scene. The last column is what leaving out this \
             effect alone changes. No effect moves another's random draws, so that a difference is that effect's."
        ),
        reference: "The same scene with all its effects on the same seeds; each flight is judged on the simulated \
                    truth."
            .into(),
        per: "a step of the simulation",
        axis: Axis::Host,
        axis_title: "time on this machine, ns per step for the effects",
        settings,
        remarks: vec![
            "Effects are added in the order of what each changes when it alone is left out. Two that belong together \
             (a wind and the drag by which it acts, a hard iron and its calibration) may make the error rise until \
             the second is there."
                .into(),
        ],
    })
}
