//! Eq 18 against closed forms; its noise gains stand in the `tests` crate, beside the noise source.

use super::*;
use crate::arithmetic::wrap_pi;
use crate::geometry::vec3;
use core::f32::consts::{FRAC_PI_2, PI};

const G: f32 = crate::STANDARD_GRAVITY;
const LEVEL: Vec3<f32> = vec3(0.0, 0.0, -G);
/// Field at Ankara, level and pointing north, µT.
const FIELD: Vec3<f32> = vec3(25.0, 0.0, 41.0);

fn all() -> [Estimator; 3] {
    EstimatorParams::PRESETS.map(|(_, params)| Estimator::new(&params).unwrap())
}

/// What the sensors read at rest in attitude `q`.
fn at_rest(q: Quaternion<f32>) -> (Vec3<f32>, Vec3<f32>) {
    (q.conjugate().rotate(LEVEL), q.conjugate().rotate(FIELD))
}

fn euler(roll: f32, pitch: f32, yaw: f32) -> Quaternion<f32> {
    let half = |a: f32| ((0.5 * f64::from(a)).sin() as f32, (0.5 * f64::from(a)).cos() as f32);
    Quaternion::from_half_angles(half(roll), half(pitch), half(yaw))
}

/// Angle of the rotation between two attitudes, rad.
fn apart(a: Quaternion<f32>, b: Quaternion<f32>) -> f32 {
    let d = a * b.conjugate();
    2.0 * d.v.norm().atan2(d.w.abs())
}

#[test]
fn first_sample_sets_the_attitude() {
    for mut e in all() {
        for (roll, pitch, yaw) in [(0.0, 0.0, 0.0), (0.5, -0.3, 2.0), (-2.5, 1.2, -3.0), (3.1, 0.1, 0.4)] {
            let q = euler(roll, pitch, yaw);
            let (accel, mag) = at_rest(q);
            let mut fresh = e;
            fresh.update(Vec3::ZERO, accel, Some(mag), 0.0);
            assert!(apart(fresh.attitude(), q) < 2e-6, "{:?} at {roll} {pitch} {yaw}", fresh.attitude());
            assert!((fresh.down() - q.down()).norm() < 1e-6);
            assert!(wrap_pi(fresh.heading() - yaw).abs() < 2e-6);
        }
        assert!(!e.started());
        e.update(Vec3::ZERO, LEVEL, None, 0.0);
        assert!(e.started());
    }
}

#[test]
fn constant_bias_tilts_the_paper_by_32_33_steps_of_it() {
    // o = α(o + bΔt) has the fixed point αbΔt/(1 − α) = 32.33 Δt b.
    for params in [EstimatorParams::PAPER, EstimatorParams::PAPER_LITERAL] {
        let mut e = Estimator::new(&params).unwrap();
        let bias = 0.01;
        for _ in 0..2000 {
            e.update(vec3(bias, 0.0, 0.0), LEVEL, Some(FIELD), 0.01);
        }
        assert!((e.attitude().to_euler().roll / (0.97 / 0.03 * 0.01 * bias) - 1.0).abs() < 1e-4);
    }
}

#[test]
fn constant_bias_tilts_flight_by_tau_of_it() {
    let mut e = Estimator::new(&EstimatorParams::FLIGHT).unwrap();
    for _ in 0..20_000 {
        e.update(vec3(0.001, 0.0, 0.0), LEVEL, Some(FIELD), 0.01);
    }
    assert!((e.attitude().to_euler().roll / (10.0 * 0.001) - 1.0).abs() < 1e-3);
}

#[test]
fn weights_at_the_rates_of_the_design() {
    let paper = EstimatorParams::PAPER.weight;
    assert!((paper.of_measurement(0.01) - 0.03).abs() < 1e-7);
    // τ/(τ + Δt) at the recordings' 285.714 Hz: α = 0.98929.
    assert!((1.0 - paper.of_measurement(0.0035) - 0.989_29).abs() < 1e-5);
    assert!((EstimatorParams::PAPER_LITERAL.weight.of_measurement(0.001) - 0.03).abs() < 1e-7);
}

#[test]
fn follows_turns_through_half_a_turn_without_a_jump() {
    // About each axis in turn, 1 rad/s for 7 s: past ±180° of roll and yaw, and back.
    for (axis, singular) in [(0, false), (1, true), (2, false)] {
        for (n, mut e) in all().into_iter().enumerate() {
            if singular && n < 2 {
                continue; // Euler angles do not go over ±90° of pitch
            }
            for k in 0..=7000_u16 {
                let angle = f32::from(k) * 1e-3;
                let mut angles = [0.0; 3];
                angles[axis] = angle;
                let q = euler(angles[0], angles[1], angles[2]);
                let mut rate = [0.0; 3];
                rate[axis] = 1.0;
                let (accel, mag) = at_rest(q);
                e.update(rate.into(), accel, Some(mag), if k == 0 { 0.0 } else { 1e-3 });
                assert!(apart(e.attitude(), q) < 2e-3, "estimator {n}, axis {axis}, {angle} rad");
            }
        }
    }
}

#[test]
fn declination_turns_the_heading_east() {
    for (_, params) in EstimatorParams::PRESETS {
        let mut e = Estimator::new(&EstimatorParams { declination_rad: 0.1, ..params }).unwrap();
        for _ in 0..100 {
            e.update(Vec3::ZERO, LEVEL, Some(FIELD), 0.01);
        }
        assert!((e.heading() - 0.1).abs() < 1e-6);
    }
}

#[test]
fn free_fall_and_a_vertical_field_correct_nothing() {
    for mut e in all() {
        let q = euler(0.3, 0.2, 1.0);
        let (accel, mag) = at_rest(q);
        e.update(Vec3::ZERO, accel, Some(mag), 0.0);
        let vertical = q.conjugate().rotate(vec3(0.0, 0.0, 48.0));
        for _ in 0..1000 {
            e.update(Vec3::ZERO, vec3(0.01, -0.02, 0.03), Some(vertical), 0.001);
        }
        assert!(apart(e.attitude(), q) < 1e-5);
    }
}

#[test]
fn a_start_upside_down_from_the_truth_converges() {
    for (n, mut e) in all().into_iter().enumerate() {
        let (accel, mag) = at_rest(euler(PI, 0.0, 0.0));
        e.update(Vec3::ZERO, accel, Some(mag), 0.0);
        let (accel, mag) = at_rest(Quaternion::IDENTITY);
        let tau_s = if n == 2 { 10.0 } else { 0.3234 };
        let steps = (12.0 * tau_s / 0.01) as u32;
        for _ in 0..steps {
            e.update(Vec3::ZERO, accel, Some(mag), 0.01);
        }
        assert!(apart(e.attitude(), Quaternion::IDENTITY) < 1e-3, "estimator {n}: {:?}", e.attitude());
    }
}

#[test]
fn the_young_flight_filter_is_the_mean_of_its_measurements() {
    let mut e = Estimator::new(&EstimatorParams::FLIGHT).unwrap();
    let mut sum = 0.0;
    for k in 0..500_u16 {
        let roll = 0.02 * (f32::from(k) * 1.7).sin();
        sum += roll;
        let (accel, mag) = at_rest(euler(roll, 0.0, 0.0));
        e.update(Vec3::ZERO, accel, Some(mag), 0.01);
        assert!((e.attitude().to_euler().roll - sum / f32::from(k + 1)).abs() < 2e-5);
    }
}

#[test]
fn parked_at_the_vertical_all_stay_finite() {
    for mut e in all() {
        let (accel, mag) = at_rest(euler(0.0, FRAC_PI_2, 0.0));
        for k in 0..10_000_u16 {
            e.update(vec3(0.0, 30.0 * f32::from(k % 3), -30.0), accel, Some(mag), 0.001);
            let q = e.attitude();
            assert!((q.norm_squared() - 1.0).abs() < 1e-5, "{q:?}");
        }
    }
}

/// Eq 18 in Euler angles as the paper writes it, in f64 with the standard library's functions. It shares no
/// line with the filter: each angle's short way round is by remainder, and nothing is kept between updates
/// but the angles.
struct PaperInDouble {
    angles: [f64; 3],
    alpha: f64,
}

impl PaperInDouble {
    fn update(&mut self, gyro: [f64; 3], [fx, fy, fz]: [f64; 3], [mx, my, mz]: [f64; 3], dt_s: f64) {
        let [roll, pitch, yaw] = self.angles;
        let ((sr, cr), (sp, cp)) = (roll.sin_cos(), pitch.sin_cos());
        let [p, q, r] = gyro;
        let turn = q * sr + r * cr;
        let predicted =
            [roll + dt_s * (p + turn * sp / cp), pitch + dt_s * (q * cr - r * sr), yaw + dt_s * turn / cp];
        let blend = |a: f64, b: f64| {
            let o = a + (1.0 - self.alpha) * remainder(b - a);
            remainder(o)
        };
        let roll = blend(predicted[0], (-fy).atan2(-fz));
        let pitch = blend(predicted[1], fx.atan2(fy.hypot(fz)));
        let ((sr, cr), (sp, cp)) = (roll.sin_cos(), pitch.sin_cos());
        let north = mx * cp + (my * sr + mz * cr) * sp;
        let east = my * cr - mz * sr;
        self.angles = [roll, pitch, blend(predicted[2], (-east).atan2(north))];
    }
}

fn remainder(x: f64) -> f64 {
    x - core::f64::consts::TAU * (x / core::f64::consts::TAU).round()
}

#[test]
fn paper_equals_a_filter_in_f64_over_random_motion() {
    // Ten minutes at 1 kHz: every axis turns by sines of unrelated frequencies, at up to 100 °/s, with pitch
    // within ±60°, roll and yaw past ±180°, and accelerometer and magnetometer see accelerations and
    // disturbances of a tenth of what they measure.
    const DT_S: f32 = 1e-3;
    let mut e = Estimator::new(&EstimatorParams::PAPER).unwrap();
    let tau = 0.97 * 0.01 / 0.03_f64;
    let dt_s = f64::from(DT_S);
    let mut twin = PaperInDouble { angles: [0.0; 3], alpha: tau / (tau + dt_s) };
    let mut state = 1_u64;
    let mut noise = |size: f64| {
        // Knuth's MMIX generator; the upper half is what is random.
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        size * (((state >> 32) as f64) / 2_147_483_648.0 - 1.0)
    };
    let (mut sum, mut worst, mut crossings, mut last_roll) = (0.0_f64, 0.0_f64, 0, 0.0_f64);
    let steps = 600_000;
    for k in 0..steps {
        let t = f64::from(k) * dt_s;
        let angle = [
            3.5 * (0.31 * t).sin() + 0.6 * (1.7 * t).sin(),
            1.0 * (0.43 * t).sin() * (0.11 * t).cos(),
            4.0 * (0.17 * t).sin() + 0.4 * (2.3 * t).sin(),
        ];
        let rate = [
            3.5 * 0.31 * (0.31 * t).cos() + 0.6 * 1.7 * (1.7 * t).cos(),
            0.43 * (0.43 * t).cos() * (0.11 * t).cos() - 0.11 * (0.43 * t).sin() * (0.11 * t).sin(),
            4.0 * 0.17 * (0.17 * t).cos() + 0.4 * 2.3 * (2.3 * t).cos(),
        ];
        let ((sr, cr), (sp, cp)) = (angle[0].sin_cos(), angle[1].sin_cos());
        let gyro =
            [rate[0] - rate[2] * sp, rate[1] * cr + rate[2] * sr * cp, -rate[1] * sr + rate[2] * cr * cp];
        let [roll, pitch, yaw] = angle.map(|a| a as f32);
        let (accel, mag) = at_rest(euler(roll, pitch, yaw));
        let gyro: Vec3<f32> = vec3(
            (gyro[0] + noise(0.02)) as f32,
            (gyro[1] + noise(0.02)) as f32,
            (gyro[2] + noise(0.02)) as f32,
        );
        let accel = accel + vec3(noise(1.0) as f32, noise(1.0) as f32, noise(1.0) as f32);
        let mag = mag + vec3(noise(4.0) as f32, noise(4.0) as f32, noise(4.0) as f32);
        let double = |v: Vec3<f32>| <[f32; 3]>::from(v).map(f64::from);
        e.update(gyro, accel, Some(mag), DT_S);
        twin.update(double(gyro), double(accel), double(mag), dt_s);
        // Until the twin has forgotten that the filter starts from its first sample.
        if t < 10.0 {
            continue;
        }
        crossings += u32::from((twin.angles[0] - last_roll).abs() > 3.0);
        last_roll = twin.angles[0];
        let Estimator::Euler(filter) = &e else { unreachable!("the paper's filter is in Euler angles") };
        for (ours, exact) in filter.angles().into_iter().zip(twin.angles) {
            let error = remainder(f64::from(ours) - exact).abs();
            worst = worst.max(error);
            sum += error * error;
        }
    }
    let rms = (sum / (3.0 * f64::from(steps))).sqrt();
    std::println!("paper in f32 against f64: {rms:e} rad RMS, {worst:e} rad at most, {crossings} crossings");
    assert!(crossings > 50, "roll passes half a turn {crossings} times");
    // What f32 costs: 9.6e-7 rad RMS, and 7.3e-6 at most where 1/cos θ is 2.
    assert!(rms < 1.2e-6 && worst < 9e-6, "{rms:e} {worst:e}");
}

#[test]
fn parameters_outside_their_range_are_refused() {
    for weight in [
        Weight::TimeConstant { tau_s: 0.0 },
        Weight::TimeConstant { tau_s: f32::NAN },
        Weight::Fixed { alpha: 1.5 },
    ] {
        assert!(Estimator::new(&EstimatorParams { weight, ..EstimatorParams::PAPER }).is_err());
    }
}

mod zero {
    use super::*;

    const BIAS: Vec3<f32> = vec3(0.02, -0.01, 0.005);

    #[test]
    fn learns_a_bias_at_rest_and_keeps_it() {
        let mut zero = GyroZero::default();
        for k in 0..3000_u16 {
            let wiggle = vec3(0.003, -0.003, 0.003) * if k % 2 == 0 { 1.0 } else { -1.0 };
            zero.learn(BIAS + wiggle, LEVEL, 0.001);
            if !(998..=1001).contains(&k) {
                assert_eq!(zero.zeroed(), k > 1000, "after {k} ms");
            }
        }
        assert!((zero.bias() - BIAS).norm() < 1e-4 && zero.still());
        zero.learn(vec3(1.0, 0.0, 0.0), LEVEL, 0.001);
        assert!((zero.bias() - BIAS).norm() < 1e-4 && !zero.still() && zero.zeroed());
    }

    #[test]
    fn a_turntable_and_a_shaken_vehicle_teach_nothing() {
        let mut zero = GyroZero::default();
        for _ in 0..3000 {
            zero.learn(vec3(0.0, 0.0, 0.5), LEVEL, 0.001);
        }
        assert!(!zero.zeroed());
        for k in 0..3000_u16 {
            zero.learn(BIAS * if (k / 100) % 2 == 0 { 4.0 } else { -4.0 }, LEVEL, 0.001);
        }
        assert!(!zero.zeroed());
    }
}
