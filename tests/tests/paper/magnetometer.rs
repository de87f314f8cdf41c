//! Eq 17: the heading with hard iron of 200 µT on the y axis.
//!
//! The vehicle stands level on the bench of scene `static`, at Ankara, and is turned by hand to eight headings. Its
//! flight controller runs the whole chain from counts.

use flight_core::calibration::SensorCalibration;
use flight_core::geometry::{Quaternion, Vec3, vec3};
use flight_core::sample::{ImuSample, Input, MagSample};
use sim_host::dynamics::{GRAVITY, State};
use sim_host::effects::Snapshot;
use sim_host::scene::{BUILT_IN, FIELD_ANKARA_UT, Scene};

use crate::still::STILL;

const HARD_IRON_UT: f64 = 200.0;

/// Five standard deviations of the heading, degrees. Magnetometer noise of 0.03 µT/√Hz relative to 25.4 µT of
/// horizontal field is 0.068 °/√Hz, and a first-order filter of τ = 0.3233 s leaves 1/√(2τ) of a density: 0.084°.
/// Noise of the tilt, times the tangent of the field's inclination of 58°, adds 0.02°.
const FIVE_DEVIATIONS_DEG: f64 = 0.45;

/// Returns the scene `static` with its estimator `paper`, without or with the calibration of the hard iron.
fn bench(calibrated: bool) -> Scene {
    let text = BUILT_IN.iter().find(|scene| scene.name == "static").expect("a built-in scene").text;
    let calibration = "[flight]\ncalibration.mag_ut.bias = [0.0, 200.0, 0.0]";
    let text = if calibrated { text.replacen("[flight]", calibration, 1) } else { text.into() };
    let scene = Scene::parse("static", &text).unwrap_or_else(|error| panic!("{error}"));
    let mag = scene.config.calibration.map(|calibration| calibration.mag);
    assert_eq!(mag != Some(SensorCalibration::NONE), calibrated);
    assert_eq!(
        scene.effects(),
        ["gyro.white_noise", "accel.white_noise", "mag.hard_iron", "mag.white_noise"]
    );
    scene
}

/// Returns the heading that the chain shows after 3 s (nine times τ) at this true heading, degrees.
fn shown_deg(scene: &Scene, heading_deg: f64) -> f64 {
    let half = 0.5 * heading_deg.to_radians();
    let attitude = Quaternion::new(libm::cos(half), 0.0, 0.0, libm::sin(half));
    let field = attitude.conjugate().rotate(FIELD_ANKARA_UT);
    let mut gyro = scene.gyro(scene.seed, 1000.0);
    let mut accel = scene.accel(scene.seed, 1000.0);
    let mut mag = scene.mag(scene.seed, 100.0);
    let state = State { attitude, ..*STILL.state };
    let mut controller = scene.controller();
    for ms in 0..3000 {
        let at = Snapshot { time_s: ms as f64 * 1e-3, state: &state, ..STILL };
        controller.step(&Input {
            time_us: ms * 1000,
            imu: Some(ImuSample {
                gyro: gyro.sample(Vec3::ZERO, &at),
                accel: accel.sample(vec3(0.0, 0.0, -GRAVITY), &at),
            }),
            mag: (ms % 10 == 0).then(|| MagSample { counts: mag.sample(field, &at) }),
            ..Input::default()
        });
    }
    f64::from(controller.attitude().to_euler().yaw).to_degrees()
}

/// Returns declination (rad) and horizontal strength (µT) of the field.
fn horizontal_field() -> (f64, f64) {
    let Vec3 { x, y, .. } = FIELD_ANKARA_UT;
    (libm::atan2(y, x), libm::hypot(x, y))
}

fn headings_deg() -> impl Iterator<Item = f64> {
    (0..8).map(|eighth| -180.0 + 45.0 * f64::from(eighth))
}

/// Returns the absolute difference a − b, wrapped to at most 180°, degrees.
fn apart_deg(a: f64, b: f64) -> f64 {
    libm::remainder(a - b, 360.0).abs()
}

#[test]
fn uncalibrated_hard_iron_holds_the_heading_near_minus_90() {
    let scene = bench(false);
    let (declination, level) = horizontal_field();
    // At every true heading, the measured horizontal field is the sum of 200 µT to the right and 25.4 µT in some
    // direction: the reading stays within 7.3° of −90°.
    let half_width_deg = libm::asin(level / HARD_IRON_UT).to_degrees();
    assert!((half_width_deg - 7.29).abs() < 0.01);
    for heading_deg in headings_deg() {
        let shown = shown_deg(&scene, heading_deg);
        let magnetic = heading_deg.to_radians() - declination;
        let (forward, right) = (level * libm::cos(magnetic), HARD_IRON_UT - level * libm::sin(magnetic));
        let expected = (libm::atan2(-right, forward) + declination).to_degrees();
        println!("true {heading_deg}°: shows {shown:.2}°, expected {expected:.2}°");
        assert!(apart_deg(shown, expected) < FIVE_DEVIATIONS_DEG, "{shown} {expected}");
        let centre = -90.0 + declination.to_degrees();
        assert!(apart_deg(shown, centre) < half_width_deg + FIVE_DEVIATIONS_DEG);
    }
    // In the built-in scene, facing north, the error is 77°.
    assert!(apart_deg(shown_deg(&scene, 0.0), -76.73) < FIVE_DEVIATIONS_DEG);
}

#[test]
fn calibrated_hard_iron_keeps_the_heading_accurate() {
    let scene = bench(true);
    for heading_deg in headings_deg() {
        let shown = shown_deg(&scene, heading_deg);
        assert!(apart_deg(shown, heading_deg) < FIVE_DEVIATIONS_DEG, "{shown} {heading_deg}");
    }
}
