//! How fast the simulator is: `cargo bench -p sim-host`. Items are control steps, samples, updates, draws.

use divan::counter::ItemsCount;
use divan::{Bencher, black_box};
use flight_core::estimator::{Estimator, EstimatorParams};
use flight_core::geometry::vec3;
use sim_host::flight::Flight;
use sim_host::random::NormalStream;
use sim_host::scene::Scene;
use sim_host::sense;

fn main() {
    divan::main();
}

/// A whole flight: 1 kHz control, RK4, all sensors.
#[divan::bench(args = ["hover", "steps", "stand-steps"])]
fn fly(bencher: Bencher, name: &str) {
    let scene = Scene::load(name).expect("a built-in scene");
    let steps = Flight::new(&scene, scene.seed).run(&mut ()).control_steps;
    bencher.counter(ItemsCount::new(steps)).bench(|| Flight::new(black_box(&scene), scene.seed).run(&mut ()));
}

/// Nine axes of sensor samples on the bench.
#[divan::bench]
fn sense_static(bencher: Bencher) {
    let scene = Scene::load("static").expect("a built-in scene");
    let samples = sense::run(&scene, scene.seed, 1000, None).expect("nothing is written");
    bencher.counter(ItemsCount::new(samples)).bench(|| sense::run(black_box(&scene), scene.seed, 1000, None));
}

/// Everything that gyroscope, accelerometer and magnetometer can do wrong, with the rotors of the scene.
const ALL_SENSOR_EFFECTS: &str = include_str!("all_sensor_effects.toml");

/// The same with every sensor effect.
#[divan::bench]
fn sense_with_every_effect(bencher: Bencher) {
    let scene = Scene::parse("all_sensor_effects.toml", ALL_SENSOR_EFFECTS).expect("a valid scene");
    let samples = sense::run(&scene, scene.seed, 1000, None).expect("nothing is written");
    bencher.counter(ItemsCount::new(samples)).bench(|| sense::run(black_box(&scene), scene.seed, 1000, None));
}

/// Nine axes with one effect at a time of [`ALL_SENSOR_EFFECTS`]: its cost is the difference to none.
#[divan::bench(args = names_of_sensor_effects())]
fn sense_with_one_effect(bencher: Bencher, name: &str) {
    let mut alone: toml::Table = ALL_SENSOR_EFFECTS.parse().expect("valid TOML");
    let effects = alone["effects"].as_table_mut().expect("a table");
    for (sensor, table) in effects.iter_mut() {
        table.as_table_mut().expect("a table").retain(|effect, _| format!("{sensor}.{effect}") == name);
    }
    let scene = Scene::parse("alone", &alone.to_string()).expect("a valid scene");
    let samples = sense::run(&scene, scene.seed, 1000, None).expect("nothing is written");
    bencher.counter(ItemsCount::new(samples)).bench(|| sense::run(black_box(&scene), scene.seed, 1000, None));
}

fn names_of_sensor_effects() -> Vec<&'static str> {
    let scene = Scene::parse("all_sensor_effects.toml", ALL_SENSOR_EFFECTS).expect("a valid scene");
    [vec!["none"], scene.effects()].concat()
}

/// One 9-axis update.
#[divan::bench(args = ["paper", "paper-literal", "flight"])]
fn estimator(bencher: Bencher, name: &str) {
    let (_, params) = EstimatorParams::PRESETS.into_iter().find(|p| p.0 == name).expect("a preset");
    let mut estimator = Estimator::new(&params).expect("presets are valid");
    let (gyro, accel, mag) = (vec3(0.1, -0.2, 0.3), vec3(0.5, -0.3, -9.7), Some(vec3(25.0, 3.0, 41.0)));
    bencher.counter(ItemsCount::new(1_u32)).bench_local(|| {
        estimator.update(black_box(gyro), black_box(accel), black_box(mag), 1e-3);
    });
}

/// One draw from the normal distribution.
#[divan::bench]
fn normal(bencher: Bencher) {
    let mut stream = NormalStream::new(1, "bench", 0);
    bencher.counter(ItemsCount::new(1_u32)).bench_local(|| stream.draw());
}
