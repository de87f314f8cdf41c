//! The scene `hover` with each effect of the vehicle at a realistic value, judged on the truth.

use flight_core::ArmState;
use sim_host::flight::{Crash, Flight, Outcome};
use sim_host::scene::Scene;

/// Returns the scene `hover` with more effects, as a scene file would include it.
fn hover_with(tables: &str) -> Scene {
    Scene::parse("hover-with", &format!("include = \"hover\"\n{tables}")).unwrap_or_else(|e| panic!("{e}"))
}

fn fly(tables: &str, seed: u64) -> Outcome {
    let outcome = Flight::new(&hover_with(tables), seed).run(&mut ());
    println!(
        "{tables}: {:?}, {:.2} m from the target, tilt {:.1}°, estimate {:.2}° RMS",
        outcome.crash, outcome.position_error_max_m, outcome.tilt_max_deg, outcome.attitude_rmse_deg
    );
    outcome
}

/// The effects with their values, and the largest allowed distance from the target, m.
const EFFECTS: [(&str, f64); 12] = [
    ("[effects.wind.constant]\nvelocity_m_s = [3.0, -2.0, 0.0]", 3.0),
    ("[effects.wind.dryden]\nairspeed_m_s = 5.0", 3.0),
    ("[effects.vehicle.esc_delay]\ndelay_s = 0.002", 0.5),
    ("[effects.vehicle.esc_quantization]\nstep_us = 4.0", 0.5),
    (
        "[effects.vehicle.battery_sag]\ncells = 3\ncapacity_mah = 2000.0\nresistance_mohm = 30.0\nefficiency = 0.7",
        0.8,
    ),
    ("[effects.vehicle.motor_lag]\ntau_s = 0.05\ntau_down_s = 0.08", 0.5),
    // The cushion of air holds the vehicle off the ground while the pilot's target descends further.
    ("[effects.vehicle.ground_effect]\nrotor_radius_m = 0.15", 0.8),
    ("[effects.vehicle.quadratic_drag]\ncd_area_m2 = [0.01, 0.01, 0.03]", 0.5),
    ("[effects.vehicle.rotor_drag]\nk_kg_per_rad = 1.19e-4", 0.5),
    ("[effects.vehicle.rotor_gyroscopic]", 0.5),
    ("[effects.vehicle.rotor_acceleration]", 0.5),
    ("[effects.vehicle.cg_offset]\noffset_m = [0.005, -0.003, 0.0]", 1.0),
];

#[test]
fn hover_flies_with_each_effect() {
    for (tables, max_distance_m) in EFFECTS {
        for seed in [7, 8, 9] {
            let outcome = fly(tables, seed);
            assert_eq!((outcome.crash, outcome.final_state), (None, ArmState::Disarmed), "{tables}");
            assert!(outcome.position_error_max_m < max_distance_m, "{tables}: {outcome:?}");
        }
    }
}

#[test]
fn hover_flies_with_all_effects_at_once() {
    let effects = EFFECTS.map(|(tables, _)| tables).join("\n");
    // With gusts and ground effect it takes longer to come to rest on the ground.
    let tables = format!("scene.duration_s = 40.0\npilot.land_before_end_s = 18.0\n{effects}");
    for seed in [7, 8, 9] {
        let outcome = fly(&tables, seed);
        assert_eq!((outcome.crash, outcome.final_state), (None, ArmState::Disarmed));
        assert!(outcome.position_error_max_m < 4.0, "{outcome:?}");
    }
}

#[test]
fn every_effect_changes_the_flight() {
    let plain = Flight::new(&Scene::load("hover").unwrap(), 7).run(&mut ()).digest;
    // The scene `hover` already has rotor_gyroscopic.
    for (tables, _) in EFFECTS.iter().filter(|(tables, _)| !tables.contains("gyroscopic")) {
        assert_ne!(fly(tables, 7).digest, plain, "{tables}");
    }
}

#[test]
fn motor_failure_ends_in_a_named_crash() {
    for rotor in 1..=4 {
        let tables = format!("[effects.vehicle.motor_failure]\nrotor = {rotor}\nat_s = 12.0");
        let (crash, at_s) =
            fly(&tables, 7).crash.expect("a crash, because three rotors cannot carry this vehicle");
        assert!(
            matches!(crash, Crash::TippedOver | Crash::HardTouchDown | Crash::TiltedTouchDown),
            "{crash:?}"
        );
        assert!((12.0..14.0).contains(&at_s), "{crash:?} after {at_s} s");
    }
}

#[test]
fn empty_battery_does_not_arm() {
    // Two full cells are below the 10.5 V that arming needs; three are above.
    let battery = |cells| {
        format!(
            "[effects.vehicle.battery_sag]\ncells = {cells}\ncapacity_mah = 2000.0\nresistance_mohm = 30.0\nefficiency = 0.7"
        )
    };
    assert_eq!(fly(&battery(2), 7).tilt_max_deg.round(), 0.0);
    assert_eq!(fly(&battery(2), 7).position_error_max_m, 0.0);
    assert!(fly(&battery(3), 7).position_error_max_m > 0.0);
}

#[test]
fn effects_that_cannot_act_are_refused() {
    let scene = |tables: &str| {
        let head = "[scene]\nduration_s = 1.0\nseed = 1\nvehicle = \"os4\"\nimu = \"paper\"\n";
        Scene::parse("bare", &format!("{head}{tables}"))
    };
    let wind = "[effects.wind.constant]\nvelocity_m_s = [3.0, 0.0, 0.0]\n";
    let error = scene(wind).unwrap_err().to_string();
    assert!(error.contains("effects.wind.constant: needs vehicle.linear_drag"), "{error}");
    for drag in [
        "linear_drag]\na_kg_per_s = [0.2, 0.2, 0.2]",
        "quadratic_drag]\ncd_area_m2 = [0.01, 0.01, 0.01]",
        "rotor_drag]\nk_kg_per_rad = 1e-4",
    ] {
        assert!(scene(&format!("{wind}[effects.vehicle.{drag}\n")).is_ok());
    }
    let error = scene("[effects.vehicle.rotor_acceleration]\n").unwrap_err().to_string();
    assert!(error.contains("needs vehicle.motor_lag"), "{error}");
    let error = scene("[effects.wind.drydn]\n").unwrap_err().to_string();
    assert!(error.contains("did you mean `dryden`"), "{error}");
}
