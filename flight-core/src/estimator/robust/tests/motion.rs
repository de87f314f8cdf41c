//! Accuracy in motion of which attitude, rate and specific force are known exactly, in f64.

use super::super::super::tests::properties::rotation;
use super::second::{G64, RAD, V, double};
use super::*;

fn single(v: V) -> Vec3<f32> {
    <[f64; 3]>::from(v).map(|x| x as f32).into()
}

/// Returns the angle between the true direction of down and the estimate, rad.
fn tilt_error(filter: &RobustFilter, attitude: Mat3<f64>) -> f64 {
    let down = double(filter.down());
    down.cross(attitude.rows[2]).norm().atan2(down.dot(attitude.rows[2]))
}

/// A gyroscope with bias b and scale error s, whose reading g is right after ω = g − b − s g.
fn reading(rates: V, bias: V, scale: V) -> Vec3<f32> {
    let each = |rate: f64, bias: f64, scale: f64| (rate + bias) / (1.0 - scale);
    single(vec3(
        each(rates.x, bias.x, scale.x),
        each(rates.y, bias.y, scale.y),
        each(rates.z, bias.z, scale.z),
    ))
}

/// Turns about one axis after the other, 200 °/s for 3 s, forward and back, without acceleration.
#[test]
fn scale_and_bias_are_learnt_from_rotation() {
    let (bias, scale) = (vec3(0.01, -0.015, 0.02), vec3(0.004, -0.004, 0.003));
    let mut filter = filter();
    let mut attitude = Mat3::IDENTITY;
    let dt = f64::from(0.005_f32);
    for turn in 0..60_u32 {
        let rate = 200.0 * RAD * if turn % 4 < 2 { 1.0 } else { -1.0 };
        let axes = [Vec3::X, vec3(0.0, 1.0, 0.0), Vec3::Z, vec3(0.6, 0.0, 0.8), vec3(0.48, 0.6, 0.64)];
        let rates = axes[(turn % 5) as usize] * rate;
        for _ in 0..600 {
            attitude = attitude * rotation(rates * dt);
            let to_body = attitude.transpose();
            let (accel, mag) = (to_body * vec3(0.0, 0.0, -G64), to_body * double(FIELD));
            filter.update(reading(rates, bias, scale), single(accel), Some(single(mag)), 0.005);
        }
    }
    std::println!("scale {:?}, bias {:?}", filter.scale, filter.bias);
    for (learnt, exact) in [(filter.scale.x, scale.x), (filter.scale.y, scale.y), (filter.scale.z, scale.z)] {
        assert!((f64::from(learnt) - exact).abs() < 1e-3, "{learnt} of {exact}");
    }
    assert!((double(filter.bias) - bias).norm() < 0.1 * RAD, "{:?}", filter.bias);
    assert!(tilt_error(&filter, attitude) < 0.3 * RAD, "{filter:?}");
}

/// A multirotor without drag: its specific force is along its z axis, so that no single reading shows its tilt.
struct Multirotor {
    /// Per horizontal axis three sines of the velocity: amplitude (m/s), angular frequency (rad/s), phase.
    sines: [[[f64; 3]; 3]; 3],
}

impl Multirotor {
    /// Sines of 0.05 to 0.7 Hz with a velocity of 0.8 m/s RMS north and east, and a third of it down.
    fn new(seed: u64) -> Self {
        let mut random = Random(seed);
        let mut between =
            |low: f64, high: f64| low + (high - low) * (0.5 + 0.5 * f64::from(random.within(1.0)));
        let mut sines = [[[0.0; 3]; 3]; 3];
        for (axis, sines) in sines.iter_mut().enumerate() {
            let size = if axis < 2 { 0.8 } else { 0.3 };
            for sine in sines {
                let hz: f64 = between(0.05, 0.7);
                *sine = [
                    size * (2.0_f64 / 3.0).sqrt(),
                    hz * core::f64::consts::TAU,
                    between(0.0, core::f64::consts::TAU),
                ];
            }
        }
        Self { sines }
    }

    fn acceleration(&self, t: f64) -> V {
        self.sines.map(|sines| sines.iter().map(|[v, w, phase]| v * w * (w * t + phase).cos()).sum()).into()
    }

    /// Returns the attitude and the thrust, m/s².
    fn at(&self, t: f64) -> (Mat3<f64>, f64) {
        let force = self.acceleration(t) + vec3(0.0, 0.0, -G64);
        let down = force * (-1.0 / force.norm());
        let yaw = 1.5 * (0.4 * t).sin() + 0.15 * t;
        let right = down.cross(vec3(yaw.cos(), yaw.sin(), 0.0));
        let right = right * (1.0 / right.norm());
        (Mat3 { rows: [right.cross(down), right, down] }.transpose(), force.norm())
    }
}

/// Returns the rotation vector of a small rotation, to third order in the angle.
fn small_rotation(r: Mat3<f64>) -> V {
    let twice_sine = vec3(r[2].y - r[1].z, r[0].z - r[2].x, r[1].x - r[0].y);
    let sine = 0.5 * twice_sine.norm();
    twice_sine * (0.5 * if sine > 0.0 { sine.asin() / sine } else { 1.0 })
}

/// Started in the middle of a flight, with a bias as large as those of phones, and without a magnetometer. The first
/// tilt is wrong by up to 30°, and the bias turns the estimate by 50° in the 10 s that it takes to learn it: of the
/// 120 s these 10 s alone are 2° RMS.
#[test]
fn flight_with_a_large_bias_and_no_field_keeps_its_tilt() {
    let bias = vec3(4.6, -1.2, -0.1) * RAD;
    let dt = f64::from(0.005_f32);
    for seed in 1..=6 {
        let multirotor = Multirotor::new(seed);
        let mut filter = filter();
        let (mut last, _) = multirotor.at(0.0);
        let (mut sum, mut late_sum, mut speed) = (0.0, 0.0, 0.0);
        let (steps, late) = (24_000_u32, 6000);
        for step in 0..steps {
            let t = f64::from(step) * dt;
            let (attitude, thrust) = multirotor.at(t);
            let rates = small_rotation(last.transpose() * attitude) * (1.0 / dt);
            last = attitude;
            filter.update(single(rates + bias), vec3(0.0, 0.0, -thrust as f32), None, 0.005);
            let squared = tilt_error(&filter, attitude).powi(2);
            sum += squared;
            late_sum += if step >= late { squared } else { 0.0 };
            let [north, east] = [0, 1].map(|axis: usize| {
                multirotor.sines[axis].iter().map(|[v, w, phase]| v * (w * t + phase).sin()).sum::<f64>()
            });
            speed += north * north + east * east;
        }
        let [rmse, late_rmse] =
            [sum / f64::from(steps), late_sum / f64::from(steps - late)].map(|mean: f64| mean.sqrt() / RAD);
        let speed = (speed / f64::from(steps)).sqrt();
        std::println!(
            "seed {seed}: {rmse:.2} deg, after 30 s {late_rmse:.2} deg, {speed:.2} m/s, bias off {:.3} deg/s",
            (double(filter.bias) - bias).norm() / RAD
        );
        assert!((1.0..2.5).contains(&speed), "{speed} m/s");
        assert!(rmse < 3.0 && late_rmse < 0.5, "seed {seed}: {rmse} deg, after 30 s {late_rmse} deg");
    }
}
