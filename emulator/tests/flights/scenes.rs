//! All scenes with a pilot, compared with the same scene flown in process.

use emulator::replay;
use sim_host::flight::{Flight, Outcome};

use super::{assert_healthy, assert_sound, fly, fly_twice, scene};

/// Flies a scene on the emulated board and in process, compares the two, and replays the records of the board in process.
///
/// # Derivation of the bounds
/// The two flights differ in four points. The board begins to sample 60 ms after the start of the world. A command reaches
/// the rotor up to a PWM period or a DShot frame later, in whole counts of the timer. The receiver's frame arrives in the
/// next millisecond, one step later. The battery is measured in steps of 9 mV. The noise therefore acts at other times, and
/// the errors of the estimates are of the same size but not equal. With the scenes' own seeds the RMSE differs by up to 18 %
/// (`windy-landing`); the bounds allow more than twice this. The distance from the target may differ by 0.2 m because of the
/// later commands.
#[track_caller]
fn compare(name: &str) {
    let scene = scene(name, None);
    let flown = fly(&scene, &[]);
    assert_healthy(&flown);
    let emulated: &Outcome = &flown.outcome;
    let here = Flight::new(&scene, scene.seed).run(&mut ());
    println!(
        "{name}: RMSE {:.3}° in process, {:.3}° emulated; tilt error {:.2}°, {:.2}°; distance {:.3} m, {:.3} m",
        here.attitude_rmse_deg,
        emulated.attitude_rmse_deg,
        here.tilt_error_max_deg,
        emulated.tilt_error_max_deg,
        here.position_error_max_m,
        emulated.position_error_max_m
    );
    let within =
        |emulated: f64, here: f64, share: f64, margin: f64| (emulated - here).abs() <= share * here + margin;
    assert!(within(emulated.attitude_rmse_deg, here.attitude_rmse_deg, 0.5, 0.2), "{name}: attitude");
    assert!(
        within(emulated.inclination_rmse_deg, here.inclination_rmse_deg, 0.5, 0.2),
        "{name}: inclination"
    );
    // A smaller error passes: `windy-landing` has 11° in its first 5 ms, before the board samples.
    assert!(emulated.tilt_error_max_deg <= 1.5 * here.tilt_error_max_deg + 0.5, "{name}: tilt error");
    assert!(within(emulated.position_error_max_m, here.position_error_max_m, 0.1, 0.2), "{name}: distance");

    let config = replay::on_board(&scene.config, &flown.wiring);
    match replay::replay(&flown.records, &config) {
        Ok(steps) => {
            assert!(steps as u64 + 100 > emulated.control_steps, "{name}: only {steps} steps recorded")
        }
        Err(difference) => panic!("{name}: {difference:?}"),
    }
}

macro_rules! scenes {
    ($($test:ident: $name:literal),* $(,)?) => {
        $(#[test]
        fn $test() {
            compare($name);
        })*

        #[test]
        fn each_scene_with_a_pilot_has_a_test() {
            let here = [$($name),*];
            for built_in in sim_host::scene::BUILT_IN.iter() {
                let scene = scene(built_in.name, None);
                // `motor-out` must end in a crash and has its own test.
                let flies = scene.pilot.is_some() && built_in.name != "motor-out";
                assert_eq!(flies, here.contains(&built_in.name), "{}", built_in.name);
            }
        }
    };
}

scenes! {
    flies_bad_link: "bad-link",
    flies_hot_day: "hot-day",
    flies_magnetic_site: "magnetic-site",
    flies_rough_sampling: "rough-sampling",
    flies_shaky_frame: "shaky-frame",
    flies_stand_steps: "stand-steps",
    flies_steps: "steps",
    flies_weak_battery: "weak-battery",
    flies_whole_drive: "whole-drive",
    flies_windy_landing: "windy-landing",
    flies_hover: "hover",
}

#[test]
fn repeated_flight_is_identical() {
    assert_healthy(&fly_twice(&scene("hover", Some(16.0)), &[]));
}

#[test]
fn stopped_rotor_ends_in_a_crash() {
    let flown = fly(&scene("motor-out", None), &[]);
    assert_sound(&flown);
    assert!(flown.outcome.crash.is_some());
}
