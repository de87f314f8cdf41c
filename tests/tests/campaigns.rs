//! Many seeds of every built-in scene that flies, judged on the truth; and what ends a flight outside the envelope.
//! `docs/campaigns.md` has the figures of a thousand.

use std::num::NonZeroUsize;
use std::path::Path;
use std::sync::atomic::AtomicBool;

use flight_core::ArmState;
use sim_host::campaign::{Campaign, Run, fly};
use sim_host::flight::Crash;
use sim_host::scene::{BUILT_IN, Scene};

/// The scenes within the envelope: the largest error of any flight's estimated attitude, ° RMSE, and the furthest from
/// the pilot's target, m. A fifth above the worst of a thousand seeds.
const WITHIN: [(&str, f64, f64); 11] = [
    ("hover", 0.67, 0.42),
    ("steps", 0.85, 2.7),
    ("stand-steps", 0.45, 0.0),
    ("windy-landing", 0.98, 7.5),
    ("hot-day", 2.4, 0.42),
    ("weak-battery", 0.67, 1.6),
    ("magnetic-site", 1.8, 0.42),
    ("shaky-frame", 18.5, 3.9),
    ("bad-link", 0.67, 0.56),
    ("rough-sampling", 2.1, 2.7),
    ("whole-drive", 0.85, 2.8),
];

/// A way to fail, and how it ends on every seed.
struct Outside {
    what: &'static str,
    scene: &'static str,
    crash: Option<Crash>,
    state: ArmState,
}

/// Outside the envelope. Where the flight controller knows what has failed, its state names it; with a rotor gone, or a
/// wind that it has no power against, it does not: then the judge of the truth names the crash.
const OUTSIDE: [Outside; 6] = [
    Outside {
        what: "link lost for good",
        scene: "[scene]\nduration_s = 60.0\n[effects.link.outage]\nat_s = 14.0\nfor_s = 60.0\n",
        crash: None,
        state: ArmState::Terminated,
    },
    Outside {
        what: "link lost for three seconds",
        scene: "[scene]\nduration_s = 60.0\n[effects.link.outage]\nat_s = 14.0\nfor_s = 3.0\n",
        crash: None,
        state: ArmState::Disarmed,
    },
    Outside {
        what: "inertial sensor dead",
        scene: "[[fault]]\nkind = \"dead\"\nsensor = \"imu\"\nat_s = 14.0\n",
        crash: Some(Crash::HardTouchDown),
        state: ArmState::Terminated,
    },
    Outside {
        what: "an axis stuck",
        scene: "[[fault]]\nkind = \"stuck_axis\"\nsensor = \"gyro\"\naxis = \"x\"\nat_s = 14.0\n",
        crash: Some(Crash::HardTouchDown),
        state: ArmState::Terminated,
    },
    Outside {
        what: "a rotor gone",
        scene: "[effects.vehicle.motor_failure]\nrotor = 3\nat_s = 12.0\n",
        crash: Some(Crash::TippedOver),
        state: ArmState::Armed,
    },
    Outside {
        what: "14 m/s of wind, 3.5 N of drag, where 20° of tilt give 2.3 N",
        scene: "[effects.wind.constant]\nvelocity_m_s = [-14.0, 0.0, 0.0]\n",
        crash: Some(Crash::FlownAway),
        state: ArmState::Armed,
    },
];

/// Every run with a tolerance of its own, on top of a scene: the spread of a dozen vehicles from one parts list.
const SPREAD: &str = "[tolerances]
mass_kg = { uniform_percent = 5 }
inertia_kg_m2 = { uniform_percent = 7 }
rotor_inertia_kg_m2 = { uniform_percent = 10 }
arm_m = { uniform = 0.002 }
thrust_coefficient_n_s2 = { normal_percent = 6 }
torque_coefficient_n_m_s2 = { normal_percent = 10 }
motor_lag_tau_s = { uniform_percent = 30 }
cg_offset_m = { uniform = 0.005 }
gyro_scale_ppm = { normal = 10000 }
accel_scale_ppm = { normal = 5000 }
imu_mounting_mrad = { normal = 10 }
mag_hard_iron_ut = { normal = 2 }
";

fn flown(scene: &Scene, runs: u64) -> Vec<Run> {
    let mut scene = scene.clone();
    scene.seed = 0;
    let jobs = std::thread::available_parallelism().unwrap_or(NonZeroUsize::MIN);
    fly(&scene, &Campaign::new(&scene, runs), 0..runs, jobs, &AtomicBool::new(false), &|| ())
}

fn stay_within(runs: u64) {
    for (name, rmse_deg, distance_m) in WITHIN {
        for Run { number, outcome, .. } in flown(&Scene::load(name).unwrap(), runs) {
            assert_eq!(
                (outcome.crash, outcome.final_state),
                (None, ArmState::Disarmed),
                "{name}, seed {number}"
            );
            assert!(
                outcome.attitude_rmse_deg <= rmse_deg && outcome.position_error_max_m <= distance_m,
                "{name}, seed {number}: {outcome:?}"
            );
        }
    }
}

fn end_as_they_should(runs: u64) {
    for Outside { what, scene, crash, state } in OUTSIDE {
        let scene = Scene::parse(what, &format!("include = \"hover\"\n{scene}")).unwrap();
        for Run { number, outcome, .. } in flown(&scene, runs) {
            let ending = (outcome.crash.map(|(crash, _)| crash), outcome.final_state);
            assert_eq!(ending, (crash, state), "{what}, seed {number}: {outcome:?}");
        }
    }
}

fn fly_with_tolerances(runs: u64) {
    for name in ["hover", "steps", "windy-landing"] {
        let scene = Scene::parse(name, &format!("include = \"{name}\"\n{SPREAD}")).unwrap();
        for Run { number, outcome, drawn } in flown(&scene, runs) {
            let ending = (outcome.crash, outcome.final_state);
            assert_eq!(ending, (None, ArmState::Disarmed), "{name}, seed {number}: {drawn:?}");
            assert!(outcome.attitude_rmse_deg <= 7.0, "{name}, seed {number}: {outcome:?}");
        }
    }
}

#[test]
fn ten_seeds_of_every_scene_end_as_they_should() {
    stay_within(10);
    end_as_they_should(4);
    fly_with_tolerances(4);
}

#[test]
#[ignore = "a thousand seeds: 12,800 flights, minutes; .ci/run runs them"]
fn a_thousand_seeds_of_every_scene_end_as_they_should() {
    stay_within(1_000);
    end_as_they_should(200);
    fly_with_tolerances(200);
}

#[test]
fn every_scene_that_flies_is_within_or_outside() {
    let names = WITHIN.map(|(name, ..)| name);
    for built_in in BUILT_IN {
        // `motor-out` is the rotor gone of the list above.
        let flies = Scene::load(built_in.name).unwrap().pilot.is_some() && built_in.name != "motor-out";
        assert_eq!(names.contains(&built_in.name), flies, "{}", built_in.name);
    }
}

#[test]
fn the_page_has_every_tolerance() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/campaigns.md");
    let page = std::fs::read_to_string(path).unwrap();
    let said =
        Scene::parse("none", "include = \"hover\"\n[tolerances]\nno_such_key = 1\n").unwrap_err().to_string();
    let keys: Vec<&str> = said.split('`').skip(1).step_by(2).filter(|key| *key != "no_such_key").collect();
    assert_eq!(keys.len(), 12, "{said}");
    for key in keys {
        assert!(page.contains(&format!("| `{key}` |")), "docs/campaigns.md has no {key}");
    }
    for (scene, ..) in WITHIN {
        assert!(page.contains(&format!("| `{scene}` |")), "docs/campaigns.md has no {scene}");
    }
}
