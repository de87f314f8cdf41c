//! Benchmarks of the simulator's throughput: `cargo bench -p sim-host`. Items are control steps, samples, updates,
//! draws.

use divan::counter::ItemsCount;
use divan::{Bencher, black_box};
use flight_core::estimator::{Estimator, EstimatorParams};
use flight_core::geometry::vec3;
use random::NormalStream;
use sim_host::flight::Flight;
use sim_host::scene::Scene;
use sim_host::sense;

fn main() {
    divan::main();
}

/// Flies a scene to its end: 1 kHz control, RK4, all sensors.
#[divan::bench(args = ["hover", "steps", "stand-steps"])]
fn fly(bencher: Bencher, name: &str) {
    let scene = Scene::load(name).expect("a built-in scene");
    let steps = Flight::new(&scene, scene.seed).run(&mut ()).control_steps;
    bencher.counter(ItemsCount::new(steps)).bench(|| Flight::new(black_box(&scene), scene.seed).run(&mut ()));
}

/// A scene with all effects.
const EVERY_EFFECT: &str = include_str!("every_effect.toml");

fn every_effect() -> Scene {
    let scene = Scene::parse("every_effect.toml", EVERY_EFFECT).expect("a valid scene");
    assert!(scene.left_out().is_empty(), "add to every_effect.toml: {:?}", scene.left_out());
    scene
}

/// Flies a scene with all effects to its end.
#[divan::bench]
fn fly_with_every_effect(bencher: Bencher) {
    let scene = every_effect();
    let steps = Flight::new(&scene, scene.seed).run(&mut ()).control_steps;
    bencher.counter(ItemsCount::new(steps)).bench(|| Flight::new(black_box(&scene), scene.seed).run(&mut ()));
}

/// Generates samples of nine sensor axes on the bench.
#[divan::bench]
fn sense_static(bencher: Bencher) {
    let scene = Scene::load("static").expect("a built-in scene");
    let samples = sense::run(&scene, scene.seed, 1000, None).expect("nothing is written");
    bencher.counter(ItemsCount::new(samples)).bench(|| sense::run(black_box(&scene), scene.seed, 1000, None));
}

/// Returns [`every_effect`] on the bench: without a pilot only the sensors are simulated.
fn every_sensor_effect() -> Scene {
    let mut scene = every_effect();
    scene.pilot = None;
    scene
}

/// Generates samples of nine sensor axes with all sensor effects.
#[divan::bench]
fn sense_with_every_effect(bencher: Bencher) {
    let scene = every_sensor_effect();
    let samples = sense::run(&scene, scene.seed, 1000, None).expect("nothing is written");
    bencher.counter(ItemsCount::new(samples)).bench(|| sense::run(black_box(&scene), scene.seed, 1000, None));
}

/// Does one 9-axis update of an estimator.
#[divan::bench(args = EstimatorParams::PRESETS.map(|preset| preset.0))]
fn estimator(bencher: Bencher, name: &str) {
    let (_, params) = EstimatorParams::PRESETS.into_iter().find(|p| p.0 == name).expect("a preset");
    let mut estimator = Estimator::new(&params).expect("presets are valid");
    let (gyro, accel, mag) = (vec3(0.1, -0.2, 0.3), vec3(0.5, -0.3, -9.7), Some(vec3(25.0, 3.0, 41.0)));
    bencher.counter(ItemsCount::new(1_u32)).bench_local(|| {
        estimator.update(black_box(gyro), black_box(accel), black_box(mag), 1e-3);
    });
}

/// Takes one draw from the normal distribution.
#[divan::bench]
fn normal(bencher: Bencher) {
    let mut stream = NormalStream::new(1, "bench", 0);
    bencher.counter(ItemsCount::new(1_u32)).bench_local(|| stream.draw());
}
