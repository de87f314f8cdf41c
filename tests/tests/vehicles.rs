//! Vehicles as files: each flies what OS4 flies, with what is derived for it, and nothing of it is OS4's.

use std::num::NonZeroUsize;
use std::sync::atomic::AtomicBool;

use flight_core::ArmState;
use flight_core::geometry::Vec3;
use sim_host::campaign::{Campaign, fly};
use sim_host::flight::{Flight, Observer, Outcome, StepView};
use sim_host::report::step_response::{STEP_SHARE, StepResponse};
use sim_host::scene::Scene;
use vehicle::{MARGIN_DEG, Plant, Vehicle, tune};

const CORES: NonZeroUsize = NonZeroUsize::new(2).unwrap();

fn scene(name: &str, vehicle: &str) -> Scene {
    Scene::load_with_vehicle(name, Some(vehicle)).unwrap()
}

#[track_caller]
fn flew(outcome: &Outcome, what: &str) {
    assert_eq!((outcome.crash, outcome.final_state), (None, ArmState::Disarmed), "{what}: {outcome:?}");
}

/// What a flight looks like from outside: how high, how fast it came down, and where it was at the end.
#[derive(Default)]
struct Seen {
    highest_m: f64,
    fastest_down_m_s: f64,
    end: Option<Vec3<f64>>,
}

impl Observer for Seen {
    fn step(&mut self, view: &StepView) {
        self.highest_m = self.highest_m.max(-view.truth.position.z);
        self.fastest_down_m_s = self.fastest_down_m_s.max(view.truth.velocity.z);
        self.end = Some(view.truth.position);
    }
}

#[test]
fn every_built_in_vehicle_hovers_and_turns_to_30_degrees() {
    for (vehicle, _) in vehicle::BUILT_IN {
        let hover = scene("hover", vehicle);
        let mut seen = Seen::default();
        flew(&Flight::new(&hover, 7).run(&mut seen), vehicle);
        assert!((seen.highest_m - 2.0).abs() < 0.3, "{vehicle} hovers at {} m", seen.highest_m);
        let steps = Flight::new(&scene("steps", vehicle), 7).run(&mut ());
        flew(&steps, vehicle);
        assert!((30.0..34.0).contains(&steps.tilt_max_deg), "{vehicle}: {steps:?}");
    }
}

/// Every seed has another noise: a hundred of them.
#[test]
fn a_hundred_seeds_with_five_inches() {
    for name in ["hover", "steps"] {
        let scene = scene(name, "five-inch");
        let campaign = Campaign::new(&scene, 100);
        let runs = fly(&scene, &campaign, 0..100, CORES, &AtomicBool::new(false), &|| {});
        assert_eq!(runs.len(), 100);
        for run in runs {
            flew(&run.outcome, &format!("{name}, run {}", run.number));
        }
    }
}

/// With the throttle of another vehicle's descent, one with a thrust to weight of 5 would climb when its pilot is gone.
#[test]
fn a_lost_link_lands_every_vehicle() {
    for (vehicle, _) in vehicle::BUILT_IN {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("lost.toml");
        std::fs::write(
            &path,
            "include = \"hover\"\n[scene]\nduration_s = 60.0\n[effects.link.outage]\nat_s = 12.0\n",
        )
        .unwrap();
        let scene = scene(path.to_str().unwrap(), vehicle);
        let mut seen = Seen::default();
        let outcome = Flight::new(&scene, 7).run(&mut seen);
        assert_eq!(outcome.crash, None, "{vehicle}: {outcome:?}");
        assert!(seen.highest_m < 2.4, "{vehicle} climbs to {} m", seen.highest_m);
        // 5 % of the weight against the drag of 0.35 /s of the mass: 1.4 m/s.
        assert!(seen.fastest_down_m_s < 1.9, "{vehicle} sinks with {} m/s", seen.fastest_down_m_s);
        assert!(seen.end.is_some_and(|end| end.z > -0.15), "{vehicle} is in the air at the end: {outcome:?}");
    }
}

/// The file that docs/vehicles.md shows: a three-inch quadrotor by its maker's figures.
#[test]
fn the_file_of_the_page_flies() {
    let page = include_str!("../../docs/vehicles.md");
    let text = page
        .split("```toml\n")
        .nth(1)
        .and_then(|rest| rest.split("```").next())
        .expect("the page has a file");
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("three-inch.toml");
    std::fs::write(&path, text).unwrap();
    for name in ["hover", "steps"] {
        let outcome = Flight::new(&scene(name, path.to_str().unwrap()), 7).run(&mut ());
        flew(&outcome, name);
    }
}

/// One truth: what the simulator flies and what the flight controller is told are read from one file.
#[test]
fn a_change_of_the_file_changes_both_sides() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mine.toml");
    let text = vehicle::BUILT_IN.iter().find(|(name, _)| *name == "five-inch").unwrap().1;
    let mut seen = Vec::new();
    for mass_g in ["650.0", "800.0"] {
        std::fs::write(&path, text.replace("mass_g = 650.0", &format!("mass_g = {mass_g}"))).unwrap();
        let scene = scene("hover", path.to_str().unwrap());
        let params = scene.config.params;
        // Hover throttle by hand.
        let hover = mass_g.parse::<f64>().unwrap() / 1e3 * 9.80665 / (4.0 * 1.2e-6 * 2570.0 * 2570.0);
        assert!((f64::from(params.descent.throttle) / (0.95 * hover) - 1.0).abs() < 1e-6);
        assert!((scene.vehicle.mass_kg * 1e3 - mass_g.parse::<f64>().unwrap()).abs() < 1e-9);
        seen.push((params.descent.throttle, Flight::new(&scene, 7).run(&mut ()).digest));
    }
    assert!(seen[0].0 != seen[1].0 && seen[0].1 != seen[1].1, "{seen:?}");
}

/// The table of docs/tuning.md.
#[test]
fn proposed_gains_are_those_of_the_page() {
    let page = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/tuning.md")).unwrap();
    for (name, _) in vehicle::BUILT_IN {
        let row = page.lines().find(|line| line.starts_with(&format!("| `{name}`"))).unwrap();
        let cells = row.split('|').skip(2).filter_map(|cell| cell.trim().parse().ok());
        let of_page: Vec<f64> = cells.collect();
        let vehicle = Vehicle::load(name).unwrap();
        let plant = Plant::of(&vehicle);
        let tuned = tune(&vehicle.params, &plant, MARGIN_DEG);
        let mut control = vehicle.control;
        tuned.put_into(&mut control);
        let mut scene = scene("steps", name);
        scene.set_control(control).unwrap();
        let mut response = StepResponse::default();
        flew(&Flight::new(&scene, scene.seed).run(&mut response), name);
        let asked_rad = STEP_SHARE * f64::from(control.max_tilt_rad);
        let found = [
            plant.lag_s * 1e3,
            tuned.tilt.p,
            tuned.tilt.k,
            tuned.yaw.p,
            plant.margin(&tuned.tilt).crossover_rad_s / std::f64::consts::TAU,
            response.answered(asked_rad).rise_s.unwrap(),
            100.0 * (response.largest_tilt_rad() / asked_rad - 1.0),
        ];
        // To half of the page's last digit.
        for ((of_page, found), half) in
            of_page.iter().zip(found).zip([0.5, 0.06, 0.006, 0.06, 0.006, 0.006, 0.6])
        {
            assert!((of_page - found).abs() <= half, "{name}: {of_page} on the page, {found}");
        }
        assert_eq!(of_page.len(), found.len());
    }
}
