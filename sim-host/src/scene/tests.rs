use super::*;
use crate::dynamics::GRAVITY;
use crate::effects::Snapshot;
use crate::effects::sensor::testing::{STATE, at_rest, snapshot};
use crate::effects::vehicle::VehicleEffect;

#[test]
fn every_built_in_scene_parses_and_has_a_description() {
    for scene in BUILT_IN {
        let scene = Scene::parse(scene.name, scene.text).unwrap();
        assert!(!scene.description.is_empty(), "{}", scene.name);
    }
}

#[test]
fn effects_that_are_not_named_are_not_built() {
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
fn effect_without_values_takes_those_of_the_preset() {
    let scene = Scene::parse("preset", &format!("{BARE}[effects.gyro.white_noise]\n")).unwrap();
    assert_eq!(scene.effects(), ["gyro.white_noise"]);
    let figures = "n_deg_per_sqrt_h = [1.9368, 1.239, 1.239]";
    let same = Scene::parse("explicit", &format!("{BARE}[effects.gyro.white_noise]\n{figures}\n")).unwrap();
    at_rest(|at| {
        let (mut from_preset, mut explicit) = (scene.gyro(1, 1e3), same.gyro(1, 1e3));
        assert_eq!(from_preset.measure(Vec3::ZERO, at), explicit.measure(Vec3::ZERO, at));
    });
}

#[test]
fn scene_changes_the_one_that_it_includes() {
    let text = "include = \"hover\"\n[scene]\nseed = 99\n[effects.vehicle.motor_lag]\ntau_s = 0.02\n";
    let (altered, hover) = (Scene::parse("altered", text).unwrap(), Scene::load("hover").unwrap());
    assert_eq!((altered.seed, altered.duration_s), (99, hover.duration_s));
    assert_eq!((altered.effects(), &altered.pilot), (hover.effects(), &hover.pilot));
    let wrong = Scene::parse("wrong", "include = \"hover\"\n[scene]\nsed = 99\n").unwrap_err().to_string();
    assert!(wrong.starts_with("wrong:3: scene.sed: unknown key: must be one of "), "{wrong}");
    let lost = Scene::parse("lost", "include = \"nowhere.toml\"\n").unwrap_err().to_string();
    assert!(lost.starts_with("lost:1: include = nowhere.toml: is not a built-in scene"), "{lost}");
}

/// The noise of the gyroscope, °/√h.
fn gyro_noise(scene: &Scene) -> [f64; 3] {
    scene.effects.gyro.white_noise.as_ref().unwrap().n_deg_per_sqrt_h
}

#[test]
fn preset_of_a_scene_has_priority_over_the_scenes_that_it_includes() {
    let chip = "imu = \"mpu-6050\"\n";
    let own = "[effects.gyro.white_noise]\nn_deg_per_sqrt_h = [1.0, 2.0, 3.0]\n";
    let parse = |text: String| Scene::parse("altered", &text).unwrap();
    let altered = parse(format!("include = \"hover\"\n[scene]\n{chip}"));
    assert_eq!(gyro_noise(&altered), [0.21213; 3]);
    assert_eq!(altered.effects(), Scene::load("hover").unwrap().effects());
    // A value beside the preset, or in a scene that includes the one with the preset, has priority over it.
    assert_eq!(gyro_noise(&parse(format!("include = \"hover\"\n[scene]\n{chip}{own}"))), [1.0, 2.0, 3.0]);
    assert_eq!(gyro_noise(&parse(format!("include = \"shaky-frame\"\n{own}"))), [1.0, 2.0, 3.0]);
    // Without a preset of its own, a scene has the values of the included one.
    assert_eq!(gyro_noise(&parse("include = \"hover\"\n".into())), [1.9368, 1.239, 1.239]);
}

/// An event must begin before the end; a window may reach beyond it.
#[test]
fn event_that_begins_after_the_end_is_refused() {
    let with = |table: &str| Scene::parse("late", &format!("include = \"hover\"\n{table}\n"));
    let end = "must be below the length of the scene, 30 s";
    for (table, key) in [
        ("[effects.link.outage]\nat_s = ", "effects.link.outage.at_s"),
        ("[effects.vehicle.motor_failure]\nrotor = 1\nat_s = ", "effects.vehicle.motor_failure.at_s"),
        ("[effects.gyro.bias_step]\nbias_deg_s = [0, 0, 1]\nat_s = ", "effects.gyro.bias_step.at_s"),
        (
            "[effects.mag.disturbance]\nfor_s = 5\nfield_ut = [0, 0, 1]\nat_s = ",
            "effects.mag.disturbance.at_s",
        ),
        ("[[fault]]\nkind = \"dead\"\nsensor = \"mag\"\nat_s = ", "fault.at_s"),
    ] {
        assert!(with(&format!("{table}29.9")).is_ok(), "{key}");
        let error = with(&format!("{table}30")).unwrap_err().to_string();
        assert!(error.ends_with(&format!(": {key} = 30: {end}")), "{error}");
    }
    let still = "[pilot]\nkind = \"script\"\nbase = \"centred\"\nthrottle = 0.5\narm_at_s = 0.1\ntake_off_at_s = 2.0\n";
    let error = Scene::parse("late", &format!("{BARE}{still}")).unwrap_err().to_string();
    assert_eq!(error, "late:11: pilot.take_off_at_s = 2.0: must be below the length of the scene, 1 s");
}

#[test]
fn scene_changes_single_keys_of_its_vehicle() {
    let text = "[scene]\nduration_s = 1.0\nseed = 1\nimu = \"paper\"\nvehicle = \"os4\"\n[vehicle]\nmass_g = 800.0\n";
    let scene = Scene::parse("heavy", text).unwrap();
    assert_eq!(scene.vehicle, VehicleParams { mass_kg: 0.8, ..VehicleParams::OS4 });
    // Values that are derived from the mass change with it.
    let descent = scene.config.params.descent.throttle;
    assert!((f64::from(descent) - 0.95 * scene.vehicle.hover_throttle()).abs() < 1e-6);
    assert!((scene.pilot_knowledge().hover_throttle / 0.5 - 0.8 / 0.65).abs() < 1e-3);
}

#[test]
fn config_has_the_vehicle_and_the_chips_of_the_scene() {
    // The defaults of flight-core come from the same data sheets, but in f32; those of the scene in f64.
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
fn longer_flight_keeps_the_time_from_landing_to_end() {
    let mut scene = Scene::load("hover").unwrap();
    scene.set_duration(100.0).unwrap();
    assert_eq!(scene.pilot.as_ref().unwrap().plan.land_before_end_s, Some(8.0));
    let error = scene.set_duration(9.0).unwrap_err().to_string();
    assert_eq!(
        error,
        "scene.duration_s = 9: must be at least 13 s: take-off 5 s after the start, landing 8 s before the end"
    );
}

#[test]
fn presets_have_the_values_of_their_data_sheets() {
    // One-sided densities in °/s/√Hz and µg/√Hz, or random walks in °/√h and m/s/√h.
    let two_sided = |density: f64| density / 2.0_f64.sqrt();
    let gyro = |density: f64| Some(two_sided(density) * 60.0);
    let accel = |density_ug: f64| Some(two_sided(density_ug * 1e-6 * GRAVITY));
    for (preset, lsb_per_deg_s, lsb_per_g, gyro, accel) in [
        ("icm-42688-p", 32768.0 / 2000.0, 32768.0 / 16.0, gyro(0.0028), accel(70.0)),
        ("mpu-6050", 32768.0 / 2000.0, 32768.0 / 16.0, gyro(0.005), accel(400.0)),
        ("bmi088", 32768.0 / 2000.0, 32768.0 / 24.0, gyro(0.014), None),
        ("adis16448", 1.0 / 0.04, 1.0 / 0.000_833, Some(0.66), Some(0.11 / 60.0)),
    ] {
        let scene = Scene::parse("preset", &BARE.replace("\"paper\"", &format!("\"{preset}\""))).unwrap();
        let [rate, force, _] = scene.converters.map(|converter| converter.per_count());
        // Data sheets give three or four digits.
        assert!((rate * lsb_per_deg_s / 1_f64.to_radians() - 1.0).abs() < 2e-3, "{preset}");
        assert!((force * lsb_per_g / GRAVITY - 1.0).abs() < 2e-3, "{preset}");
        let (_, text) = imu::PRESETS.iter().find(|(name, _)| *name == preset).unwrap();
        let table: toml::Table = text.parse().unwrap();
        let figures = |sensor: &str, key: &str| {
            let noise = table["effects"].get(sensor)?.get("white_noise")?.get(key)?.as_array()?;
            noise.iter().map(toml::Value::as_float).collect::<Option<Vec<f64>>>()
        };
        for (got, wanted) in
            [(figures("gyro", "n_deg_per_sqrt_h"), gyro), (figures("accel", "n_m_s2_per_sqrt_hz"), accel)]
        {
            assert_eq!(got.is_some(), wanted.is_some(), "{preset}");
            if let (Some(got), Some(wanted)) = (got, wanted) {
                assert!(
                    got.iter().all(|n| (n / wanted - 1.0).abs() < 1e-4),
                    "{preset}: {got:?}, not {wanted}"
                );
            }
        }
    }
}

#[test]
fn place_sets_the_field_and_model_the_declination() {
    let ankara = Scene::parse("ankara", BARE).unwrap();
    assert!((ankara.field_ut - FIELD_ANKARA_UT).norm() < 0.05);
    let natick = "[scene.place]\nlatitude_deg = 42.283\nlongitude_deg = -71.35\naltitude_m = 1000.0\nyear = 2028.505\n";
    let text = format!("{BARE}{natick}[flight]\nestimator = \"flight\"\ndeclination_deg = \"model\"\n");
    let scene = Scene::parse("natick", &text).unwrap();
    // The documentation of MATLAB's wrldmagm gives −13.6891° for this place and date.
    let declination = f64::from(scene.config.params.estimator.declination_rad).to_degrees();
    assert!((declination + 13.6891).abs() < 0.02, "{declination}");
    let wrong = text.replace("\"model\"", "\"modell\"");
    assert!(Scene::parse("wrong", &wrong).unwrap_err().to_string().contains("must be a number of degrees"));
}

const EVERY_EFFECT: &str = include_str!("../../benches/every_effect.toml");

/// Returns the bare scene with the effects of these names, with their values in [`EVERY_EFFECT`].
fn with_effects(names: &[&str]) -> Scene {
    let every: toml::Table = EVERY_EFFECT.parse().unwrap();
    let mut effects = every["effects"].as_table().unwrap().clone();
    for (group, effects) in &mut effects {
        let requested = |effect: &str| names.contains(&format!("{group}.{effect}").as_str());
        effects.as_table_mut().unwrap().retain(|effect, _| requested(effect));
    }
    // The duration is that of the included scene, because the frequency band of the flicker noise depends on it.
    let mut text: toml::Table = BARE.replace("duration_s = 1.0", "duration_s = 30.0").parse().unwrap();
    text.insert("effects".into(), effects.into());
    Scene::parse("some", &text.to_string()).unwrap()
}

/// Name of a sensor or wind effect, and the bits of its output for a fixed input.
type Contribution = (&'static str, Vec<[u64; 3]>);

/// Returns the output of each effect of a scene alone, for the same readings of a vehicle in flight.
fn contributions(scene: &Scene) -> Vec<Contribution> {
    let state = crate::dynamics::State { rates: vec3(0.1, -0.2, 0.3), ..STATE };
    let at =
        |k: u32| Snapshot { rotors: [200.0, 210.0, 220.0, 230.0], ..snapshot(&state, f64::from(k) * 1e-3) };
    let bits = |v: Vec3<f64>| <[f64; 3]>::from(v).map(f64::to_bits);
    let mut list = Vec::new();
    for (name, effect) in scene.vehicle_effects(7, 1e3) {
        if let VehicleEffect::Wind(mut wind) = effect {
            list.push((name, (0..20).map(|k| bits(wind.velocity(&at(k)))).collect()));
        }
    }
    for mut sensor in [scene.gyro(7, 1e3), scene.accel(7, 1e3), scene.mag(7, 1e3)] {
        for (name, effect) in sensor.effects_mut() {
            let made = |k: u32| bits(effect.apply(vec3(1.0, 2.0, -3.0), &at(k)));
            list.push((*name, (0..20).map(made).collect()));
        }
    }
    list
}

#[test]
fn effects_do_not_change_each_others_draws() {
    let groups = ["wind.", "gyro.", "accel.", "mag.", "vehicle.quadratic_drag"];
    let mut names = Scene::parse("every", EVERY_EFFECT).unwrap().effects();
    names.retain(|name| groups.iter().any(|group| name.starts_with(group)));
    let every = contributions(&with_effects(&names));
    // Wind needs an effect of drag. This drag draws no random numbers.
    let alone = |name| contributions(&with_effects(&[name, "vehicle.quadratic_drag"]));
    for (i, first) in every.iter().enumerate() {
        assert_eq!(alone(first.0), std::slice::from_ref(first), "alone and with all the others");
        for second in &every[i + 1..] {
            let together = contributions(&with_effects(&[first.0, second.0, "vehicle.quadratic_drag"]));
            assert_eq!(together, [first.clone(), second.clone()], "{} with {}", first.0, second.0);
        }
    }
}

#[test]
fn every_effect_toml_names_all_effects() {
    assert_eq!(Scene::parse("every", EVERY_EFFECT).unwrap().left_out(), Vec::<&str>::new());
}

/// Parses a scene; every file that it names has the content `text`.
fn with_files(scene: &str, text: &str) -> Result<Scene, InputError> {
    Scene::parse_with("scene.toml", scene, &|_| Ok(text.into()))
}

#[test]
fn error_in_an_included_array_names_its_file_and_line() {
    let below = "[[fault]]\nkind = \"dead\"\nsensor = \"imu\"\nat_s = 0.5\nfr_s = 1.0\n";
    // More characters of three bytes than there are bytes before the wrong key: its offset is inside a character.
    let above = format!("include = \"below.toml\"\n# {}\n{BARE}", "…".repeat(100));
    let error = with_files(&above, below).unwrap_err().to_string();
    assert!(error.starts_with("below.toml:5: fault.fr_s: unknown key"), "{error}");
}

#[test]
fn cycle_of_includes_is_refused() {
    let error =
        with_files("include = \"./scene.toml\"\n", "include = \"./scene.toml\"\n").unwrap_err().to_string();
    assert!(
        error.contains("include = ./")
            && error.ends_with("must not be part of a cycle, or of a chain of more than 16 scenes"),
        "{error}"
    );
}

#[test]
fn text_above_one_mebibyte_is_refused() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("long.toml");
    std::fs::write(&path, "#".repeat(1 << 20)).unwrap();
    assert!(layers::read_text(&path).is_ok());
    std::fs::write(&path, "#".repeat((1 << 20) + 1)).unwrap();
    assert_eq!(layers::read_text(&path).unwrap_err().to_string(), "longer than 1048576 bytes");
}
