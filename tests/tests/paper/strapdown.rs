//! Eqs 1-3: the position error that a sensor error causes in a position computed from the sensors alone.
//!
//! The vehicle stands still and level. Its sensors' readings are taken before the converter, because 1 mg is two counts
//! of a ±16 g chip, and 1 °/h is 1/200 of a count of ±2,000 °/s. They go into a strapdown integration: rotate by the
//! gyroscope, add gravity to the specific force, integrate twice. All of it is f64.

use flight_core::geometry::{Quaternion, Vec3, vec3};
use sim_host::dynamics::GRAVITY;
use sim_host::scene::Scene;
use sim_host::sensors::Sensor;

use crate::spread::Spread;
use crate::still::STILL;

const REST: Vec3<f64> = vec3(0.0, 0.0, -GRAVITY);
const TIME_S: f64 = 60.0;
const RATE_HZ: f64 = 100.0;

struct Strapdown {
    attitude: Quaternion<f64>,
    velocity: Vec3<f64>,
    position: Vec3<f64>,
    acceleration: Vec3<f64>,
}

impl Strapdown {
    fn level_at_rest() -> Self {
        let [velocity, position, acceleration] = [Vec3::ZERO; 3];
        Self { attitude: Quaternion::IDENTITY, velocity, position, acceleration }
    }

    /// Advances by the readings at the end of an interval of `h` s; trapezoidal in velocity and position.
    fn step(&mut self, rate: Vec3<f64>, force: Vec3<f64>, h: f64) {
        let half = rate * (0.5 * h);
        let angle = half.norm();
        let sinc = if angle > 0.0 { libm::sin(angle) / angle } else { 1.0 };
        self.attitude = self.attitude * Quaternion { w: libm::cos(angle), v: half * sinc };
        let acceleration = self.attitude.rotate(force) + vec3(0.0, 0.0, GRAVITY);
        let velocity = self.velocity + (self.acceleration + acceleration) * (0.5 * h);
        self.position += (self.velocity + velocity) * (0.5 * h);
        self.velocity = velocity;
        self.acceleration = acceleration;
    }
}

/// Returns the position after a minute at rest, with sensors that have these biases in addition to their effects.
fn position_after_a_minute(
    [gyro, accel]: &mut [Sensor; 2],
    rate_bias: Vec3<f64>,
    force_bias: Vec3<f64>,
) -> Vec3<f64> {
    let mut strapdown = Strapdown::level_at_rest();
    // This is the reading at time 0, for the first trapezium.
    strapdown.acceleration = force_bias;
    for _ in 0..(TIME_S * RATE_HZ) as u32 {
        let rate = gyro.measure(rate_bias, &STILL);
        let force = accel.measure(REST + force_bias, &STILL);
        strapdown.step(rate, force, 1.0 / RATE_HZ);
    }
    strapdown.position
}

fn built_in(name: &str) -> Scene {
    Scene::load(name).unwrap_or_else(|error| panic!("{error}"))
}

/// Returns sensors without errors.
fn perfect() -> [Sensor; 2] {
    let [gyro, accel, _] = built_in("static").converters;
    [Sensor::new(vec![], gyro), Sensor::new(vec![], accel)]
}

#[test]
fn accelerometer_bias_of_1_mg_is_17_65_m_after_a_minute() {
    let bias = 1e-3 * GRAVITY;
    let closed_form = 0.5 * bias * TIME_S * TIME_S;
    assert!((closed_form - 17.652).abs() < 0.001);
    for axis in [vec3(1.0, 0.0, 0.0), vec3(0.0, 1.0, 0.0), vec3(0.0, 0.0, 1.0)] {
        let position = position_after_a_minute(&mut perfect(), Vec3::ZERO, axis * bias);
        assert!((position - axis * closed_form).norm() < 1e-9 * closed_form, "{position:?}");
    }
}

#[test]
fn gyroscope_bias_of_1_deg_per_h_is_1_7116_m_after_a_minute() {
    let bias = 1.0_f64.to_radians() / 3600.0;
    let closed_form = GRAVITY * bias * TIME_S * TIME_S * TIME_S / 6.0;
    assert!((closed_form - 1.7116).abs() < 0.0001);
    // With a tilt b t, the part g (b t)²/2 of g is not supported: the fall is g b² t⁴/24, 0.12 mm.
    let down = GRAVITY * bias * bias * TIME_S * TIME_S * TIME_S * TIME_S / 24.0;
    // An apparent roll to the right gives an apparent force to the east; nose up, to the south.
    for (rate, towards) in [
        (vec3(bias, 0.0, 0.0), vec3(0.0, closed_form, down)),
        (vec3(0.0, bias, 0.0), vec3(-closed_form, 0.0, down)),
        (vec3(0.0, 0.0, bias), Vec3::ZERO),
    ] {
        let position = position_after_a_minute(&mut perfect(), rate, Vec3::ZERO);
        // The trapezoidal rule overshoots t³/6 by h²t/6, relative (h/t)² = 3e-8; the angle, 3e-4 rad, has the square
        // 1e-7.
        assert!((position - towards).norm() < 1e-6 * closed_form, "{position:?}");
    }
}

/// The position error from the white noise of table 2 exceeds those of both biases: the double integral of white noise
/// N grows as N √(t³/3), and a tilt in random walk gives g N √(t⁵/20).
#[test]
fn noise_of_table_2_moves_position_as_the_closed_form() {
    let scene = built_in("static");
    let g_n = |deg_per_sqrt_h: f64| GRAVITY * (deg_per_sqrt_h / 60.0).to_radians();
    let by_gyro = libm::sqrt(libm::pow(TIME_S, 5.0) / 20.0);
    let by_accel = libm::sqrt(libm::pow(TIME_S, 3.0) / 3.0);
    // North depends on the pitch gyroscope and the x accelerometer, east on roll and y.
    let by_both = |deg_per_sqrt_h| libm::hypot(g_n(deg_per_sqrt_h) * by_gyro, 0.0012 * by_accel);
    let expected = [by_both(1.239), by_both(1.9368)];
    assert!((expected[1] - 34.45).abs() < 0.01 && (0.0012 * by_accel - 0.322).abs() < 0.001);

    let mut spreads = [Spread::default(); 2];
    for seed in 0..1000 {
        let mut sensors = [scene.gyro(seed, RATE_HZ), scene.accel(seed, RATE_HZ)];
        let position = position_after_a_minute(&mut sensors, Vec3::ZERO, Vec3::ZERO);
        for (spread, axis) in spreads.iter_mut().zip([position.x, position.y]) {
            spread.add(axis);
        }
    }
    for (spread, expected) in spreads.iter().zip(expected) {
        spread.assert_deviation(expected, 1.0);
    }
}
