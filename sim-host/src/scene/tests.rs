use super::*;
use crate::effects::sensor::testing::at_rest;

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
