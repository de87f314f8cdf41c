//! One flight as a library call: `cargo run --release -p sim-host --example one_flight`
//!
//! A test suite of your own calls the simulator in this way: it reads a scene, flies it with a seed, observes the truth
//! at every step, and asserts what it demands of the flight.

use input::InputError;
use sim_host::flight::{Flight, Observer, Outcome, StepView};
use sim_host::scene::Scene;

/// A scene in your own file would be read by `Scene::load("my-scene.toml")`.
const SCENE: &str = r#"
include = "hover"

[scene]
duration_s = 20.0

[effects.gyro.constant_bias]
bias_deg_s = [0.5, -0.5, 0.2]
"#;

/// Records the greatest height above the ground.
#[derive(Default)]
struct GreatestHeight {
    height_m: f64,
}

impl Observer for GreatestHeight {
    fn step(&mut self, view: &StepView) {
        // World axes are north, east, down.
        self.height_m = self.height_m.max(-view.truth.position.z);
    }
}

fn fly(seed: u64) -> Result<(Outcome, f64), InputError> {
    let scene = Scene::parse("my-scene.toml", SCENE)?;
    let mut greatest = GreatestHeight::default();
    let outcome = Flight::new(&scene, seed).run(&mut greatest);
    Ok((outcome, greatest.height_m))
}

fn main() -> Result<(), InputError> {
    for seed in 1..=3 {
        let (outcome, height_m) = fly(seed)?;
        println!(
            "seed {seed}: {:.3}° of attitude error, {height_m:.2} m high, digest {:016x}",
            outcome.attitude_rmse_deg, outcome.digest
        );
        assert_eq!(outcome.crash, None);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hovers_near_its_target_despite_gyro_bias() {
        let (outcome, height_m) = fly(1).unwrap();
        assert_eq!(outcome.crash, None);
        assert!(outcome.attitude_rmse_deg < 0.5, "{}", outcome.attitude_rmse_deg);
        // The pilot's target is 1.5 m high.
        assert!((1.0..2.5).contains(&height_m), "{height_m}");
    }

    #[test]
    fn same_seed_gives_same_digest() {
        assert_eq!(fly(7).unwrap().0.digest, fly(7).unwrap().0.digest);
        assert_ne!(fly(7).unwrap().0.digest, fly(8).unwrap().0.digest);
    }
}
