use super::*;
use crate::effects::sensor::testing::{self as sensor_testing, at_rest};

#[test]
fn every_built_in_scene_reads_and_describes_itself() {
    for scene in BUILT_IN {
        let scene = Scene::parse(scene.name, scene.text).unwrap();
        assert!(!scene.description.is_empty(), "{}", scene.name);
    }
}

#[test]
fn what_is_not_named_is_not_built() {
    let text = "[scene]\nduration_s = 1.0\nseed = 1\nvehicle = \"os4\"\nimu = \"paper\"\n";
    let scene = Scene::parse("bare", text).unwrap();
    assert!(scene.effects().is_empty() && scene.vehicle_effects(1, 1e3).is_empty() && scene.pilot.is_none());
    let truth = vec3(0.1, 0.2, 0.3);
    at_rest(|at| {
        for mut sensor in [scene.gyro(1, 1e3), scene.accel(1, 1e3), scene.mag(1, 1e2)] {
            assert_eq!(sensor.measure(truth, at), truth);
        }
    });
}

const BARE: &str = "[scene]\nduration_s = 1.0\nseed = 1\nvehicle = \"os4\"\nimu = \"paper\"\n";

#[test]
fn an_effect_without_figures_takes_the_presets_and_others_stay_unnamed() {
    let scene = Scene::parse("preset", &format!("{BARE}[effects.gyro.white_noise]\n")).unwrap();
    assert_eq!(scene.effects(), ["gyro.white_noise"]);
    let figures = "n_deg_per_sqrt_h = [1.9368, 1.239, 1.239]";
    let same = Scene::parse("said", &format!("{BARE}[effects.gyro.white_noise]\n{figures}\n")).unwrap();
    at_rest(|at| {
        let (mut taken, mut said) = (scene.gyro(1, 1e3), same.gyro(1, 1e3));
        assert_eq!(taken.measure(Vec3::ZERO, at), said.measure(Vec3::ZERO, at));
    });
}

#[test]
fn a_scene_alters_the_one_it_includes() {
    let text = "include = \"hover\"\n[scene]\nseed = 99\n[effects.vehicle.motor_lag]\ntau_s = 0.02\n";
    let (altered, hover) = (Scene::parse("altered", text).unwrap(), Scene::load("hover").unwrap());
    assert_eq!((altered.seed, altered.duration_s), (99, hover.duration_s));
    assert_eq!((altered.effects(), &altered.pilot), (hover.effects(), &hover.pilot));
    let wrong = Scene::parse("wrong", "include = \"hover\"\n[scene]\nsed = 99\n").unwrap_err().to_string();
    assert!(wrong.starts_with("wrong:3: unknown field `sed`"), "{wrong}");
    let lost = Scene::parse("lost", "include = \"nowhere.toml\"\n").unwrap_err().to_string();
    assert!(lost.starts_with("lost: include = nowhere.toml: is no built-in scene"), "{lost}");
}

#[test]
fn an_inline_vehicle_is_like_another_but_for_what_it_says() {
    let text =
        "[scene]\nduration_s = 1.0\nseed = 1\nimu = \"paper\"\nvehicle = { like = \"os4\", mass_kg = 0.8 }\n";
    let scene = Scene::parse("heavy", text).unwrap();
    assert_eq!(scene.vehicle, VehicleParams { mass_kg: 0.8, ..VehicleParams::OS4 });
    assert!((scene.pilot_knowledge().hover_throttle / 0.5 - 0.8 / 0.65).abs() < 1e-3);
}

#[test]
fn flight_core_is_told_of_the_vehicle_and_the_chips_that_fly() {
    // The defaults of flight-core are written from datasheets in f32, the scene's in f64.
    let scene = Scene::load("hover").unwrap();
    let default = Params::default();
    let params = scene.config.params;
    assert_eq!(params.airframe, default.airframe);
    for (ours, theirs) in
        [(params.gyro, default.gyro), (params.accel, default.accel), (params.mag, default.mag)]
    {
        assert!((ours.per_count / theirs.per_count - 1.0).abs() < 1e-6);
    }
}

#[test]
fn a_longer_flight_lands_as_long_before_its_end() {
    let mut scene = Scene::load("hover").unwrap();
    scene.set_duration(100.0).unwrap();
    assert_eq!(scene.pilot.as_ref().unwrap().plan.land_before_end_s, Some(8.0));
    let error = scene.set_duration(9.0).unwrap_err().to_string();
    assert_eq!(
        error,
        "scene.duration_s = 9: must be at least 13 s: take-off 5 s after the start, landing 8 s before the end"
    );
}

/// The bare scene with those of [`ALL_SENSOR_EFFECTS`] that are asked for.
fn with_effects(names: &[&str]) -> Scene {
    let mut text: toml::Table = ALL_SENSOR_EFFECTS.parse().unwrap();
    for (sensor, effects) in text["effects"].as_table_mut().unwrap() {
        let asked_for = |effect: &str| names.contains(&format!("{sensor}.{effect}").as_str());
        effects.as_table_mut().unwrap().retain(|effect, _| asked_for(effect));
    }
    Scene::parse("some", &text.to_string()).unwrap()
}

const ALL_SENSOR_EFFECTS: &str = include_str!("../../benches/all_sensor_effects.toml");

/// What each effect of a scene makes of the same readings while the vehicle flies: its contribution alone.
fn contributions(scene: &Scene) -> Vec<(&'static str, Vec<[u64; 3]>)> {
    let with = scene.build_at(7, 1e3);
    let effects = &scene.effects;
    let built = [effects.gyro.build(with), effects.accel.build(with), effects.mag.build(with)];
    let mut list = Vec::new();
    for (name, mut effect) in built.into_iter().flatten() {
        let made = |k: u32| {
            let state = crate::vehicle::State { rates: vec3(0.1, -0.2, 0.3), ..sensor_testing::STATE };
            let rotors = [200.0, 210.0, 220.0, 230.0];
            let at = crate::effects::Moment { rotors, ..sensor_testing::moment(&state, f64::from(k) * 1e-3) };
            <[f64; 3]>::from(effect.apply(vec3(1.0, 2.0, -3.0), &at)).map(f64::to_bits)
        };
        list.push((name, (0..20).map(made).collect()));
    }
    list
}

#[test]
fn no_effect_moves_the_draws_of_another() {
    let every = Scene::parse("every", ALL_SENSOR_EFFECTS).unwrap();
    let names = every.effects();
    let alone: Vec<_> = names.iter().map(|name| contributions(&with_effects(&[name])).remove(0)).collect();
    assert_eq!(alone.iter().map(|(name, _)| *name).collect::<Vec<_>>(), names);
    for (i, first) in alone.iter().enumerate() {
        for second in &alone[i + 1..] {
            let together = contributions(&with_effects(&[first.0, second.0]));
            assert_eq!(together, [first.clone(), second.clone()], "{} with {}", first.0, second.0);
        }
    }
    assert_eq!(contributions(&every), alone, "all together");
}

#[test]
fn the_file_of_every_effect_has_every_effect() {
    let every = Scene::parse("every", ALL_SENSOR_EFFECTS).unwrap();
    let of_sensors = |name: &&str| !name.starts_with("vehicle.");
    assert_eq!(every.left_out().into_iter().filter(of_sensors).collect::<Vec<_>>(), Vec::<&str>::new());
}
