//! Sensors that show nothing, too much, or at the wrong time.

use flight_core::ArmState;
use flight_core::estimator::EstimatorParams;
use flight_core::geometry::{Quaternion, Vec3, vec3};
use sim_host::flight::{Flight, Outcome};
use sim_host::scene::Scene;

use crate::truth::{Body, FIELD_UT, GRAVITY, is_accurate, rotation, single, tau_s};

#[test]
fn ten_seconds_of_free_fall_keep_the_estimate() {
    for (name, params) in EstimatorParams::PRESETS {
        let mut body = Body::at(rotation(vec3(0.3, 0.2, 1.0)), &params);
        for _ in 0..10_000 {
            body.turn_without_references(Vec3::ZERO, 1e-3);
        }
        assert!(body.error_deg() < 0.02, "{name}: {}°", body.error_deg());
    }
}

#[test]
fn four_g_for_a_second_tilt_by_at_most_the_closed_form() {
    // Level, with a lateral acceleration of 4 g: the specific force is 76° off the vertical.
    let pushed = single(vec3(0.0, 4.0 * GRAVITY.z, -GRAVITY.z));
    let force_angle_deg = 4.0_f64.atan().to_degrees();
    for (name, params) in EstimatorParams::PRESETS {
        let mut body = Body::at(Quaternion::IDENTITY, &params);
        for _ in 0..60_000 {
            body.turn(Vec3::ZERO, 1e-3);
        }
        for _ in 0..1_000 {
            body.estimator.update(Vec3::ZERO, pushed, Some(single(FIELD_UT)), 1e-3);
        }
        let bound = match name {
            // By eq 18 the error is the share 1 − e^(−t/τ) of the angle.
            "flight" => force_angle_deg * (1.0 - (-0.1_f64).exp()) * 1.02,
            // The error is 0.645 Δv/(g τ) = 0.52 rad, by docs/estimators.md.
            "robust" => (0.645 * 4.0 / 5.0_f64).to_degrees(),
            // These filters follow the force completely after more than two time constants, and so does their heading.
            _ => 180.0,
        };
        assert!(body.error_deg() < bound, "{name}: {}°, {bound}°", body.error_deg());
    }
}

#[test]
fn four_g_for_half_a_minute_tilt_at_most_to_the_force() {
    // No filter without a velocity can distinguish this from a tilt, but the estimate must not turn beyond the force.
    // The robust filter may overshoot: with √17 g its loop is s² + 2s/τ + 2√17/τ², of damping ζ = 1/√(2√17) = 0.35,
    // which overshoots by e^(−πζ/√(1 − ζ²)) = 0.31.
    let pushed = single(vec3(0.0, 4.0 * GRAVITY.z, -GRAVITY.z));
    let force_angle_deg = 4.0_f64.atan().to_degrees();
    let zeta = (2.0 * 17.0_f64.sqrt()).sqrt().recip();
    let overshoot = (-std::f64::consts::PI * zeta / (1.0 - zeta * zeta).sqrt()).exp();
    for (name, params) in EstimatorParams::PRESETS {
        let mut body = Body::at(Quaternion::IDENTITY, &params);
        (0..60_000).for_each(|_| body.turn(Vec3::ZERO, 1e-3));
        for _ in 0..30_000 {
            body.estimator.update(Vec3::ZERO, pushed, None, 1e-3);
            let tilt = body.inclination_deg();
            let max_deg = force_angle_deg * if name == "robust" { 1.0 + overshoot } else { 1.0 + 1e-3 };
            assert!(tilt < max_deg, "{name}: {tilt}°");
        }
        // A manoeuvre must not change the estimated bias much. The estimator `robust` changes it only if the error
        // looks like the last degrees of a correction.
        let bias = body.estimator.gyro_bias().norm().to_degrees();
        assert!(bias < 0.3, "{name}: a bias of {bias} °/s");
        // The estimate recovers when the acceleration ends.
        let tau_steps = (tau_s(&params) * 1e3) as u32;
        (0..8 * tau_steps).for_each(|_| body.turn(Vec3::ZERO, 1e-3));
        assert!(body.inclination_deg() < 0.5, "{name}: {}°", body.inclination_deg());
    }
}

#[test]
fn missing_or_vertical_field_keeps_the_gyro_heading() {
    for (name, params) in EstimatorParams::PRESETS {
        for field in [Vec3::ZERO, vec3(0.0, 0.0, 48.0), vec3(1e-30, -1e-38, 0.0)] {
            let mut body = Body::at(rotation(vec3(0.0, 0.0, 1.0)), &params);
            for _ in 0..10_000 {
                body.estimator.update(Vec3::ZERO, single(-GRAVITY), Some(single(field)), 1e-3);
            }
            assert!(body.error_deg() < 0.02, "{name}, {field:?}: {}°", body.error_deg());
        }
    }
}

#[test]
fn saturated_gyroscope_recovers_without_a_false_bias() {
    // 3,000 °/s for 0.2 s with a range of 2,000 °/s: 200° are missed, and must be recovered.
    for (name, params) in EstimatorParams::PRESETS {
        let mut body = Body::at(Quaternion::IDENTITY, &params);
        (0..20_000).for_each(|_| body.turn(Vec3::ZERO, 1e-3));
        let (true_rate, seen) = (vec3(3_000.0_f64.to_radians(), 0.0, 0.0), 2_000.0_f64.to_radians());
        for _ in 0..200 {
            let before = body.attitude;
            body.attitude = (before * rotation(true_rate * 1e-3)).normalized();
            let into_body = |v| body.attitude.conjugate().rotate(v);
            let (accel, mag) = (single(into_body(-GRAVITY)), single(into_body(FIELD_UT)));
            body.estimator.update(single(vec3(seen, 0.0, 0.0)), accel, Some(mag), 1e-3);
            assert!(body.error_deg().is_finite(), "{name}");
        }
        // An inverted estimate must not teach a bias.
        let mut bias = 0.0_f32;
        for _ in 0..150_000 {
            body.turn(Vec3::ZERO, 1e-3);
            bias = bias.max(body.estimator.gyro_bias().norm().to_degrees());
        }
        assert!(bias < 0.1, "{name}: a bias of {bias} °/s");
        assert!(body.error_deg() < 0.5, "{name}: {}°", body.error_deg());
    }
}

#[test]
fn denormal_and_zero_samples_keep_the_estimate() {
    for (name, params) in EstimatorParams::PRESETS {
        let mut body = Body::at(Quaternion::IDENTITY, &params);
        for tiny in [0.0, -0.0, f32::MIN_POSITIVE, 1e-45, -1e-40] {
            let v = vec3(tiny, -tiny, tiny);
            for _ in 0..100 {
                body.estimator.update(v, v, Some(v), 1e-3);
                body.estimator.update(v, v, Some(v), 0.0);
            }
        }
        assert!(body.error_deg() < 0.02, "{name}: {}°", body.error_deg());
    }
}

/// Flies the scene `steps` with these tables added, with five seeds.
fn flights(tables: &str) -> Vec<Outcome> {
    let scene = Scene::parse("hard.toml", &format!("include = \"steps\"\n{tables}")).unwrap();
    (0..5).map(|seed| Flight::new(&scene, seed).run(&mut ())).collect()
}

fn check_all_land(tables: &str, tilt_error_deg: f64) {
    for outcome in flights(tables) {
        assert_eq!((outcome.crash, outcome.final_state), (None, ArmState::Disarmed), "{tables}: {outcome:?}");
        assert!(outcome.tilt_error_max_deg < tilt_error_deg, "{tables}: {outcome:?}");
    }
}

#[test]
fn full_scale_spikes_are_flown_through() {
    // One sample of 2,000 °/s adds 2° of false turn; 16 g for a millisecond moves the estimate by 1e-4 of any angle.
    for (sensor, axis) in [("gyro", "x"), ("gyro", "z"), ("accel", "y")] {
        let spikes: String = (0..5)
            .map(|k| {
                let at_s = 14.2 + 0.5 * f64::from(k);
                format!(
                    "[[fault]]\nkind = \"spike\"\nsensor = \"{sensor}\"\naxis = \"{axis}\"\ncounts = 32767\nat_s = {at_s}\nfor_s = 0.001\n"
                )
            })
            .collect();
        check_all_land(&spikes, 1.8 + 2.2 * 5.0);
    }
}

#[test]
fn lost_and_jittered_samples_are_flown_through() {
    // The scene `rough-sampling` has lower values of both.
    check_all_land("[effects.imu.dropped_samples]\nprobability = 0.1\n", 4.0);
    check_all_land("[effects.imu.sampling_jitter]\nsigma_us = 160.0\n", 4.0);
}

#[test]
fn gap_of_a_second_keeps_an_accurate_estimate() {
    for (name, params) in EstimatorParams::PRESETS {
        let mut body = Body::at(Quaternion::IDENTITY, &params);
        for _ in 0..5_000 {
            body.turn(vec3(0.0, 0.0, 0.5), 1e-3);
        }
        // The pause is a single step of 1 s, which the filters still integrate as a turn.
        body.turn(vec3(0.1, 0.2, 0.5), 1.0);
        assert!(body.error_deg().is_finite());
        assert!(!is_accurate(name) || body.error_deg() < 0.1, "{name}: {}°", body.error_deg());
    }
}
