use flight_core::FlightController;
use flight_core::config::Config;

use super::*;

fn os4() -> Vehicle {
    Vehicle::load("os4").unwrap()
}

/// Parses OS4's text with a line replaced.
fn altered(line: &str, by: &str) -> Result<Vehicle, InputError> {
    let text = BUILT_IN[0].1;
    assert!(text.contains(line), "no {line}");
    Vehicle::parse("altered.toml", &text.replace(line, by))
}

#[test]
fn flight_controller_accepts_each_built_in_vehicle() {
    for (name, _) in BUILT_IN {
        let vehicle = Vehicle::load(name).unwrap();
        let params = vehicle.flight_params(&Params::default());
        FlightController::new(&Config { params, calibration: None }).unwrap();
        assert!(vehicle.params.hover_throttle() < 0.85, "{name}");
        assert!(!vehicle.description.is_empty(), "{name}");
        assert_eq!(
            vehicle,
            Vehicle::load(&format!("../vehicles/{name}.toml"))
                .map(|v| Vehicle { name: vehicle.name.clone(), ..v })
                .unwrap()
        );
    }
}

/// flight-core's defaults equal the figures of OS4's file.
#[test]
fn flight_controller_defaults_are_os4() {
    let ours = os4().flight_params(&Params::default());
    let default = Params::default();
    let near = |a: f32, b: f32| (a / b - 1.0).abs() < 1e-3;
    assert!(near(ours.descent.throttle, default.descent.throttle));
    assert!(near(ours.control.begin_throttle, default.control.begin_throttle));
    let same = Params {
        descent: default.descent,
        control: ControlParams {
            begin_throttle: default.control.begin_throttle,
            max_tilt_rad: default.control.max_tilt_rad,
            ..ours.control
        },
        ..ours
    };
    assert_eq!(same, default);
}

#[test]
fn constant_os4_equals_the_file() {
    assert_eq!(os4().params, VehicleParams::OS4);
}

/// Computed by hand, in the units of the file: 0.65 kg · 9.80665 = 6.374 N of 4 · 1.2e-6 · 2570² = 31.70 N.
#[test]
fn derived_figures_follow_from_the_file() {
    let v = Vehicle::load("five-inch").unwrap();
    assert!((v.params.hover_throttle() - 0.2011).abs() < 1e-4);
    assert!((v.params.hover_rad_s() - 1152.4).abs() < 0.5);
    assert!((v.descent_throttle - 0.95 * 0.2011).abs() < 1e-4);
    assert!((f64::from(v.control.begin_throttle) - 0.2 * 0.2011).abs() < 1e-4);
    assert_eq!((v.min_arm_voltage_v, v.critical_voltage_v), (14.0, 12.0));
    assert_eq!(v.params.spin, Spin::PropsIn);
    // Thrust from a thrust stand's figure: 1.9 kg at 11,000 rpm, which is 1,151.9 rad/s.
    let v = Vehicle::load("ten-inch").unwrap();
    assert!((v.params.thrust_coefficient / (1.9 * 9.80665 / 1151.917_f64.powi(2)) - 1.0).abs() < 1e-6);
    // The moment of inertia of a box of 1.5 kg, 180 by 90 by 70 mm, and of 0.9 kg at a distance of 165 mm to the side.
    let x = 1.5 * (0.09_f64.powi(2) + 0.07_f64.powi(2)) / 12.0 + 0.9 * 0.165_f64.powi(2);
    assert!((v.params.inertia_kg_m2.x - x).abs() < 1e-9);
    assert!(v.derived.iter().any(|derived| derived.what == "moments of inertia" && derived.estimate));
}

#[test]
fn full_speed_follows_from_kv_and_cells() {
    let v = altered("max_rad_s = 319.0", "kv_rpm_per_v = 380.0").unwrap();
    // The speed is 380 rpm/V · 11.1 V · 75 % = 3,163.5 rpm.
    assert!((v.params.max_rad_s - 3163.5 / 60.0 * std::f64::consts::TAU).abs() < 0.1);
    assert!(v.derived.iter().any(|derived| derived.what == "speed at full throttle" && derived.estimate));
}

/// OS4 with its hand-tuned gains has a crossover of 20 rad/s and a margin of 61°, without the delay to the motors. The
/// delay takes another degree.
#[test]
fn os4_gains_have_the_expected_margin() {
    let v = os4();
    let gains = Loop::of(&v.control, Axis::Roll);
    let plant = Plant { delay_s: 0.0, ..Plant::of(&v) };
    let margin = plant.margin(&gains);
    assert!(
        (margin.crossover_rad_s - 20.0).abs() < 1.0 && (margin.phase_deg - 61.0).abs() < 2.0,
        "{margin:?}"
    );
    // A delay T reduces the phase by ω T.
    let late = Plant { delay_s: 5e-3, ..plant }.margin(&gains);
    let lost = (margin.phase_deg - late.phase_deg).to_radians();
    assert!((lost / (5e-3 * margin.crossover_rad_s) - 1.0).abs() < 0.05);
    assert!((plant.prefilter_delay_s() - 7.5e-3).abs() < 0.01e-3);
}

#[test]
fn tuned_gains_have_the_margin_and_match_hand_tuning() {
    for (name, _) in BUILT_IN {
        let v = Vehicle::load(name).unwrap();
        let plant = Plant::of(&v);
        let tuned = tune(&v.params, &plant, MARGIN_DEG);
        for gains in [tuned.tilt, Loop { k: 0.0, ..tuned.yaw }] {
            let margin = plant.margin(&gains);
            // One of the two limits is reached, and neither is exceeded.
            let (over_deg, corner) = (margin.phase_deg - MARGIN_DEG, margin.crossover_rad_s * plant.lag_s);
            assert!(over_deg > -0.2 && corner < 1.005, "{name}: {margin:?}");
            assert!(over_deg < 0.3 || corner > 0.97, "{name}: {margin:?}");
        }
        // With its angle loop, yaw still has a margin above 35°.
        assert!(plant.margin(&tuned.yaw).phase_deg > 35.0, "{name}");
    }
    let v = os4();
    let tuned = tune(&v.params, &Plant::of(&v), MARGIN_DEG);
    assert!((tuned.tilt.p / 25.0 - 1.0).abs() < 0.1, "{tuned:?}");
    assert!((tuned.yaw.p / 6.0 - 1.0).abs() < 0.35, "{tuned:?}");
}

#[test]
fn errors_name_file_field_and_limit() {
    for (line, by, expected) in [
        ("mass_g = 650.0", "mass_g = -1.0", "altered.toml:4: mass_g = -1.0: must be from 10 to 100000 g"),
        (
            "mass_g = 650.0",
            "mass_g = 2000.0",
            "altered.toml:4: mass_g = 2000.0: is too heavy for rotors that lift 1299 g",
        ),
        (
            "description = \"OS4, the paper's quadrotor\"",
            "description = \"two\\nlines\"",
            "altered.toml:3: description = two\\nlines: must be one line without control characters",
        ),
        ("mass_g = 650.0", "mass_kg = 0.65", "altered.toml:4: mass_kg: unknown key: must be one of"),
        (
            "arm_mm = 230.0",
            "arm_mm = 230.0\nforward_mm = 1.0",
            "altered.toml:11: rotors: has arm_mm and forward_mm with right_mm",
        ),
        (
            "arm_mm = 230.0",
            "forward_mm = 160.0",
            "altered.toml:11: rotors.right_mm: is missing: forward_mm needs it",
        ),
        ("thrust_n_s2 = 3.13e-5", "", "altered.toml:11: rotors: needs one of thrust_n_s2, full_thrust_g"),
        (
            "kg_m2 = [7.5e-3, 7.5e-3, 1.3e-2]",
            "kg_m2 = [7.5e-3, 7.5e-3, 1.6e-2]",
            "altered.toml:9: inertia.kg_m2 = 0.016: must be at most the sum",
        ),
        (
            "spin = \"props-out\"",
            "spin = \"props\"",
            "rotors.spin = props: must be one of props-in, props-out (did you mean `props-in`?)",
        ),
        ("cells = 3", "cells = 0", "altered.toml:5: cells = 0: must be a whole number from 1 to 24"),
        (
            "inertia_kg_m2 = 6.0e-5",
            "propeller_mm = nan",
            "altered.toml:16: rotors.propeller_mm = nan: must be from 20 to 2000 mm",
        ),
        (
            "inertia_kg_m2 = 6.0e-5",
            "inertia_kg_m2 = 6.0e-5\npropeller_g = 4.0",
            "altered.toml:11: rotors: has inertia_kg_m2 and propeller_g",
        ),
        (
            "kg_m2 = [7.5e-3, 7.5e-3, 1.3e-2]",
            "kg_m2 = [7.5e-3, 7.5e-3, 1.3e-2]\nhub_mm = [1.0, 1.0, 1.0]",
            "altered.toml:8: inertia: has kg_m2 and hub_g with hub_mm",
        ),
        (
            "idle_rad_s = 32.0",
            "idle_rad_s = 200.0",
            "altered.toml:18: rotors.idle_rad_s = 200.0: must be from 0 to 159",
        ),
        (
            "max_rad_s = 319.0",
            "kv_rpm_per_v = 30000.0",
            "altered.toml:17: rotors.kv_rpm_per_v = 30000.0: gives 26154 rad/s at full throttle with 3 cells: must give from 65 to 10000 rad/s",
        ),
        (
            "[gains]",
            "[battery]\narm_v_per_cell = 2.5\n[gains]",
            "altered.toml:25: battery: critical_v_per_cell (3.00 V) must be below arm_v_per_cell (2.50 V)",
        ),
        (
            "[gains]",
            "[filters]\nprefilter_hz = 0.5000000001\n[gains]",
            "altered.toml:26: filters.prefilter_hz = 0.5000000001: must be above 0.5",
        ),
        ("[gains]", "[filters]\nprefilter_hz = \"non\"\n[gains]", "must be a number of Hz or \"none\""),
        (
            "[gains]",
            "[filters]\nprefilter_hz = 80.0\n[gains]",
            "altered.toml:26: filters.prefilter_hz = 80.0: must be above 0.5 and below 49.95 Hz, just below half the magnetometer's rate",
        ),
    ] {
        let error = altered(line, by).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}\n{expected}");
        assert_eq!(error.lines().count(), 1);
    }
    // The flight controller checks computed gains, too.
    let (before_gains, _) = BUILT_IN[0].1.split_once("# Tuned by hand").unwrap();
    let slight = before_gains.replace("kg_m2 = [7.5e-3, 7.5e-3, 1.3e-2]", "kg_m2 = [1e-5, 1e-5, 1.9e-5]");
    let error = Vehicle::parse("slight.toml", &slight).unwrap_err().to_string();
    assert!(error.starts_with("slight.toml:8: inertia: gives control.max_integral_rad_s2 = "), "{error}");
    let without = altered("[gains]", "[filters]\nprefilter_hz = \"none\"\n[gains]").unwrap();
    assert_eq!(without.prefilter_hz, None);
    assert!(Vehicle::parse("x.toml", "").unwrap_err().to_string().contains("is empty"));
    let error = Vehicle::load("five-inhc").unwrap_err().to_string();
    assert!(error.contains("did you mean `five-inch`?"), "{error}");
}

#[test]
fn channel_map_follows_the_file() {
    let rc = |lines: &str| Vehicle::parse("x.toml", &format!("{}\n[rc]\n{lines}", BUILT_IN[0].1));
    assert_eq!(os4().channels, ChannelMap::AETR);
    let taer = rc("order = \"TAER\"\narm_channel = 7\narm_by = \"switch\"").unwrap();
    assert_eq!(taer.channels, ChannelMap { sticks: [0, 1, 2, 3], arm: 6, mode: 5 });
    assert_eq!(taer.arm_by, ArmBy::Switch);
    for (lines, expected) in [
        ("order = \"AETT\"", "rc.order = AETT: must be the capital letters A, E, T and R"),
        ("order = \"aetr\"", "rc.order = aetr: must be the capital letters A, E, T and R"),
        ("arm_channel = 3", "rc.arm_channel = 3: must be a whole number from 5 to 16"),
        ("arm_channel = 300", "rc.arm_channel = 300: must be a whole number from 5 to 16"),
        ("mode_channel = 5", "rc = 5: arm_channel and mode_channel must differ"),
    ] {
        assert!(rc(lines).unwrap_err().to_string().contains(expected), "{lines}");
    }
}
