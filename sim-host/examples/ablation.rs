//! Measures the influence of each effect of a scene:
//! `cargo run --release -p sim-host --example ablation -- SCENE…`
//!
//! Flies every scene with all its effects, then without each of them, with the same seeds, and prints a table in
//! Markdown. The errors are against the truth.

use sim_host::flight::{Flight, Outcome};
use sim_host::scene::Scene;

/// Seeds per row.
const SEEDS: u64 = 20;

/// Results over all seeds: RMS of the attitude error, and the worst of the other values.
struct Summary {
    attitude_rmse_deg: f64,
    tilt_error_max_deg: f64,
    position_error_max_m: f64,
    crashes: usize,
}

fn fly(scene: &Scene) -> Summary {
    let outcomes: Vec<Outcome> = (0..SEEDS).map(|seed| Flight::new(scene, seed).run(&mut ())).collect();
    let squares: f64 = outcomes.iter().map(|o| o.attitude_rmse_deg * o.attitude_rmse_deg).sum();
    let worst = |what: fn(&Outcome) -> f64| outcomes.iter().map(what).fold(0.0, f64::max);
    Summary {
        attitude_rmse_deg: libm::sqrt(squares / SEEDS as f64),
        tilt_error_max_deg: worst(|o| o.tilt_error_max_deg),
        position_error_max_m: worst(|o| o.position_error_max_m),
        crashes: outcomes.iter().filter(|o| o.crash.is_some()).count(),
    }
}

fn row(what: &str, s: &Summary) {
    println!(
        "| {what} | {:.3} | {:.2} | {:.2} | {} |",
        s.attitude_rmse_deg, s.tilt_error_max_deg, s.position_error_max_m, s.crashes
    );
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    for name in std::env::args().skip(1) {
        let scene = Scene::load(&name)?;
        println!("\n`{name}`, {SEEDS} seeds\n");
        println!("| left out | attitude error, ° RMSE | worst tilt error, ° | worst distance, m | crashes |");
        println!("|---|---|---|---|---|");
        row("nothing", &fly(&scene));
        for effect in scene.effects() {
            if let Some(without) = scene.without(effect) {
                row(&format!("`{effect}`"), &fly(&without));
            }
        }
    }
    Ok(())
}
