//! Every public function of the estimators over its whole domain: eq 18 against second filters in f64, the zero of
//! the gyroscope against the plain mean, and the documented properties for any input.

use super::*;
use crate::geometry::Mat3;
use proptest::num::f32::ANY;
use proptest::prelude::*;
use std::vec::Vec;

type V = Vec3<f64>;

fn double(v: Vec3<f32>) -> V {
    <[f32; 3]>::from(v).map(f64::from).into()
}

fn about(size: f32) -> impl Strategy<Value = Vec3<f32>> {
    [-size..size, -size..size, -size..size].prop_map(Vec3::from)
}

/// A sample, and the time since the last one.
#[derive(Clone, Copy, Debug)]
struct Sample {
    gyro: Vec3<f32>,
    accel: Vec3<f32>,
    mag: Option<Vec3<f32>>,
    dt_s: f32,
}

/// Possible readings of the sensors, mostly close to those at rest.
fn sample() -> impl Strategy<Value = Sample> {
    let gyro = prop_oneof![about(0.3), about(8.0)];
    let accel = prop_oneof![4 => about(4.0).prop_map(|off| off + LEVEL), 2 => about(20.0), 1 => about(0.5)];
    let vertical = about(0.5).prop_map(|off| off + vec3(0.0, 0.0, 45.0));
    let field = prop_oneof![4 => about(15.0).prop_map(|off| off + FIELD), 1 => about(60.0), 1 => vertical];
    let dt_s = prop_oneof![1 => Just(0.0_f32), 6 => 1.0e-4..0.05_f32];
    (gyro, accel, prop::option::weighted(0.7, field), dt_s).prop_map(|(gyro, accel, mag, dt_s)| Sample {
        gyro,
        accel,
        mag,
        dt_s,
    })
}

fn weight() -> impl Strategy<Value = Weight> {
    prop_oneof![
        2 => (0.02..2.0_f32).prop_map(|tau_s| Weight::TimeConstant { tau_s }),
        1 => (1.0e-3..1.0e4_f32).prop_map(|tau_s| Weight::TimeConstant { tau_s }),
        2 => (0.0..=1.0_f32).prop_map(|alpha| Weight::Fixed { alpha }),
    ]
}

/// Returns 1 − α of eq 18.
fn measurement_weight(weight: Weight, dt_s: f64) -> f64 {
    match weight {
        Weight::TimeConstant { tau_s } => 1.0 - f64::from(tau_s) / (f64::from(tau_s) + dt_s),
        Weight::Fixed { alpha } => 1.0 - f64::from(alpha),
    }
}

/// Returns whether a < b, or `None` where rounding may decide.
fn below(a: f64, b: f64) -> Option<bool> {
    ((a - b).abs() > 1e-3 * b).then_some(a < b)
}

/// Returns the rotation by a vector, by Rodrigues' formula.
pub(in crate::estimator) fn rotation(r: V) -> Mat3<f64> {
    let angle = r.norm();
    if angle == 0.0 {
        return Mat3::IDENTITY;
    }
    let axis = r * (1.0 / angle);
    let (sin, cos) = angle.sin_cos();
    let turned = |v: V| v * cos + axis.cross(v) * sin + axis * (axis.dot(v) * (1.0 - cos));
    Mat3 { rows: [vec3(1.0, 0.0, 0.0), vec3(0.0, 1.0, 0.0), vec3(0.0, 0.0, 1.0)].map(turned) }.transpose()
}

/// The flight filter on a rotation matrix: rotates by the share of the angle between two directions, about their
/// common normal.
struct OnAMatrix {
    weight: Weight,
    declination: f64,
    attitude: Mat3<f64>,
    /// Age of tilt and heading; `None` before their first measurement.
    tilt_age: Option<f64>,
    heading_age: Option<f64>,
    mag_dt: f64,
}

impl OnAMatrix {
    /// Returns the share of a measurement and the new age. The share is 1 for the first measurement, then that of a
    /// mean until the age is τ.
    fn share(&self, age: Option<f64>, dt: f64) -> Option<(f64, f64)> {
        let share = match (age, self.weight) {
            (None, _) => 1.0,
            (Some(age), Weight::TimeConstant { tau_s }) if dt > 0.0 && below(age, tau_s.into())? => {
                dt / (age + dt)
            }
            (Some(_), weight) => measurement_weight(weight, dt),
        };
        Some((share, age.unwrap_or(0.0) + dt))
    }

    /// Returns `None` where rounding decides the result.
    fn update(&mut self, now: &Sample) -> Option<()> {
        let dt = f64::from(now.dt_s);
        self.attitude = self.attitude * rotation(double(now.gyro) * dt);
        let force = double(now.accel);
        if !below(force.norm(), 0.980_665)? {
            let measured = self.attitude * (force * (-1.0 / force.norm()));
            let (sin, cos) = (measured.cross(Vec3::Z).norm(), measured.z);
            let angle = sin.atan2(cos);
            if angle > core::f64::consts::PI - 0.03 {
                return None;
            }
            let (share, age) = self.share(self.tilt_age, dt)?;
            self.tilt_age = Some(age);
            if sin > 0.0 {
                // In world axes, the measured direction of down is moved towards the vertical.
                let correction = measured.cross(Vec3::Z) * (share * angle / sin);
                self.attitude = rotation(correction) * self.attitude;
            }
        }
        self.mag_dt += dt;
        if let Some(mag) = now.mag {
            let field = self.attitude * double(mag);
            if !below(field.x.hypot(field.y), 1.0)? {
                let excess = remainder(field.y.atan2(field.x) - self.declination);
                if excess.abs() > core::f64::consts::PI - 1e-3 {
                    return None;
                }
                let (share, age) = self.share(self.heading_age, self.mag_dt)?;
                self.heading_age = Some(age);
                self.mag_dt = 0.0;
                self.attitude = rotation(vec3(0.0, 0.0, -share * excess)) * self.attitude;
            }
        }
        Some(())
    }
}

/// The filter of the paper, like [`PaperInDouble`], but with samples that lack some sensors.
struct InAngles {
    weight: Weight,
    declination: f64,
    angles: [f64; 3],
    started: (bool, bool),
    mag_dt: f64,
}

impl InAngles {
    fn update(&mut self, now: &Sample) -> Option<()> {
        let dt = f64::from(now.dt_s);
        let [roll, pitch, yaw] = self.angles;
        let [p, q, r] = <[f64; 3]>::from(double(now.gyro));
        let ((sr, cr), (sp, cp)) = (roll.sin_cos(), pitch.sin_cos());
        // Near the vertical the angles themselves amplify rounding errors.
        if cp.abs() < 0.1 {
            return None;
        }
        let turn = q * sr + r * cr;
        self.angles =
            [roll + dt * (p + turn * sp / cp), pitch + dt * (q * cr - r * sr), yaw + dt * turn / cp];
        let [fx, fy, fz] = <[f64; 3]>::from(double(now.accel));
        let blend = |a: f64, b: f64, share: f64| {
            let off = remainder(b - a);
            (off.abs() < core::f64::consts::PI - 1e-3).then_some(a + share * off)
        };
        if !below(double(now.accel).norm(), 0.980_665)? {
            if fy.hypot(fz) < 0.05 {
                return None;
            }
            let share = if self.started.0 { measurement_weight(self.weight, dt) } else { 1.0 };
            self.started.0 = true;
            self.angles[0] = blend(self.angles[0], (-fy).atan2(-fz), share)?;
            self.angles[1] = blend(self.angles[1], fx.atan2(fy.hypot(fz)), share)?;
        }
        self.mag_dt += dt;
        if let Some(mag) = now.mag {
            // The field is rotated to level, by roll about x, then by pitch about y.
            let [roll, pitch, yaw] = self.angles;
            let about_x = rotation(vec3(roll, 0.0, 0.0));
            let about_y = rotation(vec3(0.0, pitch, 0.0));
            let level = about_y * (about_x * double(mag));
            if !below(level.x.hypot(level.y), 1.0)? {
                let share = if self.started.1 { measurement_weight(self.weight, self.mag_dt) } else { 1.0 };
                self.started.1 = true;
                self.mag_dt = 0.0;
                self.angles[2] = blend(yaw, (-level.y).atan2(level.x) + self.declination, share)?;
            }
        }
        Some(())
    }
}

/// Parameters of all methods, also of the two combinations that no preset has.
fn every_method() -> impl Strategy<Value = EstimatorParams> {
    let kinematics = prop::sample::select(&[Kinematics::Euler, Kinematics::Quaternion][..]);
    let complementary =
        (kinematics, weight()).prop_map(|(kinematics, weight)| Method::Complementary { kinematics, weight });
    let robust = (0.05..=50.0_f32, 0.001..=10.0_f32).prop_map(|(speed_m_s, heading_noise_rad)| {
        Method::Robust(RobustParams { speed_m_s, heading_noise_rad })
    });
    let method = prop_oneof![2 => complementary, 1 => robust];
    (method, -PI..=PI).prop_map(|(method, declination_rad)| EstimatorParams { method, declination_rad })
}

proptest! {
    #[test]
    fn flight_equals_a_filter_on_a_matrix_in_f64(
        weight in weight(), declination_rad in -3.0..3.0_f32, samples in prop::collection::vec(sample(), 1..40),
    ) {
        let method = Method::Complementary { kinematics: Kinematics::Quaternion, weight };
        let mut ours = Estimator::new(&EstimatorParams { method, declination_rad }).unwrap();
        let mut second = OnAMatrix {
            weight,
            declination: declination_rad.into(),
            attitude: Mat3::IDENTITY,
            tilt_age: None,
            heading_age: None,
            mag_dt: 0.0,
        };
        for now in &samples {
            ours.update(now.gyro, now.accel, now.mag, now.dt_s);
            if second.update(now).is_none() {
                return Ok(());
            }
            let rows = ours.attitude().to_matrix().rows.map(double);
            let off = rows.iter().zip(second.attitude.rows).map(|(a, b)| (*a - b).norm()).fold(0.0, f64::max);
            prop_assert!(off < 2e-4, "difference {}: {:?}", off, ours);
            prop_assert_eq!(ours.started(), second.tilt_age.is_some());
        }
    }

    #[test]
    fn paper_equals_a_filter_in_f64_with_any_gaps(
        weight in weight(), declination_rad in -3.0..3.0_f32, samples in prop::collection::vec(sample(), 1..40),
    ) {
        let method = Method::Complementary { kinematics: Kinematics::Euler, weight };
        let mut ours = Estimator::new(&EstimatorParams { method, declination_rad }).unwrap();
        let mut second = InAngles {
            weight,
            declination: declination_rad.into(),
            angles: [0.0; 3],
            started: (false, false),
            mag_dt: 0.0,
        };
        for now in &samples {
            ours.update(now.gyro, now.accel, now.mag, now.dt_s);
            if second.update(now).is_none() {
                return Ok(());
            }
            let Filters::Euler(filter) = ours.filter() else { unreachable!("the filter uses Euler angles") };
            for (ours, exact) in filter.angles().into_iter().zip(second.angles) {
                prop_assert!(remainder(f64::from(ours) - exact).abs() < 5e-4, "{} {}", ours, exact);
                prop_assert!(ours.abs() <= PI + 1e-6);
            }
            prop_assert_eq!(ours.started(), second.started.0);
        }
    }

    /// For any filter and any attitude: tilt, heading and attitude are consistent, and the first sample starts the
    /// filter.
    #[test]
    fn tilt_heading_and_attitude_are_consistent(params in every_method(), samples in prop::collection::vec(sample(), 1..20)) {
        let mut e = Estimator::new(&params).unwrap();
        prop_assert!(!e.started());
        for now in &samples {
            e.update(now.gyro, now.accel, now.mag, now.dt_s);
            let q = e.attitude();
            prop_assert!((e.down() - q.down()).norm() < 2e-5, "{:?}", e);
            let angles = q.to_euler();
            // The pitch of the paper's filter may pass the vertical, and its yaw does not change then.
            let over = matches!(e.filter(), Filters::Euler(filter) if filter.angles()[1].abs() > 1.5);
            if angles.pitch.abs() < 1.5 && !over {
                prop_assert!(wrap_pi(e.heading() - angles.yaw).abs() < 2e-5, "{:?}", e);
            }
            prop_assert!(e.heading().abs() <= PI + 1e-6);
            let estimates_bias = matches!(params.method, Method::Robust(_));
            prop_assert_eq!(e.input() == FilterInput::Calibrated, estimates_bias);
            if !estimates_bias {
                prop_assert_eq!(e.gyro_bias(), Vec3::ZERO);
            }
        }
    }

    /// After a reset every filter equals a new one. `on_gyro_zeroed` has no effect on a filter that estimates no
    /// bias.
    #[test]
    fn reset_filter_equals_a_new_one(params in every_method(), samples in prop::collection::vec(sample(), 1..20)) {
        let [mut used, mut fresh] = [Estimator::new(&params).unwrap(); 2];
        for now in &samples {
            used.update(now.gyro, now.accel, now.mag, now.dt_s);
        }
        used.restart();
        prop_assert!(!used.started() && used.gyro_bias() == Vec3::ZERO);
        for now in &samples {
            if used.input() != FilterInput::Calibrated {
                used.on_gyro_zeroed();
            }
            used.update(now.gyro, now.accel, now.mag, now.dt_s);
            fresh.update(now.gyro, now.accel, now.mag, now.dt_s);
            prop_assert_eq!(used.attitude(), fresh.attitude());
        }
    }

    /// Valid samples: less than 1,000 rad, 10⁸ m/s² and µT, later than the last one. Even with motion that no vehicle
    /// can perform, every intermediate attitude is valid.
    #[test]
    fn every_valid_sample_leaves_a_finite_attitude(
        params in every_method(),
        samples in prop::collection::vec((
            prop_oneof![about(8.0), about(500.0), Just(Vec3::ZERO), about(1e-30)],
            prop_oneof![
                about(20.0), about(5.0e7), Just(Vec3::ZERO), about(1e-30),
                Just(vec3(0.0, 0.0, 9.8)), Just(vec3(9.8, 0.0, 0.0)),
            ],
            prop::option::of(prop_oneof![about(60.0), about(5.0e7), Just(Vec3::ZERO), about(1e-30)]),
            prop_oneof![1.0e-6..1.0_f32, Just(1.0e-6), Just(0.001)],
        ), 1..60),
    ) {
        let mut e = Estimator::new(&params).unwrap();
        for (gyro, accel, mag, dt_s) in samples {
            e.update(gyro, accel, mag, dt_s);
            let q = e.attitude();
            prop_assert!((q.norm_squared() - 1.0).abs() < 1e-3, "{:?}", e);
            prop_assert!(e.heading().is_finite() && (e.down().norm() - 1.0).abs() < 2e-3, "{:?}", e);
        }
    }

    #[test]
    fn any_parameters_are_valid_or_rejected(
        a in prop_oneof![ANY, 0.0..2.0_f32, 0.0..2.0e4_f32],
        b in prop_oneof![ANY, 0.0..2000.0_f32],
        declination_rad in prop_oneof![ANY, -4.0..4.0_f32],
    ) {
        let declination_valid = (-PI..=PI).contains(&declination_rad);
        let complementary = |weight| Method::Complementary { kinematics: Kinematics::Euler, weight };
        for (method, valid) in [
            (complementary(Weight::TimeConstant { tau_s: a }), (1.0e-3..=1.0e4).contains(&a)),
            (complementary(Weight::Fixed { alpha: a }), (0.0..=1.0).contains(&a)),
            (
                Method::Robust(RobustParams { speed_m_s: a, heading_noise_rad: b }),
                (0.05..=50.0).contains(&a) && (1.0e-3..=10.0).contains(&b),
            ),
        ] {
            prop_assert_eq!(Estimator::new(&EstimatorParams { method, declination_rad }).is_ok(), valid && declination_valid);
        }
    }

    /// The zero is the plain mean of the readings since the vehicle came to rest, weighted by the time that each
    /// sample covers.
    #[test]
    fn gyro_zero_is_the_mean_over_the_rest(
        bias in about(0.25), runs in prop::collection::vec((
            about(0.02), about(0.15),
            prop_oneof![6 => Just(Vec3::ZERO), 1 => about(0.5)],
            prop_oneof![
                6 => Just(LEVEL),
                1 => about(3.0).prop_map(|off| off + LEVEL),
                3 => about(0.6).prop_map(|off| off + LEVEL),
                1 => Just(LEVEL * 1.2),
            ],
            1.0e-3..0.05_f32, prop::bool::weighted(0.1), 1..40_usize,
        ), 1..8),
    ) {
        let mut zero = GyroZero::default();
        let mut rest: Vec<(V, V, f64)> = Vec::new();
        let (mut learnt, mut zeroed) = (V::ZERO, false);
        let mean = |rest: &[(V, V, f64)]| {
            let time: f64 = rest.iter().map(|(_, _, dt)| dt).sum();
            let [mut gyro, mut accel] = [V::ZERO; 2];
            for (g, a, dt) in rest {
                gyro += *g * (dt / time);
                accel += *a * (dt / time);
            }
            (gyro, accel, time)
        };
        for (noise, shake, turn, accel, dt_s, interrupted, times) in runs {
            if interrupted {
                zero.interrupt();
                prop_assert!(!zero.still());
                rest.clear();
            }
            for time in 0..times {
                let sign = if time % 2 == 0 { 1.0 } else { -1.0 };
                let (gyro, accel) = (bias + turn + noise * sign, accel + shake * sign);
                zero.learn(gyro, accel, dt_s);
                let (gyro, accel) = (double(gyro), double(accel));
                let (mean_gyro, mean_accel, _) = mean(&rest);
                let steady = below((gyro - mean_gyro).norm(), 0.052).zip(below((accel - mean_accel).norm(), 0.6));
                let weight = below((accel.norm() - 9.80665).abs(), 0.980_665);
                let (Some((g, a)), Some(weight)) = (steady, weight) else { return Ok(()) };
                let still = !rest.is_empty() && g && a && weight;
                if !still {
                    rest.clear();
                }
                rest.push((gyro, accel, dt_s.into()));
                let (mean_gyro, _, time) = mean(&rest);
                let Some(short) = below(time, 1.0) else { return Ok(()) };
                let Some(slow) = below(mean_gyro.norm(), 0.35) else { return Ok(()) };
                if still && !short && slow {
                    (learnt, zeroed) = (mean_gyro, true);
                }
                if !short && !slow {
                    rest.clear();
                }
                prop_assert_eq!(zero.still(), !short && slow);
                prop_assert_eq!(zero.zeroed(), zeroed);
                prop_assert!((double(zero.bias()) - learnt).norm() < 1e-5, "{:?}", zero);
            }
        }
    }

    /// After any samples the bias is in its range, and a vehicle that then rests gives a new zero.
    #[test]
    fn any_samples_leave_a_zero_that_can_be_relearnt(
        samples in prop::collection::vec((
            prop_oneof![about(0.3), [ANY, ANY, ANY].prop_map(Vec3::from)],
            prop_oneof![Just(LEVEL), [ANY, ANY, ANY].prop_map(Vec3::from)],
            prop_oneof![0.0..0.5_f32, ANY],
        ), 0..40),
        bias in about(0.2),
    ) {
        let mut zero = GyroZero::default();
        for (gyro, accel, dt_s) in samples {
            zero.learn(gyro, accel, dt_s);
            prop_assert!(zero.bias().norm() <= 0.350_01, "{:?}", zero);
        }
        zero.interrupt();
        for _ in 0..200 {
            zero.learn(bias, LEVEL, 0.01);
        }
        prop_assert!(zero.zeroed() && zero.still() && (zero.bias() - bias).norm() < 1e-5, "{:?}", zero);
    }
}

/// An eighth of a second is exact in f32, and so is the sum of eight.
#[test]
fn one_second_of_rest_gives_a_zero() {
    let mut zero = GyroZero::default();
    for n in 1..=8 {
        zero.learn(vec3(0.1, 0.0, 0.0), LEVEL, 0.125);
        assert_eq!((zero.still(), zero.zeroed()), (n == 8, n == 8), "{n}");
    }
}

/// After ten seconds old readings lose their weight in the mean. If the bias steps, the share (1 − Δt/10 s)ⁿ of the
/// step remains as an error after n samples.
#[test]
fn long_rest_follows_a_drift() {
    let mut zero = GyroZero::default();
    for _ in 0..300 {
        zero.learn(vec3(0.1, 0.0, 0.0), LEVEL, 0.05);
    }
    let step = vec3(0.0, 0.02, 0.0);
    for n in 1..=400 {
        zero.learn(vec3(0.1, 0.0, 0.0) + step, LEVEL, 0.05);
        let left = 1.0 - zero.bias().y / step.y;
        assert!((left - 0.995_f32.powi(n)).abs() < 2e-4, "{left} after {n}");
    }
}

/// For exactly opposite directions the shortest rotation is not unique: any horizontal axis is correct, with the full
/// share of the half turn.
#[test]
fn opposite_direction_is_corrected_by_its_share() {
    let weight = Weight::Fixed { alpha: 0.75 };
    let params = EstimatorParams::complementary(Kinematics::Quaternion, weight);
    for down in [
        [1.0, 0.0, 0.0],
        [0.0, 1.0, 0.0],
        [0.0, 0.0, 1.0],
        [0.8, 0.6, 0.0],
        [0.6, 0.8, 0.0],
        [0.0, 0.6, -0.8],
    ] {
        for down in [Vec3::from(down), -Vec3::from(down)] {
            let mut e = Estimator::new(&params).unwrap();
            // 1 m/s², so that rounding moves the directions by less than 1e-6 from exactly opposite.
            e.update(Vec3::ZERO, -down, None, 0.0);
            e.update(Vec3::ZERO, down, None, 0.01);
            let cos = e.down().dot(down);
            assert!((cos - (0.25 * PI).cos()).abs() < 1e-5, "{down:?}: {cos}");
            assert!((e.attitude().norm_squared() - 1.0).abs() < 1e-6);
        }
    }
}

/// At a magnetic pole the field does not set the heading, neither the first sample nor the hundredth.
#[test]
fn vertical_field_sets_no_heading() {
    for (north, sets_heading) in [(-0.99, false), (-1.01, true)] {
        for mut e in all() {
            for _ in 0..100 {
                e.update(Vec3::ZERO, LEVEL, Some(vec3(north, 0.0, 48.0)), 0.01);
                assert_eq!(e.heading().abs() > 3.0, sets_heading, "{north} µT: {e:?}");
            }
        }
    }
}

/// In free fall there is no tilt to start from.
#[test]
fn free_fall_does_not_start_a_filter() {
    for mut e in all() {
        for force in [Vec3::ZERO, vec3(0.0, 0.5, 0.0), vec3(1e-30, 0.0, 0.0)] {
            e.update(Vec3::ZERO, force, None, 0.01);
            assert!(!e.started() && e.attitude() == Quaternion::IDENTITY, "{force:?}: {e:?}");
        }
    }
}

/// The limit is a horizontal force of 0.98 m/s²: slightly less has no effect, slightly more has. The robust filter
/// integrates any specific force: for it the limit only counts at the start.
#[test]
fn free_fall_ends_at_a_tenth_of_g() {
    for (force, has_effect) in [(0.975, false), (0.985, true)] {
        for mut e in all().into_iter().filter(|e| e.input() != FilterInput::Calibrated) {
            e.update(Vec3::ZERO, LEVEL, None, 0.0);
            e.update(Vec3::ZERO, vec3(0.0, force, 0.0), None, 0.01);
            let tilt = (e.down() - Vec3::Z).norm();
            assert_eq!(tilt > 1e-6, has_effect, "{force}: {tilt} {e:?}");
        }
    }
}
