use super::*;

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
    assert!(scene.effects().is_empty() && scene.body_effects().is_empty() && scene.motor_lag_s().is_none());
    assert!(scene.gyro_effects(1, 1e3).is_empty() && scene.accel_effects(1, 1e3).is_empty());
    assert!(scene.mag_effects(1, 1e2).is_empty() && scene.pilot.is_none());
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
