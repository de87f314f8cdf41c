//! Closed-loop flights of the built-in scenes, judged on the truth.

use flight_core::ArmState;
use sim_host::flight::{Flight, Observer, Outcome, StepView};
use sim_host::scene::Scene;

fn fly(name: &str, seed: u64) -> Outcome {
    Flight::new(&Scene::load(name).unwrap(), seed).run(&mut ())
}

/// True roll and pitch over time, one value a millisecond, degrees.
#[derive(Default)]
struct Tilt {
    roll_deg: Vec<f64>,
    pitch_deg: Vec<f64>,
}

impl Observer for Tilt {
    fn step(&mut self, view: &StepView) {
        let down = view.truth.attitude.down();
        self.roll_deg.push(libm::atan2(down.y, down.z).to_degrees());
        self.pitch_deg.push(libm::asin(-down.x).to_degrees());
    }
}

#[test]
fn stand_steps_settle_within_0_6_s() {
    let scene = Scene::load("stand-steps").unwrap();
    let mut tilt = Tilt::default();
    let outcome = Flight::new(&scene, scene.seed).run(&mut tilt);
    assert_eq!(outcome.crash, None);
    assert!(outcome.attitude_rmse_deg <= 1.0, "{outcome:?}");
    // The vehicle rolls right and left, then pitches down (stick forward) and up. Each step goes there and back.
    let steps = [
        (&tilt.roll_deg, 6000, 0.0, 30.0),
        (&tilt.roll_deg, 8000, 30.0, 0.0),
        (&tilt.roll_deg, 10_000, 0.0, -30.0),
        (&tilt.roll_deg, 12_000, -30.0, 0.0),
        (&tilt.pitch_deg, 14_000, 0.0, -30.0),
        (&tilt.pitch_deg, 16_000, -30.0, 0.0),
        (&tilt.pitch_deg, 18_000, 0.0, 30.0),
        (&tilt.pitch_deg, 20_000, 30.0, 0.0),
    ];
    for (angle, at_ms, from_deg, to_deg) in steps {
        let held = &angle[at_ms..at_ms + 2000];
        // The progress of the step is 0 at its start and 1 at its target.
        let progress = |deg: &f64| (deg - from_deg) / (to_deg - from_deg);
        let overshoot = held.iter().map(progress).fold(0.0, f64::max) - 1.0;
        let late = held[600..].iter().map(|deg| (progress(deg) - 1.0).abs()).fold(0.0, f64::max);
        println!("step at {at_ms} ms to {to_deg}°: overshoot {overshoot:.3}, after 0.6 s within {late:.4}");
        assert!(overshoot <= 0.15, "step at {at_ms} ms overshoots by {overshoot}");
        assert!(late <= 0.05, "step at {at_ms} ms is off by {late} after 0.6 s");
    }
}

#[test]
fn steps_with_flight_estimator_stay_within_error_bounds() {
    let outcome = fly("steps", 7);
    assert_eq!(outcome.crash, None);
    assert!(outcome.attitude_rmse_deg <= 2.0 && outcome.tilt_error_max_deg <= 3.0, "{outcome:?}");
    // The doublets were flown: the vehicle tilted by 30°.
    assert!(outcome.tilt_max_deg > 29.0 && outcome.tilt_max_deg < 34.5, "{outcome:?}");
}

#[test]
fn hover_stays_within_half_a_metre_lands_and_disarms() {
    let outcome = fly("hover", 7);
    assert_eq!((outcome.crash, outcome.final_state), (None, ArmState::Disarmed));
    assert!(outcome.position_error_max_m <= 0.5 && outcome.attitude_rmse_deg <= 1.0, "{outcome:?}");
}

#[test]
fn hundred_seeds_of_each_scene_do_not_crash() {
    for name in ["hover", "steps", "stand-steps"] {
        let scene = Scene::load(name).unwrap();
        for seed in 0..100 {
            let outcome = Flight::new(&scene, seed).run(&mut ());
            assert_eq!(
                (outcome.crash, outcome.final_state),
                (None, ArmState::Disarmed),
                "{name}, seed {seed}"
            );
            assert!(outcome.attitude_rmse_deg <= 1.0, "{name}, seed {seed}: {outcome:?}");
            if name == "hover" {
                assert!(outcome.position_error_max_m <= 0.5, "seed {seed}: {outcome:?}");
            }
        }
    }
}

#[test]
fn equal_seeds_fly_equally_and_others_differ() {
    for name in ["hover", "steps", "stand-steps"] {
        assert_eq!(fly(name, 7), fly(name, 7));
        assert_ne!(fly(name, 7).digest, fly(name, 8).digest);
    }
}

/// Records when the motors are permitted to turn, and any violation.
#[derive(Default)]
struct Permits {
    first_us: Option<u64>,
    without_state: bool,
    turning_without: bool,
}

impl Observer for Permits {
    fn step(&mut self, view: &StepView) {
        let permitted = view.output.driven;
        if permitted && self.first_us.is_none() {
            self.first_us = Some(view.time_us);
        }
        self.without_state |= permitted != view.output.state.flies();
        self.turning_without |= !permitted && view.output.pulses_us != [1000.0; 4];
    }
}

#[test]
fn motors_are_off_before_arming_and_after_landing() {
    let scene = Scene::load("hover").unwrap();
    let mut permits = Permits::default();
    Flight::new(&scene, scene.seed).run(&mut permits);
    // The gesture starts at 3 s and is held for 1 s; then the checks take another 0.5 s.
    assert_eq!(permits.first_us, Some(4_501_000));
    assert!(!permits.without_state && !permits.turning_without);
}

/// Returns a built-in scene with some of its text replaced.
fn altered(name: &str, changes: &[(&str, &str)]) -> Scene {
    let built_in = sim_host::scene::BUILT_IN.iter().find(|scene| scene.name == name).unwrap();
    let text = changes.iter().fold(built_in.text.to_owned(), |text, (from, to)| {
        assert!(text.contains(from), "{name} has no {from}");
        text.replace(from, to)
    });
    Scene::parse("altered", &text).unwrap()
}

#[test]
fn removing_an_effect_keeps_the_draws_of_the_others() {
    // With and without the gyroscope's noise, the accelerometer of the vehicle at rest reads the same counts.
    struct Counts(Vec<[i16; 3]>);
    impl Observer for Counts {
        fn step(&mut self, view: &StepView) {
            self.0.extend(view.input.imu.map(|imu| imu.accel));
        }
    }
    let counts = |scene: &Scene| {
        let mut counts = Counts(vec![]);
        Flight::new(scene, 1).run(&mut counts);
        counts.0
    };
    let with = altered("static", &[("duration_s = 60.0", "duration_s = 1.0")]);
    let without = altered(
        "static",
        &[
            ("duration_s = 60.0", "duration_s = 1.0"),
            ("[effects.gyro.white_noise]", ""),
            ("n_deg_per_sqrt_h = [1.9368, 1.239, 1.239]", ""),
        ],
    );
    assert_eq!(with.effects().len(), without.effects().len() + 1);
    assert_eq!(counts(&with), counts(&without));
}

#[test]
fn overloaded_vehicle_stays_on_the_ground() {
    // A file with this mass would be refused, so the mass is changed in the loaded scene.
    let mut scene = Scene::load("hover").unwrap();
    scene.vehicle.mass_kg = 1.4;
    let outcome = Flight::new(&scene, 7).run(&mut ());
    assert_eq!((outcome.crash, outcome.position_error_max_m), (None, 0.0));
    assert!(outcome.tilt_max_deg < 1.0);
}

/// True body rates, °/s, and the true tilt, one entry a millisecond.
#[derive(Default)]
struct Turns {
    rates_deg_s: Vec<[f64; 3]>,
    tilt_deg: Vec<f64>,
}

impl Observer for Turns {
    fn step(&mut self, view: &StepView) {
        let rates = <[f64; 3]>::from(view.truth.rates);
        self.rates_deg_s.push(rates.map(f64::to_degrees));
        self.tilt_deg.push(libm::acos(view.truth.cos_tilt().min(1.0)).to_degrees());
    }
}

#[test]
fn rate_mode_follows_sticks_and_holds_tilt_when_centred() {
    let moves = "
        [[pilot.move]]
        at_s = 15.0
        for_s = 0.3
        roll = 0.5
        mode = \"rate\"
        [[pilot.move]]
        at_s = 15.3
        for_s = 0.6
        throttle = 0.6
        mode = \"rate\"
        [[pilot.move]]
        at_s = 15.9
        for_s = 0.3
        roll = -0.5
        mode = \"rate\"\n";
    let pilot = "[pilot]\nkind = \"script\"\nbase = \"hold\"\n";
    let scene = Scene::parse("rate", &format!("include = \"hover\"\n{pilot}{moves}")).unwrap();
    let mut turns = Turns::default();
    let outcome = Flight::new(&scene, scene.seed).run(&mut turns);
    assert_eq!((outcome.crash, outcome.final_state), (None, ArmState::Disarmed), "{outcome:?}");

    // Half stick commands half of 180 °/s. The sticks are 20 ms late; the loop settles in 0.15 s.
    let p = scene.config.params.control;
    let commanded = f64::from(0.5 * p.max_stick_rate_rad_s).to_degrees();
    for [x, y, z] in &turns.rates_deg_s[15_200..15_300] {
        assert!(
            (x - commanded).abs() < 0.1 * commanded && y.abs() < 3.0 && z.abs() < 3.0,
            "{x} {y} {z}, commanded {commanded}"
        );
    }
    // With centred sticks the tilt stays; in angle mode the vehicle would be level after 0.5 s.
    let held = &turns.tilt_deg[15_500..15_900];
    let (min, max) = held.iter().fold((f64::MAX, 0.0_f64), |(l, m), t| (l.min(*t), m.max(*t)));
    println!("commanded {commanded:.1} deg/s; held {min:.1} to {max:.1} deg");
    assert!(min > 15.0 && max - min < 4.0, "{min} to {max}");
}

#[test]
fn full_stick_reversals_do_not_exceed_the_tilt_limit() {
    // 45° in roll and in pitch give 60° of tilt. The opposite sticks then command a tilt that is 120° from it.
    let moves: String = (0..8)
        .map(|k| {
            let (at_s, side) = (26.0 + 0.6 * f64::from(k), if k % 2 == 0 { 1.0 } else { -1.0 });
            format!("[[pilot.move]]\nat_s = {at_s}\nfor_s = 0.6\nroll = {side:.1}\npitch = {side:.1}\n")
        })
        .collect();
    let text = format!(
        "include = \"hover\"\n[scene]\nduration_s = 45.0\n[pilot]\nkind = \"script\"\nbase = \"hold\"\narm_at_s = 3.0\n\
         take_off_at_s = 5.0\nheight_m = 50.0\nland_before_end_s = 4.0\n{moves}"
    );
    let scene = Scene::parse("stops.toml", &text).unwrap();
    let mut tilt = Tilt::default();
    let outcome = Flight::new(&scene, scene.seed).run(&mut tilt);
    let largest = |angle: &[f64]| angle.iter().fold(0.0, |max: f64, deg| max.max(deg.abs()));
    assert!(largest(&tilt.roll_deg) > 40.0 && largest(&tilt.pitch_deg) > 35.0, "{outcome:?}");
    assert_eq!((outcome.crash, outcome.final_state), (None, ArmState::Armed), "{outcome:?}");
}
