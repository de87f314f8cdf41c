//! Attitudes at which angles, axes or norms have a singularity or a limit.

use std::f64::consts::PI;

use flight_core::estimator::{Estimator, EstimatorParams};
use flight_core::geometry::{Quaternion, Vec3, vec3};

use crate::truth::{Body, double, is_accurate, rotation, single, tau_s};

const DEGREE: f64 = PI / 180.0;
const DT_S: f64 = 1e-3;

/// Bound of the error that turns with consistent sensors leave, which is rounding only. A step in f32 loses up to 3 ε
/// in the product and the normalisation, 3.6e-7 rad, with a random sign. The correction forgets it over τ, so that
/// √(τ/2Δt) of them remain: 2.5e-5 rad with τ = 10 s. A systematic 1e-9 rad/s from the rounding of the rate adds τ
/// times itself. 0.02° is ten times the sum.
const ROUNDING_DEG: f64 = 0.02;

/// Flies legs, each with a rate, rad/s, and a time, s, and checks the error in every step: accurate presets must keep
/// [`ROUNDING_DEG`], all presets must stay finite.
fn fly(name: &str, params: &EstimatorParams, legs: &[(Vec3<f64>, f64)]) -> Body {
    let mut body = Body::at(Quaternion::IDENTITY, params);
    let mut worst = 0.0_f64;
    for &(rate, seconds) in legs {
        for _ in 0..(seconds / DT_S).round() as u32 {
            body.turn(rate, DT_S);
            let error = body.error_deg();
            assert!(error.is_finite(), "{name}");
            worst = worst.max(error);
        }
    }
    assert!(!is_accurate(name) || worst < ROUNDING_DEG, "{name}: {worst}°");
    body
}

/// Checks that an estimator is accurate again at rest. After leaving the vertical, an Euler preset needs 5 τ: of half a
/// turn e⁻⁵ remains in roll and in pitch, 1.2° each. They also rotate its heading, which therefore lags behind:
/// (1 + 5) e⁻⁵ of half a turn, 7°; after 10 τ it is 0.09°.
fn check_recovers(name: &str, params: &EstimatorParams, mut body: Body) {
    let tau_steps = (tau_s(params) / DT_S).round() as u32;
    let rest = |body: &mut Body, taus: u32| (0..taus * tau_steps).for_each(|_| body.turn(Vec3::ZERO, DT_S));
    rest(&mut body, 5);
    assert!(body.inclination_deg() < 2.5, "{name}: {}° after 5 τ", body.inclination_deg());
    rest(&mut body, 5);
    assert!(body.error_deg() < 0.2, "{name}: {}° after 10 τ", body.error_deg());
}

#[test]
fn pitch_through_the_vertical_keeps_or_regains_accuracy() {
    let pitch = |deg_s: f64| vec3(0.0, deg_s * DEGREE, 0.0);
    for (name, params) in EstimatorParams::PRESETS {
        // The vehicle makes a full turn in pitch, through both verticals.
        for deg_s in [10.0, 90.0, 1_000.0] {
            let body = fly(name, &params, &[(pitch(deg_s), 360.0 / deg_s)]);
            check_recovers(name, &params, body);
        }
        // The vehicle pitches up, stays at the vertical for ten seconds, turns about the long axis there, and
        // pitches down again.
        let parked = [
            (pitch(45.0), 2.0),
            (Vec3::ZERO, 10.0),
            (vec3(90.0 * DEGREE, 0.0, 0.0), 4.0),
            (pitch(-45.0), 2.0),
        ];
        let body = fly(name, &params, &parked);
        check_recovers(name, &params, body);
        // The largest turns of one sample, starting at the vertical, where the cosine in f32 is 4e-8: the resulting
        // angles must still have a sine.
        for k in 1..1_000 {
            let mut body = Body::at(rotation(vec3(0.0, 0.5 * PI, 0.0)), &params);
            let gyro = single(vec3(0.0, 3.0, 9.9) * f64::from(k));
            body.estimator.update(gyro, single(Vec3::ZERO), None, 0.1);
            let norm = double(body.estimator.attitude()).norm_squared().sqrt();
            assert!((norm - 1.0).abs() < 1e-3, "{name}, {k}: a norm of {norm}");
        }
    }
}

#[test]
fn inverted_flight_keeps_accuracy() {
    let roll = |deg_s: f64| vec3(deg_s * DEGREE, 0.0, 0.0);
    for (name, params) in EstimatorParams::PRESETS {
        let body = fly(name, &params, &[(roll(180.0), 1.0), (Vec3::ZERO, 30.0)]);
        // Inverted is not vertical: no Euler angle is singular here.
        assert!(body.error_deg() < ROUNDING_DEG, "{name}: {}°", body.error_deg());
        assert!(body.estimator.down().z < -0.999);
        fly(name, &params, &[(roll(180.0), 1.0), (vec3(0.0, 0.0, 1.0), 6.0), (roll(-180.0), 1.0)]);
    }
}

#[test]
fn repeated_yaw_turns_keep_accuracy() {
    for (name, params) in EstimatorParams::PRESETS {
        for deg_s in [90.0, -400.0] {
            let body = fly(name, &params, &[(vec3(0.0, 0.0, deg_s * DEGREE), 20.0)]);
            assert!(body.error_deg() < ROUNDING_DEG, "{name}: {}°", body.error_deg());
        }
    }
}

#[test]
fn spins_at_the_gyroscope_range_keep_or_regain_accuracy() {
    for (name, params) in EstimatorParams::PRESETS {
        for axis in [vec3(1.0, 0.0, 0.0), vec3(0.0, 1.0, 0.0), vec3(0.0, 0.0, 1.0), vec3(0.6, 0.64, 0.48)] {
            // A rate in f32 has an error of up to 3.5e-8 of itself, 1.2e-6 rad/s here. It leaves that times τ: 7e-4°.
            let body = fly(name, &params, &[(axis * (2_000.0 * DEGREE), 10.0)]);
            check_recovers(name, &params, body);
        }
    }
}

/// A free body by Euler's equations, integrated by RK4 in f64.
struct Tumbling {
    rates: Vec3<f64>,
}

impl Tumbling {
    /// Advances by one step and returns its mean rate.
    fn step(&mut self, dt_s: f64) -> Vec3<f64> {
        // Rotation about the intermediate axis is unstable.
        let [ix, iy, iz] = [1.0, 2.0, 3.0];
        let slope = |w: Vec3<f64>| {
            vec3((iy - iz) / ix * w.y * w.z, (iz - ix) / iy * w.z * w.x, (ix - iy) / iz * w.x * w.y)
        };
        let w = self.rates;
        let k1 = slope(w);
        let k2 = slope(w + k1 * (0.5 * dt_s));
        let k3 = slope(w + k2 * (0.5 * dt_s));
        let k4 = slope(w + k3 * dt_s);
        self.rates = w + (k1 + (k2 + k3) * 2.0 + k4) * (dt_s / 6.0);
        w + (k1 + k2 + k3) * (dt_s / 6.0)
    }
}

#[test]
fn hour_of_tumbling_on_intermediate_axis_keeps_accuracy() {
    for (name, params) in EstimatorParams::PRESETS {
        let mut body = Body::at(Quaternion::IDENTITY, &params);
        let mut tumbling = Tumbling { rates: vec3(0.02, 6.0, 0.01) };
        let (mut worst, mut flips, mut last) = (0.0_f64, 0_u32, 1.0_f64);
        for _ in 0..3_600_000 {
            body.turn(tumbling.step(DT_S), DT_S);
            let error = body.error_deg();
            assert!(error.is_finite(), "{name}");
            worst = worst.max(error);
            flips += u32::from(tumbling.rates.y.signum() != last);
            last = tumbling.rates.y.signum();
        }
        assert!(flips > 200, "{flips} flips");
        assert!(!is_accurate(name) || worst < 2.0 * ROUNDING_DEG, "{name}: {worst}°");
    }
}

#[test]
fn hour_of_f32_integration_drifts_by_rounding_only() {
    // The estimator gets no gravity and no magnetic field for an hour, so the rounding errors of f32 add up. 3.6
    // million steps round by 3 ε each. With equal signs the sum is 1.3 rad, with random signs 6.8e-4 rad. The rate of
    // 6 rad/s is itself rounded by a fraction of 3e-8. If the sign of this error never changes, it adds 6.5e-4 rad in
    // an hour. The bound, 0.25°, is three times the sum of the two.
    for (name, params) in EstimatorParams::PRESETS.into_iter().filter(|(name, _)| is_accurate(name)) {
        let mut body = Body::at(Quaternion::IDENTITY, &params);
        let mut tumbling = Tumbling { rates: vec3(0.02, 6.0, 0.01) };
        for _ in 0..3_600_000 {
            body.turn_without_references(tumbling.step(DT_S), DT_S);
        }
        assert!(body.error_deg() < 0.25, "{name}: {}°", body.error_deg());
    }
}

/// Exact half turns, which no rotation vector in f64 gives: here sines are 0, and not 1e-16.
const HALF_TURNS: [Quaternion<f64>; 2] =
    [Quaternion::new(0.0, 1.0, 0.0, 0.0), Quaternion::new(0.0, 0.0, 1.0, 0.0)];

#[test]
fn estimate_wrong_by_half_a_turn_recovers() {
    // The shortest rotation back has no unique axis: any one will do, but the filter must choose one.
    let axes = [vec3(1.0, 0.0, 0.0), vec3(0.0, 1.0, 0.0), vec3(0.6, 0.8, 0.0), vec3(-0.8, 0.6, 0.0)];
    let attitudes = [Quaternion::IDENTITY, rotation(vec3(0.0, 0.0, 2.0)), rotation(vec3(0.0, 0.5 * PI, 0.0))];
    for (name, params) in EstimatorParams::PRESETS {
        for attitude in attitudes {
            for wrong in axes.map(|axis| rotation(axis * PI)).into_iter().chain(HALF_TURNS) {
                let mut body = Body::at(attitude * wrong, &params);
                body.attitude = attitude;
                // `robust` gives up a field that contradicts its start after a minute; 12 τ are 120 s.
                for _ in 0..20_000 {
                    body.turn(Vec3::ZERO, 0.01);
                    assert!(body.error_deg().is_finite(), "{name}");
                }
                let inclination = body.inclination_deg();
                assert!(inclination < 0.1, "{name}, {wrong:?}: {inclination}°");
                let error = body.error_deg();
                assert!(!is_accurate(name) || error < 0.5, "{name}, {wrong:?}: {error}°");
            }
        }
    }
}

#[test]
fn inverted_or_vertical_start_is_right_at_first_sample() {
    // Inverted, the shortest rotation is not unique, and (1 + cos, sin) of the angle is the zero quaternion.
    let ways = [vec3(PI, 0.0, 0.0), vec3(PI - 1e-4, 0.0, 0.0), vec3(0.0, 0.5 * PI, 0.0)].map(rotation);
    for (name, params) in EstimatorParams::PRESETS {
        for way in ways.into_iter().chain(HALF_TURNS) {
            for heading in [0.0, 2.0] {
                let mut body = Body::at(rotation(vec3(0.0, 0.0, heading)) * way, &params);
                let first = body.inclination_deg();
                assert!(first < ROUNDING_DEG, "{name}, {way:?}: {first}°");
                (0..30_000).for_each(|_| body.turn(Vec3::ZERO, DT_S));
                // At the vertical the heading of Euler angles is undefined.
                let error = if is_accurate(name) { body.error_deg() } else { body.inclination_deg() };
                assert!(error < ROUNDING_DEG, "{name}, {way:?}: {error}°");
            }
        }
    }
}

/// Bound of the norm's error: each update ends with a normalisation that leaves 2 ε, and nothing accumulates.
const NORM: f64 = 4.0 * f32::EPSILON as f64;

#[test]
#[ignore = "10⁹ updates of each filter: more than a minute; .ci/nightly runs it"]
fn billion_updates_keep_a_unit_quaternion() {
    // Random samples, repeated, so that every branch of the filters is taken.
    let mut state = 7_u32;
    let mut random = |scale: f32| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        scale * (f32::from((state >> 16) as u16) / 32_768.0 - 1.0)
    };
    let samples: Vec<[Vec3<f32>; 3]> = (0..4096)
        .map(|_| [35.0, 20.0, 60.0].map(|scale| vec3(random(scale), random(scale), random(scale))))
        .collect();
    std::thread::scope(|threads| {
        for (name, params) in EstimatorParams::PRESETS.into_iter().filter(|(name, _)| is_accurate(name)) {
            let samples = &samples;
            threads.spawn(move || {
                let mut estimator = Estimator::new(&params).unwrap();
                for update in 0..1_000_000_000_usize {
                    let [gyro, accel, mag] = samples[update % samples.len()];
                    estimator.update(gyro, accel, update.is_multiple_of(10).then_some(mag), 1e-3);
                    if update.is_multiple_of(1_000_003) {
                        let norm = double(estimator.attitude()).norm_squared().sqrt();
                        assert!((norm - 1.0).abs() < NORM, "{name}: {norm} after {update}");
                    }
                }
            });
        }
    });
}

#[test]
fn quaternion_norm_does_not_drift() {
    let mut tumbling = Tumbling { rates: vec3(0.3, 4.0, -2.0) };
    for (name, params) in EstimatorParams::PRESETS {
        let mut body = Body::at(rotation(vec3(0.3, -0.2, 1.0)), &params);
        for _ in 0..1_000_000 {
            body.turn_without_references(tumbling.step(DT_S), DT_S);
            let norm = double(body.estimator.attitude()).norm_squared().sqrt();
            assert!((norm - 1.0).abs() < NORM, "{name}: {norm}");
        }
    }
}
