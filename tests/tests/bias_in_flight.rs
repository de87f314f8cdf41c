//! The estimator `robust` in flight with an inaccurate gyroscope: it is zeroed at rest from an unknown turn-on bias,
//! and then the bias steps in flight. The tilt error is compared with the truth in every step.

use sim_host::flight::{Flight, Observer, StepView};
use sim_host::scene::Scene;

/// Turn-on bias, °/s; its norm is √(2² + 2² + 1²) = 3 °/s.
const TURN_ON_DEG_S: [f64; 3] = [2.0, -2.0, 1.0];
const SEEDS: u64 = 5;
/// Largest allowed tilt error at any time, degrees.
const LIMIT_DEG: f64 = 2.0;

/// The largest angle between estimated and true vertical, degrees, and its time, s.
#[derive(Clone, Copy, Debug, Default)]
struct Worst {
    tilt_error_deg: f64,
    at_s: f64,
}

impl Observer for Worst {
    fn step(&mut self, view: &StepView) {
        let (estimate, truth) = (view.estimate.down(), view.truth.attitude.down());
        // From the cross product as well, because the arc cosine is inaccurate for small angles.
        let error = libm::atan2(estimate.cross(truth).norm(), estimate.dot(truth)).to_degrees();
        if error > self.tilt_error_deg {
            *self = Self { tilt_error_deg: error, at_s: view.time_us as f64 * 1e-6 };
        }
    }
}

/// Returns a built-in scene, which has 5 s of rest and linear drag, with these biases.
fn scene(name: &str, estimator: &str, step_at_s: f64, step_deg_s: [f64; 3]) -> Scene {
    let text = format!(
        "include = \"{name}\"\n[flight]\nestimator = \"{estimator}\"\n\
         [effects.gyro.constant_bias]\nbias_deg_s = {TURN_ON_DEG_S:?}\n\
         [effects.gyro.bias_step]\nat_s = {step_at_s:?}\nbias_deg_s = {step_deg_s:?}\n"
    );
    let scene = Scene::parse(name, &text).unwrap();
    assert!(scene.effects().contains(&"vehicle.linear_drag"));
    scene
}

fn worst(scene: &Scene, seed: u64) -> Worst {
    let mut worst = Worst::default();
    let outcome = Flight::new(scene, seed).run(&mut worst);
    assert_eq!(outcome.crash, None, "seed {seed}: {outcome:?}");
    // The flight's own statistics agree.
    assert!((outcome.tilt_error_max_deg - worst.tilt_error_deg).abs() < 1e-3, "{outcome:?} {worst:?}");
    worst
}

/// Bias steps of 0.2 °/s: about each axis, and about two horizontal or tilted axes between them.
const STEPS_DEG_S: [[f64; 3]; 5] =
    [[0.2, 0.0, 0.0], [0.0, -0.2, 0.0], [0.0, 0.0, 0.2], [0.141, 0.141, 0.0], [-0.141, 0.0, 0.141]];

#[test]
fn robust_keeps_tilt_error_within_2_deg_after_bias_steps() {
    for name in ["hover", "steps"] {
        let mut worst_of_all = Worst::default();
        // The bias steps before, between and during the doublets of the scene `steps`, which are at 14 s and 19
        // s. A tilt error takes 12 s to its peak.
        for step_at_s in [6.0, 8.0, 12.0, 16.0] {
            for step in STEPS_DEG_S {
                let scene = scene(name, "robust", step_at_s, step);
                for seed in 0..SEEDS {
                    let worst = worst(&scene, seed);
                    assert!(
                        worst.tilt_error_deg <= LIMIT_DEG,
                        "{name}, {step:?} at {step_at_s} s, seed {seed}: {worst:?}"
                    );
                    if worst.tilt_error_deg > worst_of_all.tilt_error_deg {
                        worst_of_all = worst;
                    }
                }
            }
        }
        println!("{name}: {} deg at {} s", worst_of_all.tilt_error_deg, worst_of_all.at_s);
    }
}

#[test]
fn flight_exceeds_2_deg_tilt_error_after_a_bias_step() {
    let scene = scene("steps", "flight", 6.0, [0.141, 0.141, 0.0]);
    let worst = worst(&scene, 0);
    println!("{} deg at {} s", worst.tilt_error_deg, worst.at_s);
    assert!(worst.tilt_error_deg > LIMIT_DEG, "{worst:?}");
}
