//! Vehicles as files: each flies the scenes of OS4 with its own derived parameters and none of OS4's.

use std::num::NonZeroUsize;
use std::sync::atomic::AtomicBool;

use flight_core::ArmState;
use flight_core::geometry::Vec3;
use sim_host::campaign::{Campaign, fly};
use sim_host::flight::{Flight, Observer, Outcome, StepView};
use sim_host::report::step_response::{STEP_STICK_SHARE, StepResponse};
use sim_host::scene::Scene;
use vehicle::{MARGIN_DEG, Plant, Vehicle, tune};

const CORES: NonZeroUsize = NonZeroUsize::new(2).unwrap();

fn scene(name: &str, vehicle: &str) -> Scene {
    Scene::load_with_vehicle(name, Some(vehicle)).unwrap()
}

#[track_caller]
fn assert_landed_and_disarmed(outcome: &Outcome, what: &str) {
    assert_eq!((outcome.crash, outcome.final_state), (None, ArmState::Disarmed), "{what}: {outcome:?}");
}

/// Extremes of a flight: greatest height, fastest descent, and final position.
#[derive(Default)]
struct FlightExtremes {
    highest_m: f64,
    fastest_down_m_s: f64,
    end: Option<Vec3<f64>>,
}

impl Observer for FlightExtremes {
    fn step(&mut self, view: &StepView) {
        self.highest_m = self.highest_m.max(-view.truth.position.z);
        self.fastest_down_m_s = self.fastest_down_m_s.max(view.truth.velocity.z);
        self.end = Some(view.truth.position);
    }
}

#[test]
fn every_built_in_vehicle_hovers_and_tilts_to_30_degrees() {
    for (vehicle, _) in vehicle::BUILT_IN {
        let hover = scene("hover", vehicle);
        let mut extremes = FlightExtremes::default();
        assert_landed_and_disarmed(&Flight::new(&hover, 7).run(&mut extremes), vehicle);
        assert!((extremes.highest_m - 2.0).abs() < 0.3, "{vehicle} hovers at {} m", extremes.highest_m);
        let steps = Flight::new(&scene("steps", vehicle), 7).run(&mut ());
        assert_landed_and_disarmed(&steps, vehicle);
        assert!((30.0..34.0).contains(&steps.tilt_max_deg), "{vehicle}: {steps:?}");
    }
}

/// A hundred seeds, each with different noise.
#[test]
fn hundred_seeds_with_five_inch_do_not_crash() {
    for name in ["hover", "steps"] {
        let scene = scene(name, "five-inch");
        let campaign = Campaign::new(&scene, 100);
        let runs = fly(&scene, &campaign, 0..100, CORES, &AtomicBool::new(false), &|| {});
        assert_eq!(runs.len(), 100);
        for run in runs {
            assert_landed_and_disarmed(&run.outcome, &format!("{name}, run {}", run.number));
        }
    }
}

/// The descent throttle must be the vehicle's own. With that of another vehicle, a vehicle with a thrust-to-weight
/// ratio of 5 would climb.
#[test]
fn link_loss_lands_every_vehicle() {
    for (vehicle, _) in vehicle::BUILT_IN {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("lost.toml");
        std::fs::write(
            &path,
            "include = \"hover\"\n[scene]\nduration_s = 60.0\n[effects.link.outage]\nat_s = 12.0\n",
        )
        .unwrap();
        let scene = scene(path.to_str().unwrap(), vehicle);
        let mut extremes = FlightExtremes::default();
        let outcome = Flight::new(&scene, 7).run(&mut extremes);
        assert_eq!(outcome.crash, None, "{vehicle}: {outcome:?}");
        assert!(extremes.highest_m < 2.4, "{vehicle} climbs to {} m", extremes.highest_m);
        // 5 % of the weight acts against a drag of 0.35 /s times the mass, which gives 1.4 m/s.
        assert!(extremes.fastest_down_m_s < 1.9, "{vehicle} descends with {} m/s", extremes.fastest_down_m_s);
        assert!(
            extremes.end.is_some_and(|end| end.z > -0.15),
            "{vehicle} is in the air at the end: {outcome:?}"
        );
    }
}

/// The file that docs/vehicles.md shows: a three-inch quadrotor with its manufacturer's figures.
#[test]
fn vehicle_file_of_the_page_flies() {
    let page = include_str!("../../docs/vehicles.md");
    let text = page
        .split("```toml\n")
        .nth(1)
        .and_then(|rest| rest.split("```").next())
        .expect("a vehicle file on the page");
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("three-inch.toml");
    std::fs::write(&path, text).unwrap();
    for name in ["hover", "steps"] {
        let outcome = Flight::new(&scene(name, path.to_str().unwrap()), 7).run(&mut ());
        assert_landed_and_disarmed(&outcome, name);
    }
}

/// The simulator and the flight controller take their parameters from the same vehicle file.
#[test]
fn vehicle_file_sets_both_simulator_and_controller() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mine.toml");
    let text = vehicle::BUILT_IN.iter().find(|(name, _)| *name == "five-inch").unwrap().1;
    let mut results = Vec::new();
    for mass_g in ["650.0", "800.0"] {
        std::fs::write(&path, text.replace("mass_g = 650.0", &format!("mass_g = {mass_g}"))).unwrap();
        let scene = scene("hover", path.to_str().unwrap());
        let params = scene.config.params;
        // Hover throttle computed by hand.
        let hover = mass_g.parse::<f64>().unwrap() / 1e3 * 9.80665 / (4.0 * 1.2e-6 * 2570.0 * 2570.0);
        assert!((f64::from(params.descent.throttle) / (0.95 * hover) - 1.0).abs() < 1e-6);
        assert!((scene.vehicle.mass_kg * 1e3 - mass_g.parse::<f64>().unwrap()).abs() < 1e-9);
        results.push((params.descent.throttle, Flight::new(&scene, 7).run(&mut ()).digest));
    }
    assert!(results[0].0 != results[1].0 && results[0].1 != results[1].1, "{results:?}");
}

/// Compares with the table of docs/tuning.md.
#[test]
fn proposed_gains_equal_the_tuning_page() {
    let page = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/tuning.md")).unwrap();
    for (name, _) in vehicle::BUILT_IN {
        let row = page.lines().find(|line| line.starts_with(&format!("| `{name}`"))).unwrap();
        let cells = row.split('|').skip(2).filter_map(|cell| cell.trim().parse().ok());
        let of_page: Vec<f64> = cells.collect();
        let vehicle = Vehicle::load(name).unwrap();
        let plant = Plant::of(&vehicle);
        let tuned = tune(&vehicle.params, &plant, MARGIN_DEG);
        let mut control = vehicle.control;
        tuned.apply_to(&mut control);
        let mut scene = scene("steps", name);
        scene.set_control(control).unwrap();
        let mut response = StepResponse::default();
        assert_landed_and_disarmed(&Flight::new(&scene, scene.seed).run(&mut response), name);
        let step_rad = STEP_STICK_SHARE * f64::from(control.max_tilt_rad);
        let found = [
            plant.lag_s * 1e3,
            tuned.tilt.p,
            tuned.tilt.k,
            tuned.yaw.p,
            plant.margin(&tuned.tilt).crossover_rad_s / std::f64::consts::TAU,
            response.metrics(step_rad).rise_s.unwrap(),
            100.0 * (response.max_tilt_rad() / step_rad - 1.0),
        ];
        // The tolerance is half a unit of the page's last digit.
        for ((of_page, found), half) in
            of_page.iter().zip(found).zip([0.5, 0.06, 0.006, 0.06, 0.006, 0.006, 0.6])
        {
            assert!((of_page - found).abs() <= half, "{name}: {of_page} on the page, {found}");
        }
        assert_eq!(of_page.len(), found.len());
    }
}
