//! The filter against a second implementation (`tests/second.rs`), its parts at the ends of their ranges, and its
//! accuracy in motion that is known exactly (`tests/motion.rs`).

#![allow(clippy::needless_range_loop, reason = "an index stands for a row and for a column")]

mod motion;
mod second;

use super::*;
use crate::geometry::Mat3;
use core::cell::Cell;
use proptest::num::f32::ANY;
use proptest::prelude::*;
use proptest::test_runner::TestRunner;
use second::{InDouble, RAD, double};
use std::boxed::Box;

const PARAMS: RobustParams = RobustParams { speed_m_s: 0.3, heading_noise_rad: 0.13 };
const LEVEL: Vec3<f32> = vec3(0.0, 0.0, -9.80665);
/// A field that points to north and down, µT.
const FIELD: Vec3<f32> = vec3(25.0, 0.0, 41.0);

fn filter() -> RobustFilter {
    RobustFilter::new(PARAMS, 0.0)
}

/// Updates the filter with constant readings.
fn hold(
    filter: &mut RobustFilter,
    gyro: Vec3<f32>,
    accel: Vec3<f32>,
    mag: Option<Vec3<f32>>,
    dt_s: f32,
    steps: u32,
) {
    for _ in 0..steps {
        filter.update(gyro, accel, mag, dt_s);
    }
}

/// Knuth's MMIX generator, for sequences that are too long for a property test.
struct Random(u64);

impl Random {
    /// Returns a number from −`size` to `size`.
    fn within(&mut self, size: f32) -> f32 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        // Only the upper half of the bits is random enough.
        size * (((self.0 >> 32) as f64) / 2_147_483_648.0 - 1.0) as f32
    }

    fn vector(&mut self, size: f32) -> Vec3<f32> {
        vec3(self.within(size), self.within(size), self.within(size))
    }

    fn one_of<T: Copy>(&mut self, choices: &[T]) -> T {
        let share = 0.5 + 0.5 * f64::from(self.within(1.0));
        choices[((share * choices.len() as f64) as usize).min(choices.len() - 1)]
    }
}

/// A time with approximately constant readings.
#[derive(Clone, Debug)]
struct Phase {
    gyro: Vec3<f32>,
    accel: Vec3<f32>,
    mag: Option<Vec3<f32>>,
    /// Size of the noise that each step adds to rate and specific force, on another axis each time.
    noise: (f32, f32),
    dt_s: f32,
    steps: usize,
}

fn about(size: f32) -> impl Strategy<Value = Vec3<f32>> {
    [-size..size, -size..size, -size..size].prop_map(Vec3::from)
}

fn phase() -> impl Strategy<Value = Phase> {
    let near_level = about(3.0).prop_map(|off| off + LEVEL);
    let upside_down = about(3.0).prop_map(|off| off - LEVEL);
    let gyro =
        prop_oneof![3 => about(0.03), 2 => about(1.0), 1 => about(6.0), 1 => Just(vec3(250.0, 0.0, 0.0))];
    let accel = prop_oneof![
        3 => Just(LEVEL), 4 => near_level, 1 => upside_down, 1 => about(15.0), 1 => about(0.3),
        1 => Just(vec3(0.0, 0.0, 2.0e3))
    ];
    let field = about(8.0).prop_map(|off| off + vec3(20.0, 10.0, 30.0));
    let field = prop_oneof![4 => field, 1 => about(50.0), 1 => Just(vec3(0.0, 2.0e4, 0.0))];
    let mag = prop::option::weighted(0.85, field);
    let noise = (
        prop_oneof![Just(0.0_f32), Just(0.002), Just(0.3)],
        prop_oneof![Just(0.0_f32), Just(0.05), Just(2.0)],
    );
    let dt_s = prop_oneof![
        2 => Just(0.0053_f32),
        2 => Just(0.0207),
        2 => 0.001..0.1_f32,
        1 => Just(0.47),
        1 => Just(0.0),
        1 => Just(-0.5),
        1 => Just(3.0)
    ];
    (gyro, accel, mag, noise, dt_s, 1..150_usize).prop_map(|(gyro, accel, mag, noise, dt_s, steps)| Phase {
        gyro,
        accel,
        mag,
        noise,
        dt_s,
        steps,
    })
}

/// Returns whether the filter is inside of the prediction: its matrix is half multiplied.
fn predicting(filter: &RobustFilter) -> bool {
    (1..=2).contains(&filter.part)
}

/// Returns the differences between the two filters, each with its bound.
fn differences(ours: &RobustFilter, second: &InDouble) -> [(&'static str, f64, f64); 8] {
    let matrix = ours.q.to_matrix().rows.map(double);
    let theirs = second.attitude.unwrap_or(Mat3::IDENTITY).rows;
    let attitude = matrix.iter().zip(theirs).map(|(a, b)| (*a - b).norm()).fold(0.0, f64::max);
    let speed = second.velocity[0].hypot(second.velocity[1]);
    let velocity = [0, 1].map(|axis| (f64::from(ours.velocity[axis]) - second.velocity[axis]).abs());
    let [level, vertical, deviating] = ours.magnetic.means().map(f64::from);
    let field_means = (level - second.field_means[0]).abs() + (vertical - second.field_means[1]).abs();
    // Of all covariances, as a share of the standard deviations.
    let p = ours.covariance.matrix();
    let mut covariance = 0.0_f64;
    for (row, theirs) in second.p.iter().enumerate() {
        for (column, exact) in theirs.iter().enumerate().filter(|_| !predicting(ours)) {
            let size = (second.p[row][row] * second.p[column][column]).sqrt();
            covariance = covariance.max((f64::from(p[row][column]) - exact).abs() / size);
        }
    }
    [
        ("attitude", attitude, 1e-3),
        ("velocity", velocity[0].max(velocity[1]), 3e-3 + 3e-4 * speed),
        ("bias", (double(ours.bias) - second.bias).norm(), 1e-4),
        ("scale", (double(ours.scale) - second.scale).norm(), 1e-4),
        ("covariance", covariance, 1e-2),
        ("offset", (double(ours.magnetic.offset) - second.offset).norm(), 3e-3),
        ("field means", field_means, 2e-2),
        ("deviating", (deviating - second.deviating).abs(), 1e-3),
    ]
}

/// Compares the two filters over random phases. A case ends where rounding decides a comparison; most do not.
#[test]
fn filter_equals_a_second_one_in_f64() {
    let strategy = (
        prop_oneof![2 => 0.1..1.0_f32, 1 => 0.05..50.0_f32],
        prop_oneof![2 => 0.01..1.0_f32, 1 => 0.001..10.0_f32],
        -3.0..3.0_f32,
        prop_oneof![6 => about(6.0).prop_map(|off| off + LEVEL), 1 => about(0.3)],
        prop::collection::vec(phase(), 1..6),
        0..12_usize,
    );
    let (cases, left_out) = (Cell::new(0), Cell::new(0));
    let worst = [const { Cell::new(0.0_f64) }; 8];
    let mut runner = TestRunner::new(ProptestConfig::with_source_file(file!()));
    let result =
        runner.run(&strategy, |(speed_m_s, heading_noise_rad, declination, start, phases, zeroed_before)| {
            let params = RobustParams { speed_m_s, heading_noise_rad };
            let mut ours = RobustFilter::new(params, declination);
            let mut second = Box::new(InDouble::new(params, declination));
            cases.set(cases.get() + 1);
            ours.update(Vec3::ZERO, start, None, 0.0);
            second.update(Vec3::ZERO, double(start), None, 0.0);
            for (index, phase) in phases.iter().enumerate() {
                if index == zeroed_before {
                    ours.on_gyro_zeroed();
                    second.on_gyro_zeroed();
                }
                for step in 0..phase.steps {
                    let sign = if step % 2 == 0 { 1.0 } else { -1.0 };
                    let mut noise = [0.0; 3];
                    noise[step % 3] = sign;
                    let noise = Vec3::from(noise);
                    let (gyro, accel) =
                        (phase.gyro + noise * phase.noise.0, phase.accel + noise * phase.noise.1);
                    ours.update(gyro, accel, phase.mag, phase.dt_s);
                    second.update(double(gyro), double(accel), phase.mag.map(double), phase.dt_s.into());
                    if second.ambiguous {
                        left_out.set(left_out.get() + 1);
                        return Ok(());
                    }
                    for ((what, off, bound), worst) in differences(&ours, &second).into_iter().zip(&worst) {
                        // With steps of half a second to a second, corrections of up to 1 rad amplify rounding: in one case
                        // of a thousand the differences reach three times the bound of shorter steps.
                        let bound =
                            if phases.iter().any(|phase| phase.dt_s > 0.1) { 10.0 * bound } else { bound };
                        worst.set(worst.get().max(off / bound));
                        prop_assert!(
                            off <= bound,
                            "{} differs by {} in step {} of {:?}",
                            what,
                            off,
                            step,
                            phase
                        );
                    }
                    prop_assert_eq!(ours.started(), second.attitude.is_some());
                }
            }
            Ok(())
        });
    std::println!(
        "{} of {} cases left out; differences as a share of their bounds {worst:?}",
        left_out.get(),
        cases.get()
    );
    if let Err(error) = result {
        panic!("{error}\n{runner}");
    }
    assert!(4 * left_out.get() <= cases.get(), "{} of {} cases left out", left_out.get(), cases.get());
}

proptest! {
    /// After a restart a filter is equal to a new one, after any samples.
    #[test]
    fn restart_equals_a_new_filter(phases in prop::collection::vec(phase(), 1..3), odd in [ANY, ANY, ANY]) {
        let [mut used, mut fresh] = [RobustFilter::new(PARAMS, 0.3); 2];
        for Phase { gyro, accel, mag, dt_s, .. } in &phases {
            hold(&mut used, *gyro, *accel, *mag, *dt_s, 50);
        }
        used.update(odd.into(), odd.into(), Some(odd.into()), odd[0]);
        used.on_gyro_zeroed();
        used.restart();
        for Phase { gyro, accel, mag, dt_s, .. } in phases {
            for _ in 0..20 {
                used.update(gyro, accel, mag, dt_s);
                fresh.update(gyro, accel, mag, dt_s);
                prop_assert_eq!((used.attitude(), used.gyro_bias()), (fresh.attitude(), fresh.gyro_bias()));
            }
        }
    }
}

/// Returns the smallest pivot of Cholesky's decomposition of the correlations, or `None` if the matrix is not
/// symmetric, or has a variance that is not positive or above its limit.
fn smallest_pivot(filter: &RobustFilter) -> Option<f64> {
    let p = filter.covariance.matrix();
    let deviation: [f64; STATES] = core::array::from_fn(|state| f64::from(p[state][state]).sqrt());
    let mut factor = [[0.0; STATES]; STATES];
    let mut smallest = f64::INFINITY;
    let (attitude, velocity, bias, scale) = (60.0 * RAD, 100.0, 3.0 * RAD, 0.005);
    let limits = [attitude, attitude, attitude, velocity, velocity, bias, bias, bias, scale, scale, scale];
    for row in 0..STATES {
        // 1 %: predictions inside a cycle add to a variance before the next limit.
        if !(deviation[row] > 0.0 && deviation[row] <= 1.01 * limits[row]) {
            return None;
        }
        for column in 0..=row {
            if p[row][column] != p[column][row] {
                return None;
            }
            let correlation = f64::from(p[row][column]) / (deviation[row] * deviation[column]);
            let known: f64 = (0..column).map(|k| factor[row][k] * factor[column][k]).sum();
            if row == column {
                // Rounding may leave a pivot slightly below zero.
                smallest = smallest.min(correlation - known);
                factor[row][row] = (correlation - known).max(1e-3).sqrt();
            } else {
                factor[row][column] = (correlation - known) / factor[column][column];
            }
        }
    }
    Some(smallest)
}

/// Through 100,000 random samples in phases, with times from none to 3 s, rates of samples from 0.1 Hz to 8 kHz,
/// readings at their limits and NaN.
#[test]
fn covariance_stays_a_covariance() {
    let mut random = Random(1);
    for parameters in [(0.05, 0.001), (0.3, 0.13), (50.0, 10.0)] {
        let params = RobustParams { speed_m_s: parameters.0, heading_noise_rad: parameters.1 };
        let mut lowest = f64::INFINITY;
        let mut filter = RobustFilter::new(params, 0.3);
        for phase in 0..1000 {
            let dt_s = random.one_of(&[
                0.000_125,
                0.001,
                0.005,
                0.01,
                0.02,
                0.1,
                1.0,
                3.0,
                10.0,
                0.0,
                -0.1,
                f32::NAN,
            ]);
            let rate = random.one_of(&[0.0, 0.02, 0.5, 6.0, 35.0, 115.0]);
            let push = random.one_of(&[0.0, 0.5, 5.0, 50.0, 550.0]);
            let (rate, push) =
                (random.vector(rate), random.vector(push) + LEVEL * random.one_of(&[1.0, 1.0, 0.0, -1.0]));
            let field = random.one_of(&[0.0, 50.0, 5.0e3]);
            let field = random.vector(field) + FIELD;
            let noise = random.one_of(&[0.0, 1e-3, 0.1, 1.0]);
            for step in 0..34 {
                let odd =
                    random.one_of(&[1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, f32::NAN]);
                let noise = random.vector(noise);
                filter.update(rate + noise * odd, push + noise, Some(field + noise * odd), dt_s);
                if predicting(&filter) {
                    continue;
                }
                let context = || std::format!("{params:?}, phase {phase}, step {step}, {dt_s} s: {filter:?}");
                let pivot = smallest_pivot(&filter).unwrap_or_else(|| panic!("{}", context()));
                lowest = lowest.min(pivot);
                assert!(pivot > -1e-5, "{pivot}: {}", context());
                assert!((filter.q.norm_squared() - 1.0).abs() < 1e-5, "{}", context());
                let [north, east] = filter.velocity;
                assert!(north.is_finite() && east.is_finite(), "{}", context());
            }
        }
        std::println!("smallest pivot {lowest:e} with {params:?}");
    }
}

/// Without a field a bias about the vertical is not observable. Its uncertainty grows by the random walk, after two
/// hours by √7200 · 0.005 °/s = 0.42 °/s, limited to the uncertainty at the start.
#[test]
fn variance_of_an_unobserved_bias_is_bounded() {
    let mut filter = filter();
    filter.detects_rest = false;
    let first = filter.covariance.variance(BIAS + 2);
    for _ in 0..7200 {
        filter.update(Vec3::ZERO, LEVEL, None, 1.0);
        assert!(filter.covariance.variance(BIAS + 2) <= first, "{filter:?}");
    }
    assert!(filter.covariance.variance(BIAS + 2) > 0.99 * first, "{filter:?}");
    assert!(filter.covariance.variance(BIAS) < 0.01 * first, "{filter:?}");
}

#[test]
fn start_upside_down_rolls_by_half_a_turn() {
    for off in [Vec3::ZERO, vec3(1e-5, 0.0, 0.0), vec3(0.0, -1e-5, 0.0), vec3(0.02, 0.01, 0.0)] {
        let mut filter = filter();
        filter.update(Vec3::ZERO, vec3(0.0, 0.0, 9.8) + off, None, 0.0);
        assert!((filter.down() - vec3(0.0, 0.0, -1.0)).norm() < 3e-3, "{filter:?}");
        assert!((filter.attitude().norm_squared() - 1.0).abs() < 1e-6, "{filter:?}");
    }
}

/// The mean force over 2 s changes its sign 2 s · ln 2 = 1.39 s after the vehicle was turned without the gyroscope's
/// notice.
#[test]
fn estimate_upside_down_is_turned_round() {
    let mut filter = filter();
    let bias = vec3(0.02, -0.01, 0.03);
    hold(&mut filter, bias, LEVEL, Some(FIELD), 0.005, 2000);
    let learnt = filter.gyro_bias();
    assert!((learnt - bias).norm() < 1e-3, "{filter:?}");
    // Not quite upside down, so that the turn has one direction.
    let (accel, mag) = (vec3(0.0, 1.0, 9.75), vec3(25.0, 0.0, -41.0));
    hold(&mut filter, bias, accel, Some(mag), 0.005, 240);
    assert!(filter.down().z > 0.5, "too early: {filter:?}");
    hold(&mut filter, bias, accel, Some(mag), 0.005, 80);
    let down = accel * (-1.0 / accel.norm());
    assert!((filter.down() - down).norm() < 0.02, "{filter:?}");
    // What is known of the gyroscope does not depend on the attitude.
    assert!((filter.gyro_bias() - learnt).norm() < 0.01, "{filter:?}");
    assert!(filter.covariance.variance(BIAS) < 0.1 * FIRST_BIAS * FIRST_BIAS, "{filter:?}");
    hold(&mut filter, bias, accel, Some(mag), 0.005, 2000);
    assert!((filter.down() - down).norm() < 2e-3, "{filter:?}");
}

/// The attitude changes by 90° without any rate, as by a lost sample. In motion this teaches a bias; at rest the filter
/// notices that the tilt is wrong, and starts again without it.
#[test]
fn estimate_that_contradicts_rest_starts_again() {
    let mut filter = filter();
    hold(&mut filter, Vec3::ZERO, LEVEL, Some(FIELD), 0.005, 400);
    let (accel, mag) = (vec3(0.0, 9.80665, 0.0), vec3(FIELD.x, -FIELD.z, FIELD.y));
    hold(&mut filter, Vec3::ZERO, accel, Some(mag), 0.005, 1000);
    assert!((filter.down() - vec3(0.0, -1.0, 0.0)).norm() < 1e-3, "{filter:?}");
    assert!(filter.gyro_bias().norm() < 0.1 * DEGREE, "{filter:?}");
}

/// Above 200 rad/s, 1,000 m/s² and 10,000 µT a reading has no effect; below it has.
#[test]
fn readings_beyond_their_limits_are_ignored() {
    let mut filter = filter();
    let north = vec3(20.0, 0.0, 40.0);
    hold(&mut filter, Vec3::ZERO, LEVEL, Some(north), 0.001, 3);
    let state = |filter: &RobustFilter| std::format!("{filter:?}");
    let effect = |gyro: Vec3<f32>, accel: Vec3<f32>, mag: Vec3<f32>| {
        let [mut usual, mut other] = [filter; 2];
        usual.update(Vec3::ZERO, LEVEL, None, 0.001);
        other.update(gyro, accel, Some(mag), 0.001);
        // An invalid sample does not even advance the time.
        (state(&other) != state(&usual), state(&other) != state(&filter))
    };
    for (size, valid) in [(0.99, true), (1.01, false), (f32::NAN, false), (f32::INFINITY, false)] {
        assert_eq!(effect(vec3(0.0, 0.0, 200.0 * size), LEVEL, north), (true, valid));
        assert_eq!(effect(Vec3::ZERO, vec3(0.0, 1.0e3 * size, 0.0), north), (true, valid));
        // Without the field the sample is still valid.
        assert_eq!(effect(Vec3::ZERO, LEVEL, vec3(0.0, 1.0e4 * size, 0.0)), (valid, true));
    }
}

/// Phones deliver the acceleration without gravity. The filter then starts level, and its attitude is the integral of
/// the rates.
#[test]
fn without_gravity_the_gyroscope_is_integrated() {
    let mut filter = filter();
    let rate = vec3(0.3, -0.5, 0.8);
    hold(&mut filter, rate, Vec3::ZERO, None, 0.005, 199);
    assert!(!filter.started());
    hold(&mut filter, rate, Vec3::ZERO, None, 0.005, 2);
    assert!(filter.started());
    // The start may fall on either of two samples.
    let first = filter.attitude().to_matrix().rows.map(double);
    let start = Mat3 { rows: first };
    hold(&mut filter, rate, Vec3::ZERO, None, 0.005, 4000);
    let turned =
        start * super::super::tests::properties::rotation(double(rate) * (4000.0 * f64::from(0.005_f32)));
    for (ours, exact) in filter.attitude().to_matrix().rows.map(double).into_iter().zip(turned.rows) {
        assert!((ours - exact).norm() < 1e-4, "{ours:?} {exact:?}");
    }
    assert!(filter.gyro_bias() == Vec3::ZERO && filter.scale == Vec3::ZERO, "{filter:?}");
}

/// The caller's zero replaces what the filter knew of the bias, and its detection of rest.
#[test]
fn zeroed_gyroscope_has_a_small_bias_and_no_rest() {
    let mut filter = filter();
    let bias = vec3(0.02, -0.01, 0.03);
    hold(&mut filter, bias, LEVEL, None, 0.005, 1000);
    assert!((filter.gyro_bias() - bias).norm() < 1e-3 && filter.rest.at_rest(), "{filter:?}");
    filter.on_gyro_zeroed();
    assert!(filter.gyro_bias() == Vec3::ZERO && !filter.rest.at_rest(), "{filter:?}");
    let matrix = filter.covariance.matrix();
    for state in BIAS..SCALE {
        // √(0.17 °/s/√Hz · 0.005 °/s/√s) = 0.029 °/s.
        let deviation = f64::from(matrix[state][state]).sqrt() / RAD;
        assert!((deviation - 0.0292).abs() < 1e-4, "{deviation}");
        let others = (0..STATES).filter(|&other| other != state);
        assert!(others.clone().all(|other| matrix[state][other] == 0.0 && matrix[other][state] == 0.0));
    }
    // A steady rate about the vertical is now a turn and not a bias.
    hold(&mut filter, vec3(0.0, 0.0, 0.03), LEVEL, None, 0.005, 2000);
    assert!(!filter.rest.at_rest() && filter.gyro_bias().norm() < 1e-3, "{filter:?}");
}

/// A turn of 3 °/s about the vertical is as steady as rest. It is not taken for a bias, because the bias is known.
#[test]
fn slow_steady_turn_about_the_vertical_is_no_bias() {
    let mut filter = filter();
    hold(&mut filter, Vec3::ZERO, LEVEL, None, 0.005, 4000);
    hold(&mut filter, vec3(0.0, 0.0, 3.0 * DEGREE), LEVEL, None, 0.005, 4000);
    assert!(filter.rest.at_rest() && filter.gyro_bias().norm() < 0.01 * DEGREE, "{filter:?}");
    assert!((filter.heading() - 60.0 * DEGREE).abs() < 0.1 * DEGREE, "{filter:?}");
}

#[test]
fn first_field_sets_the_heading() {
    for (declination, north, east) in
        [(0.0, 20.0, 0.0), (0.3, 10.0, 17.0), (-0.2, -20.0, 3.0), (3.0, -5.0, -20.0)]
    {
        let mut filter = RobustFilter::new(PARAMS, declination);
        // Fields without a horizontal part set nothing.
        hold(&mut filter, Vec3::ZERO, LEVEL, Some(vec3(0.5, 0.5, 40.0)), 0.001, 10);
        assert_eq!((filter.heading_set, filter.heading()), (false, 0.0));
        filter.update(Vec3::ZERO, LEVEL, Some(vec3(north, east, 40.0)), 0.001);
        // The body turns to the left of its field by the angle of the field.
        let heading = wrap_pi(declination - east.atan2(north));
        assert!(filter.heading_set && wrap_pi(filter.heading() - heading).abs() < 1e-5, "{filter:?}");
        assert_eq!(filter.covariance.variance(ATTITUDE + 2), FIELD_HEADING * FIELD_HEADING);
        // The next one only corrects it.
        filter.update(Vec3::ZERO, LEVEL, Some(vec3(east, north, 40.0)), 0.02);
        assert!(wrap_pi(filter.heading() - heading).abs() < 0.1, "{filter:?}");
    }
}

/// NaN in each input for 2 s changes no other state than time, and the filter goes on.
#[test]
fn recovers_from_readings_that_are_no_numbers() {
    let mut before = filter();
    let bias = vec3(0.02, -0.01, 0.03);
    hold(&mut before, bias, LEVEL, Some(FIELD), 0.005, 2000);
    let odd = vec3(0.1, f32::NAN, 0.1);
    for (gyro, accel, mag, dt_s) in [
        (odd, LEVEL, FIELD, 0.005),
        (bias, odd, FIELD, 0.005),
        (bias, LEVEL, odd, 0.005),
        (bias, LEVEL, FIELD, f32::NAN),
        (odd, odd, odd, f32::NAN),
    ] {
        let mut filter = before;
        hold(&mut filter, gyro, accel, Some(mag), dt_s, 400);
        assert!(filter.down().z > 0.999_99 && filter.heading().abs() < 1e-2, "{filter:?}");
        assert!((filter.gyro_bias() - bias).norm() < 1e-3, "{filter:?}");
        // During the failure the vehicle has turned by 10° about x.
        let (sin, cos) = 0.174_533_f32.sin_cos();
        let (accel, mag) = (vec3(0.0, sin, cos) * -9.80665, vec3(25.0, 41.0 * sin, 41.0 * cos));
        hold(&mut filter, bias, accel, Some(mag), 0.005, 12_000);
        assert!((filter.down() - vec3(0.0, sin, cos)).norm() < 0.01, "{filter:?}");
        assert!(filter.heading().abs() < 0.02, "{filter:?}");
    }
}
