//! Tests of eq 18 and of the robust filter against closed forms. The noise gains of eq 18 are tested in the `tests`
//! crate, beside the noise source.

use super::*;
use crate::arithmetic::wrap_pi;
use crate::geometry::vec3;
use core::f32::consts::{FRAC_PI_2, PI};

#[cfg(not(miri))] // thousands of samples through two filters: minutes for each test
pub(super) mod properties;

const G: f32 = crate::STANDARD_GRAVITY;
const LEVEL: Vec3<f32> = vec3(0.0, 0.0, -G);
/// Field at Ankara in world axes with x to magnetic north, µT.
const FIELD: Vec3<f32> = vec3(25.0, 0.0, 41.0);

fn all() -> [Estimator; 4] {
    EstimatorParams::PRESETS.map(|(_, params)| Estimator::new(&params).unwrap())
}

/// Returns specific force and field in body axes at rest in attitude `q`.
fn at_rest(q: Quaternion<f32>) -> (Vec3<f32>, Vec3<f32>) {
    (q.conjugate().rotate(LEVEL), q.conjugate().rotate(FIELD))
}

fn euler(roll: f32, pitch: f32, yaw: f32) -> Quaternion<f32> {
    let half = |a: f32| ((0.5 * f64::from(a)).sin() as f32, (0.5 * f64::from(a)).cos() as f32);
    Quaternion::from_half_angles(half(roll), half(pitch), half(yaw))
}

/// Returns the angle of the rotation between two attitudes, rad.
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
#[cfg_attr(miri, ignore = "4,000 steps")]
fn constant_bias_tilts_paper_by_32_33_steps() {
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
#[cfg_attr(miri, ignore = "20,000 steps")]
fn constant_bias_tilts_flight_by_tau() {
    let mut e = Estimator::new(&EstimatorParams::FLIGHT).unwrap();
    for _ in 0..20_000 {
        e.update(vec3(0.001, 0.0, 0.0), LEVEL, Some(FIELD), 0.01);
    }
    assert!((e.attitude().to_euler().roll / (10.0 * 0.001) - 1.0).abs() < 1e-3);
}

#[test]
fn weights_at_100_hz_285_hz_and_1_khz() {
    let weight = |params: EstimatorParams| match params.method {
        Method::Complementary { weight, .. } => weight,
        Method::Robust(_) => unreachable!(),
    };
    let paper = weight(EstimatorParams::PAPER);
    assert!((paper.measurement_weight(0.01) - 0.03).abs() < 1e-7);
    // The rate of the recordings is 285.714 Hz, so α = τ/(τ + Δt) = 0.98929.
    assert!((1.0 - paper.measurement_weight(0.0035) - 0.989_29).abs() < 1e-5);
    assert!((weight(EstimatorParams::PAPER_LITERAL).measurement_weight(0.001) - 0.03).abs() < 1e-7);
}

#[test]
#[cfg_attr(miri, ignore = "7,000 steps of each filter")]
fn follows_turns_past_180_degrees_without_a_jump() {
    // The vehicle turns about each axis in turn, with 1 rad/s for 7 s: roll and yaw pass ±180° and come back.
    for (axis, singular) in [(0, false), (1, true), (2, false)] {
        for (n, mut e) in all().into_iter().enumerate() {
            if singular && n < 2 {
                continue; // Euler angles do not pass ±90° of pitch
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
#[cfg_attr(miri, ignore = "1,000 steps of each filter")]
fn free_fall_and_vertical_field_correct_nothing() {
    for mut e in all() {
        let q = euler(0.3, 0.2, 1.0);
        let (accel, mag) = at_rest(q);
        e.update(Vec3::ZERO, accel, Some(mag), 0.0);
        let vertical = q.conjugate().rotate(vec3(0.0, 0.0, 48.0));
        for _ in 0..1000 {
            e.update(Vec3::ZERO, vec3(0.01, -0.02, 0.03), Some(vertical), 0.001);
        }
        // The robust filter integrates also such a small force: 0.022 m/s are taken for a tilt of 1.1e-4 rad.
        let bound = if e.input() == FilterInput::Calibrated { 2e-4 } else { 1e-5 };
        assert!(apart(e.attitude(), q) < bound, "{e:?}");
    }
}

#[test]
#[cfg_attr(miri, ignore = "thousands of steps of each filter")]
fn start_upside_down_converges_to_the_truth() {
    for (n, mut e) in all().into_iter().enumerate() {
        let (accel, mag) = at_rest(euler(PI, 0.0, 0.0));
        e.update(Vec3::ZERO, accel, Some(mag), 0.0);
        let (accel, mag) = at_rest(Quaternion::IDENTITY);
        let tau_s = [0.3234, 0.3234, 10.0, 5.0][n];
        let steps = (12.0 * tau_s / 0.01) as u32;
        for _ in 0..steps {
            e.update(Vec3::ZERO, accel, Some(mag), 0.01);
        }
        assert!(apart(e.attitude(), Quaternion::IDENTITY) < 1e-3, "estimator {n}: {:?}", e.attitude());
    }
}

#[test]
fn flight_starts_as_the_mean_of_its_measurements() {
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
#[cfg_attr(miri, ignore = "10,000 steps of each filter")]
fn turning_at_90_degrees_pitch_stays_finite() {
    for mut e in all() {
        let (accel, mag) = at_rest(euler(0.0, FRAC_PI_2, 0.0));
        for k in 0..10_000_u16 {
            e.update(vec3(0.0, 30.0 * f32::from(k % 3), -30.0), accel, Some(mag), 0.001);
            let q = e.attitude();
            assert!((q.norm_squared() - 1.0).abs() < 1e-5, "{q:?}");
        }
    }
}

/// Eq 18 in Euler angles as the paper writes it, in f64 with the functions of the standard library. It shares no code
/// with the filter: each angle is wrapped by a remainder, and only the angles are kept between updates.
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
#[cfg_attr(miri, ignore = "thousands of steps in f64")]
fn paper_equals_a_filter_in_f64_over_random_motion() {
    // Ten minutes at 1 kHz. Every axis turns by sines of unrelated frequencies at up to 100 °/s, with pitch within
    // ±60° and roll and yaw past ±180°. Accelerometer and magnetometer also measure accelerations and disturbances of
    // a tenth of their readings.
    const DT_S: f32 = 1e-3;
    let mut e = Estimator::new(&EstimatorParams::PAPER).unwrap();
    let tau = 0.97 * 0.01 / 0.03_f64;
    let dt_s = f64::from(DT_S);
    let mut second = PaperInDouble { angles: [0.0; 3], alpha: tau / (tau + dt_s) };
    let mut state = 1_u64;
    let mut noise = |size: f64| {
        // Knuth's MMIX generator; only the upper half of the bits is random enough.
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
        second.update(double(gyro), double(accel), double(mag), dt_s);
        // The second filter starts from zero and not from the first sample: wait until this difference has decayed.
        if t < 10.0 {
            continue;
        }
        crossings += u32::from((second.angles[0] - last_roll).abs() > 3.0);
        last_roll = second.angles[0];
        let Filters::Euler(filter) = e.filter() else {
            unreachable!("the filter of the paper uses Euler angles")
        };
        for (ours, exact) in filter.angles().into_iter().zip(second.angles) {
            let error = remainder(f64::from(ours) - exact).abs();
            worst = worst.max(error);
            sum += error * error;
        }
    }
    let rms = (sum / (3.0 * f64::from(steps))).sqrt();
    std::println!("paper in f32 against f64: {rms:e} rad RMS, {worst:e} rad at most, {crossings} crossings");
    assert!(crossings > 50, "roll passes half a turn {crossings} times");
    // The measured error of f32 is 9.6e-7 rad RMS, and at most 7.3e-6 rad. The maximum is where 1/cos θ is 2.
    assert!(rms < 1.2e-6 && worst < 9e-6, "{rms:e} {worst:e}");
}

#[test]
fn parameters_outside_their_range_are_rejected() {
    for weight in [
        Weight::TimeConstant { tau_s: 0.0 },
        Weight::TimeConstant { tau_s: f32::NAN },
        Weight::Fixed { alpha: 1.5 },
    ] {
        assert!(Estimator::new(&EstimatorParams::complementary(Kinematics::Euler, weight)).is_err());
    }
    for (speed_m_s, heading_noise_rad) in [(0.0, 0.1), (0.3, f32::NAN)] {
        let method = Method::Robust(RobustParams { speed_m_s, heading_noise_rad });
        assert!(Estimator::new(&EstimatorParams { method, declination_rad: 0.0 }).is_err());
    }
}

mod zero {
    use super::*;

    const BIAS: Vec3<f32> = vec3(0.02, -0.01, 0.005);

    #[test]
    #[cfg_attr(miri, ignore = "3,000 steps")]
    fn bias_is_learnt_at_rest_and_kept() {
        let mut zero = GyroZero::default();
        for k in 0..3000_u16 {
            let noise = vec3(0.003, -0.003, 0.003) * if k % 2 == 0 { 1.0 } else { -1.0 };
            zero.learn(BIAS + noise, LEVEL, 0.001);
            if !(998..=1001).contains(&k) {
                assert_eq!(zero.zeroed(), k > 1000, "after {k} ms");
            }
        }
        assert!((zero.bias() - BIAS).norm() < 1e-4 && zero.still());
        zero.learn(vec3(1.0, 0.0, 0.0), LEVEL, 0.001);
        assert!((zero.bias() - BIAS).norm() < 1e-4 && !zero.still() && zero.zeroed());
    }

    #[test]
    #[cfg_attr(miri, ignore = "6,000 steps")]
    fn turntable_and_shaking_are_not_learnt() {
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

mod robust {
    use super::*;
    use proptest::prelude::*;

    const DEGREE: f32 = PI / 180.0;

    fn robust() -> Estimator {
        Estimator::new(&EstimatorParams::ROBUST).unwrap()
    }

    /// Updates the estimator for `seconds` with constant readings, level and pointing north.
    fn rest(e: &mut Estimator, gyro: Vec3<f32>, seconds: f32, dt_s: f32) {
        for _ in 0..(seconds / dt_s).round() as u32 {
            e.update(gyro, LEVEL, Some(FIELD), dt_s);
        }
    }

    fn tilt(e: &Estimator) -> f32 {
        let d = e.down();
        d.z.clamp(-1.0, 1.0).acos()
    }

    /// Returns the angle between the estimate of down and the truth, rad.
    fn apart_down(e: &Estimator, q: Quaternion<f32>) -> f32 {
        e.down().cross(q.down()).norm().atan2(e.down().dot(q.down()))
    }

    #[test]
    #[cfg_attr(miri, ignore = "seconds of rest at many rates")]
    fn first_rest_gives_the_bias_at_any_sample_rate() {
        let bias = vec3(3.0, -2.0, 1.0) * DEGREE;
        for rate_hz in [100.0, 285.7, 1000.0, 8000.0] {
            let mut e = robust();
            rest(&mut e, bias, 1.0, 1.0 / rate_hz);
            // Rest is not detected yet. The bias turns the estimate by 3.6° in this second; the velocity that the tilt
            // integrates to has shown almost half of it.
            assert!(
                e.gyro_bias().norm() < 0.1 * DEGREE && tilt(&e) < 0.6 * 3.6 * DEGREE,
                "{} deg, {e:?}",
                tilt(&e) / DEGREE
            );
            rest(&mut e, bias, 3.0, 1.0 / rate_hz);
            let off = (e.gyro_bias() - bias).norm() / DEGREE;
            // The initial deviation is 3 °/s: of an error b, T s of rest leave b/(1 + (3/0.17)² T). Rest is detected
            // after 1.5 s, so T = 2.5 s: 3.74/780 = 0.0048 °/s.
            assert!((off - 0.0048).abs() < 0.0005, "{rate_hz} Hz: {off} °/s");
            rest(&mut e, bias, 40.0, 1.0 / rate_hz);
            assert!(tilt(&e) < 0.05 * DEGREE && e.heading().abs() < 0.1 * DEGREE, "{rate_hz} Hz: {e:?}");
        }
    }

    #[test]
    #[cfg_attr(miri, ignore = "57,000 steps")]
    fn bias_step_at_rest_is_followed_with_34_s() {
        let mut e = robust();
        let step = 0.5 * DEGREE;
        rest(&mut e, Vec3::ZERO, 200.0, 0.005);
        for k in 1..=4_u8 {
            // About the vertical and without a field, so that only the gyroscope shows it.
            for _ in 0..3400 {
                e.update(vec3(0.0, 0.0, step), LEVEL, None, 0.005);
            }
            // REST_NOISE/BIAS_WALK = 34 s.
            let left = 1.0 - e.gyro_bias().z / step;
            let expected = (-f64::from(k) * 0.5).exp() as f32;
            assert!((left - expected).abs() < 0.03, "{left} against {expected}");
        }
    }

    #[test]
    #[cfg_attr(miri, ignore = "14,000 steps")]
    fn bias_after_a_zeroing_tilts_by_6_s_then_is_learnt() {
        let mut e = robust();
        rest(&mut e, Vec3::ZERO, 10.0, 0.005);
        e.on_gyro_zeroed();
        // Seven times the standard deviation after the zeroing, 0.029 °/s.
        let bias = 0.2 * DEGREE;
        let mut worst = 0.0_f32;
        for _ in 0..12_000 {
            rest(&mut e, vec3(bias, 0.0, 0.0), 0.005, 0.005);
            worst = worst.max(tilt(&e));
        }
        // The double integral of the bias, g b t³/6, reaches the speed of slow motion, 0.3 m/s, after 3.8 s. The
        // correction needs half as long again: the measured time is 5.9 s.
        assert!(worst > 5.0 * bias && worst < 6.5 * bias, "{} s", worst / bias);
        assert!((e.gyro_bias().x / bias - 1.0).abs() < 0.08, "{}", e.gyro_bias().x / bias);
        // After a minute 6 % of the bias are left.
        assert!(tilt(&e) < 0.5 * bias, "{} s", tilt(&e) / bias);
    }

    #[test]
    #[cfg_attr(miri, ignore = "5,000 steps of each push")]
    fn push_tilts_by_its_speed() {
        // A speed that lasts is taken for the integral of a tilt, whatever the acceleration was. The measured tilt is
        // 1.3° for each m/s after a long rest; a complementary filter with τ = 5 s tilts by 1.2°.
        for (accel, seconds) in [(5.0, 0.2), (2.0, 1.0), (-3.0, 0.5)] {
            let mut e = robust();
            rest(&mut e, Vec3::ZERO, 20.0, 0.002);
            let mut worst = 0.0_f32;
            for k in 0..5000_u16 {
                let pushed = f32::from(k) * 0.002 < seconds;
                let a = if pushed { accel } else { 0.0 };
                e.update(Vec3::ZERO, LEVEL + vec3(a, 0.0, 0.0), Some(FIELD), 0.002);
                worst = worst.max(tilt(&e));
            }
            let degrees = worst / DEGREE / (accel * seconds).abs();
            assert!((1.2..1.4).contains(&degrees), "{accel} {seconds}: {degrees} deg for each m/s");
        }
    }

    #[test]
    #[cfg_attr(miri, ignore = "5,000 steps")]
    fn opposite_pushes_tilt_by_distance_not_speed() {
        // 3 m/s² for 0.5 s, then −3 m/s² for 0.5 s: a speed of up to 1.5 m/s, but over 0.75 m only. If the speed
        // lasted, the tilt would be 1.5°.
        let mut e = robust();
        rest(&mut e, Vec3::ZERO, 20.0, 0.002);
        let mut worst = 0.0_f32;
        for k in 0..5000_u16 {
            let a = [3.0, -3.0, 0.0][usize::from(k / 250).min(2)];
            e.update(Vec3::ZERO, LEVEL + vec3(0.0, a, 0.0), Some(FIELD), 0.002);
            worst = worst.max(apart(e.attitude(), Quaternion::IDENTITY));
        }
        assert!(worst < 0.05 * DEGREE, "{} deg", worst / DEGREE);
    }

    #[test]
    #[cfg_attr(miri, ignore = "10,000 steps of each rate")]
    fn slow_steady_turn_is_not_taken_for_rest() {
        for rate_deg_s in [3.0_f32, 6.0, 12.0] {
            let mut e = robust();
            let rate = rate_deg_s * DEGREE;
            for k in 0..10_000_u16 {
                let q = euler(f32::from(k) * 0.002 * rate, 0.0, 0.0);
                let (accel, mag) = at_rest(q);
                e.update(vec3(rate, 0.0, 0.0), accel, Some(mag), if k == 0 { 0.0 } else { 0.002 });
                assert!(apart(e.attitude(), q) < 0.2 * DEGREE, "{rate_deg_s} °/s after {k}");
            }
        }
    }

    #[test]
    #[cfg_attr(miri, ignore = "minutes of rest")]
    fn start_in_a_gust_does_not_change_the_field() {
        // The first sample contains 2 m/s² of wind. It shows 11.5° of tilt, which moves 8 µT of the field between
        // horizontal and vertical.
        let mut e = robust();
        e.update(Vec3::ZERO, LEVEL + vec3(0.0, 2.0, 0.0), Some(FIELD), 0.0);
        assert!(tilt(&e) > 11.0 * DEGREE);
        rest(&mut e, vec3(0.0, 0.0, 0.02 * DEGREE), 30.0, 0.005);
        // The first sample turns the field by 18°. With a first deviation of 10°, 30 s leave a 55th of it, 0.33°; the
        // bias adds to it. If the filter had replaced the field, the heading would stay wrong by degrees.
        assert!(tilt(&e) < 0.1 * DEGREE && e.heading().abs() < 0.6 * DEGREE, "{e:?}");
    }

    #[test]
    #[cfg_attr(miri, ignore = "33,000 steps")]
    fn magnetic_disturbance_is_ignored_for_a_minute() {
        let mut e = robust();
        rest(&mut e, Vec3::ZERO, 30.0, 0.01);
        let disturbed = FIELD + vec3(0.0, 15.0, 10.0);
        for _ in 0..5900 {
            e.update(Vec3::ZERO, LEVEL, Some(disturbed), 0.01);
        }
        // A deviating field has little weight, not none: 0.6° of the 31° in a minute.
        assert!(e.heading().abs() < 0.012, "{}", e.heading());
        // The new place is accepted at once, and its heading with the gain of a filter that has settled: a fifth of
        // the difference is left after 60 s, a fiftieth after 150 s.
        for _ in 0..24_000 {
            e.update(Vec3::ZERO, LEVEL, Some(disturbed), 0.01);
        }
        assert!((e.heading() + 15.0_f32.atan2(25.0)).abs() < 0.01, "{}", e.heading());
    }

    #[test]
    #[cfg_attr(miri, ignore = "24,000 steps")]
    fn field_of_the_sensor_itself_is_learnt() {
        let mut e = robust();
        let offset = vec3(1.5, -1.0, 1.0);
        let mut worst = 0.0_f32;
        for k in 0..24_000_u16 {
            // The vehicle turns about all axes, back and forth, for 120 s.
            let t = f32::from(k) * 0.005;
            let angles = [1.0 * (0.9 * t).sin(), 0.8 * (1.3 * t).sin(), 2.0 * (0.7 * t).sin()];
            let ahead = [0.9 * (0.9 * t).cos(), 1.04 * (1.3 * t).cos(), 1.4 * (0.7 * t).cos()];
            let ((sr, cr), (sp, cp)) = (angles[0].sin_cos(), angles[1].sin_cos());
            let gyro = vec3(
                ahead[0] - ahead[2] * sp,
                ahead[1] * cr + ahead[2] * sr * cp,
                -ahead[1] * sr + ahead[2] * cr * cp,
            );
            let q = euler(angles[0], angles[1], angles[2]);
            let (accel, mag) = at_rest(q);
            e.update(gyro, accel, Some(mag + offset), if k == 0 { 0.0 } else { 0.005 });
            if t > 100.0 {
                worst = worst.max(apart(e.attitude(), q));
            }
        }
        // If the filter did not estimate the offset, 1.5 µT of 25 µT would be an error of 3.4°.
        assert!(worst < 1.2 * DEGREE, "{} deg", worst / DEGREE);
    }

    #[test]
    #[cfg_attr(miri, ignore = "20,000 steps")]
    fn tilt_is_the_same_without_a_magnetometer() {
        let (mut without_mag, mut with_mag) = (robust(), robust());
        for k in 0..20_000_u16 {
            let roll = 0.5 * (f32::from(k) * 0.001).sin();
            let gyro = vec3(0.5 * (f32::from(k) * 0.001).cos() * 0.2, 0.0, 0.0);
            let (accel, mag) = at_rest(euler(roll, 0.1, 0.4));
            without_mag.update(gyro, accel, None, 0.005);
            with_mag.update(gyro, accel, Some(mag), 0.005);
        }
        assert!((without_mag.down() - with_mag.down()).norm() < 5e-3);
    }

    /// A plausible reading, or one with any values.
    fn any_reading(scale: f32) -> impl Strategy<Value = Vec3<f32>> {
        let number = prop_oneof![
            4 => -scale..scale,
            1 => any::<f32>(),
            1 => prop::sample::select(&[0.0, f32::NAN, f32::INFINITY, f32::MIN_POSITIVE, f32::MAX][..]),
        ];
        [number.clone(), number.clone(), number].prop_map(Vec3::from)
    }

    proptest! {
        #[test]
        fn any_samples_leave_a_finite_unit_attitude(
            samples in prop::collection::vec(
                (any_reading(40.0), any_reading(160.0), prop::option::of(any_reading(60.0)),
                    prop_oneof![4 => 0.0..0.02_f32, 1 => any::<f32>()]),
                1..if cfg!(miri) { 20 } else { 200 },
            ),
        ) {
            let mut e = robust();
            for (gyro, accel, mag, dt_s) in samples {
                e.update(gyro, accel, mag, dt_s);
                let q = e.attitude();
                prop_assert!((q.norm_squared() - 1.0).abs() < 1e-3, "{e:?}");
                prop_assert!(e.gyro_bias().norm() < 1.0 && e.heading().is_finite(), "{e:?}");
                prop_assert!((e.down().norm() - 1.0).abs() < 2e-3, "{e:?}");
            }
        }

        /// An attitude that changes without the gyroscope's notice, by up to 30° of tilt and any heading. The heading
        /// takes up to 450 s: the first sample may give a wrong field, which is replaced after 60 s, and by then the
        /// gain of the heading has become small.
        #[test]
        #[cfg_attr(miri, ignore = "22,500 steps of each case")]
        fn filter_converges_within_its_first_deviation(
            from in [-PI..PI, -1.5..1.5_f32, -PI..PI], off in [-0.35..0.35_f32, -0.35..0.35_f32], yaw in -PI..PI,
        ) {
            let mut e = robust();
            let first = euler(from[0], from[1], from[2]);
            let (accel, mag) = at_rest(first);
            e.update(Vec3::ZERO, accel, Some(mag), 0.0);
            let q = euler(0.0, 0.0, yaw) * first * euler(off[0], off[1], 0.0);
            let (accel, mag) = at_rest(q);
            for _ in 0..1500 {
                e.update(Vec3::ZERO, accel, Some(mag), 0.02);
            }
            prop_assert!(apart_down(&e, q) < 0.5 * DEGREE, "{} deg", apart_down(&e, q) / DEGREE);
            for _ in 0..21_000 {
                e.update(Vec3::ZERO, accel, Some(mag), 0.02);
            }
            prop_assert!(apart(e.attitude(), q) < 0.5 * DEGREE, "{} deg", apart(e.attitude(), q) / DEGREE);
        }

        /// A first tilt that is wrong by more may teach a bias beyond what the detection of rest accepts as one. The
        /// tilt converges all the same, in the end.
        #[test]
        #[cfg_attr(miri, ignore = "11,250 steps of each case")]
        fn tilt_converges_between_any_two_attitudes(
            from in [-PI..PI, -1.5..1.5_f32, -PI..PI], to in [-PI..PI, -1.5..1.5_f32, -PI..PI],
        ) {
            let mut e = robust();
            let (accel, mag) = at_rest(euler(from[0], from[1], from[2]));
            e.update(Vec3::ZERO, accel, Some(mag), 0.0);
            let q = euler(to[0], to[1], to[2]);
            let (accel, mag) = at_rest(q);
            for _ in 0..11_250 {
                e.update(Vec3::ZERO, accel, Some(mag), 0.04);
            }
            prop_assert!(apart_down(&e, q) < 0.5 * DEGREE, "{} deg", apart_down(&e, q) / DEGREE);
        }
    }
}
