//! Effects on the moving vehicle, against closed forms of the motion.

use super::*;
use crate::effects::vehicle::{
    BatterySag, CgOffset, ConstantWind, EscDelay, GroundEffect, MotorFailure, QuadraticDrag,
    RotorAcceleration, RotorDrag,
};

#[test]
fn quadratic_drag_reaches_terminal_velocity() {
    // v(t) = v∞ tanh(g t/v∞) with v∞ = √(2 m g/(ρ C_dA)).
    let drag = QuadraticDrag { cd_area_m2: [0.01, 0.01, 0.04], air_density_kg_m3: 1.225 };
    let mut v = in_the_air(vec![built(&drag, STEP_S)]);
    v.set_state(State { position: vec3(0.0, 0.0, -1000.0), ..*v.state() }, [0.0; 4]);
    let terminal = (2.0 * 0.65 * GRAVITY / (1.225 * 0.04)).sqrt();
    for until_s in [1.0, 2.0, 20.0] {
        let now_s = v.snapshot().time_s;
        run(&mut v, until_s - now_s);
        let exact = terminal * (GRAVITY * until_s / terminal).tanh();
        assert!((v.state().velocity.z - exact).abs() < 1e-7, "{} {exact}", v.state().velocity.z);
    }
    assert!((v.state().velocity.z / terminal - 1.0).abs() < 1e-9);
}

#[test]
fn drag_accelerates_the_vehicle_to_the_wind() {
    // v(t) = v_air (1 − e^(−A t/m)), and the fall is the same as without wind.
    let wind = [4.0, -3.0, 0.0];
    let mut v = in_the_air(vec![drag(STEP_S), built(&ConstantWind { velocity_m_s: wind }, STEP_S)]);
    run(&mut v, 2.0);
    let share = 1.0 - libm::exp(-0.25 * 2.0 / 0.65);
    let Vec3 { x, y, z } = v.state().velocity;
    assert!((x - 4.0 * share).abs() < 1e-9 && (y + 3.0 * share).abs() < 1e-9);
    assert!((z - 0.65 * GRAVITY / 0.25 * share).abs() < 1e-9);
}

#[test]
fn two_winds_add_up() {
    let wind = |velocity_m_s| built(&ConstantWind { velocity_m_s }, STEP_S);
    let mut v = in_the_air(vec![drag(STEP_S), wind([1.0, 2.0, 0.0]), wind([2.0, -2.0, 0.0])]);
    run(&mut v, 1.0);
    let share = 1.0 - libm::exp(-0.25 / 0.65);
    assert!((v.state().velocity.x - 3.0 * share).abs() < 1e-9 && v.state().velocity.y.abs() < 1e-12);
}

#[test]
fn rotor_drag_brakes_level_hover_exponentially() {
    // The decay rate is 4 k Ω/m = 4 · 1e-4 · 225.7/0.65 = 0.139/s, in the horizontal axes only.
    let mut v = in_the_air(vec![built(&RotorDrag { k_kg_per_rad: 1e-4 }, STEP_S)]);
    let speed = hover_rad_s();
    v.set_state(State { velocity: vec3(5.0, -2.0, 1.0), ..*v.state() }, [speed; 4]);
    v.command([speed; 4]);
    run(&mut v, 3.0);
    let left = libm::exp(-4.0 * 1e-4 * speed / 0.65 * 3.0);
    assert!((v.state().velocity - vec3(5.0 * left, -2.0 * left, 1.0)).norm() < 1e-9);
}

/// Angular momentum about z: the body gains J_r ΔΩ_r from the rotors, in addition to the torque of the propellers'
/// drag.
#[test]
fn yaw_rate_changes_with_rotor_acceleration() {
    let yaw_rate = |effects: Effects| {
        let mut v = in_the_air(effects);
        let speed = hover_rad_s();
        v.set_state(*v.state(), [speed; 4]);
        // There is a new command every 10 ms. The changes add up to +20 and −20 rad/s.
        for k in 0..10 {
            let change = f64::from(k + 1) * 2.0;
            v.command([speed + change, speed - change, speed + change, speed - change]);
            run(&mut v, 0.01);
        }
        run(&mut v, 1.0);
        let [w1, w2, w3, w4] = v.rotors();
        assert!((w1 - w2 + w3 - w4 - 80.0).abs() < 1e-5);
        v.state().rates.z
    };
    let gained = yaw_rate(vec![built(&RotorAcceleration {}, STEP_S)]) - yaw_rate(vec![]);
    let exact = 6e-5 * 80.0 / 1.3e-2;
    // Simpson's rule over e^(−t/τ) at h/τ = 0.02 has an error of (h/τ)⁴/2880 = 6e-11. The rest is e^(−1 s/τ).
    assert!((gained / exact - 1.0).abs() < 1e-6, "{gained} {exact}");
}

#[test]
fn ground_effect_lowers_the_hover_speed() {
    // At z = 2R the same thrust needs 63/64 of Ω².
    let effects = vec![built(&GroundEffect { rotor_radius_m: 0.15 }, STEP_S)];
    let mut v = on_the_ground(effects);
    let slower = hover_rad_s() * (63.0_f64 / 64.0).sqrt();
    v.set_state(State { position: vec3(0.0, 0.0, -0.3), ..*v.state() }, [slower; 4]);
    assert!(v.acceleration().norm() < 1e-9);
    // The yaw torque depends on the speed only.
    v.set_state(State { position: vec3(0.0, 0.0, -0.3), ..*v.state() }, [220.0, 210.0, 220.0, 210.0]);
    let torque = v.angular_acceleration().z * 1.3e-2;
    assert!((torque - 7.5e-7 * 2.0 * (220.0_f64.powi(2) - 210.0_f64.powi(2))).abs() < 1e-12);
}

#[test]
fn weight_forward_pitches_the_nose_down() {
    let mut v = in_the_air(vec![built(&CgOffset { offset_m: [0.01, 0.0, 0.0] }, STEP_S)]);
    v.set_state(*v.state(), [hover_rad_s(); 4]);
    // The acceleration is m g c/I, because the thrust equals the weight and acts a centimetre behind.
    let exact = -0.65 * GRAVITY * 0.01 / 7.5e-3;
    assert!((v.angular_acceleration() - vec3(0.0, exact, 0.0)).norm() < 1e-9);
}

#[test]
fn command_is_delayed_and_failed_rotor_stops() {
    let mut v = in_the_air(vec![
        built(&EscDelay { delay_s: 0.005 }, STEP_S),
        built(&MotorFailure { rotor: 2, at_s: 0.02, limit: 0.0 }, STEP_S),
    ]);
    let mut speeds = vec![];
    for _ in 0..100 {
        v.command([200.0; 4]);
        v.advance();
        speeds.push(v.rotors());
    }
    let rise = |steps: i32| 200.0 * (1.0 - libm::exp(-f64::from(steps.max(0)) * 1e-3 / 0.05));
    for (k, speed) in (1..).zip(&speeds) {
        assert!((speed[0] - rise(k - 5)).abs() < 1e-9, "step {k}: {speed:?}");
        let failed = rise(k.min(20) - 5) * libm::exp(-f64::from((k - 20).max(0)) * 1e-3 / 0.05);
        assert!((speed[1] - failed).abs() < 1e-9, "step {k}: {speed:?}");
    }
}

#[test]
fn battery_voltage_falls_under_load() {
    assert_eq!(in_the_air(vec![]).battery_v(), None);
    let battery =
        BatterySag { cells: 3, capacity_mah: 2000.0, resistance_mohm: 30.0, efficiency: 0.7, charge: 0.5 };
    let mut v = in_the_air(vec![built(&battery, STEP_S)]);
    // At half the charge the voltage is 3 (3.685 + 0.1078 − 0.02945 + 0.04001) V; e^(−17.5) is negligible.
    assert!((v.battery_v().unwrap() - 11.4101).abs() < 1e-3, "{:?}", v.battery_v());
    for _ in 0..2000 {
        v.command([250.0; 4]);
        v.advance();
    }
    let voltage = v.battery_v().unwrap();
    // The speed falls with the voltage relative to the full battery's 12.3087 V. The rotors' power at this speed causes
    // the sag.
    assert!((v.rotors()[0] - 250.0 * voltage / 12.3087).abs() < 0.01);
    let power = 4.0 * 7.5e-7 * v.rotors()[0].powi(3) / 0.7;
    assert!((voltage + 0.03 * power / voltage - 11.4101).abs() < 0.01, "{voltage}");
}
