//! The filter against a second implementation: in f64, on a rotation matrix instead of a quaternion, corrected in the
//! world instead of the body, with the inverse of the variances. Also its parts at the ends of their ranges.

use super::super::tests::properties::rotation;
use super::*;
use crate::geometry::Mat3;
use proptest::num::f32::ANY;
use proptest::prelude::*;
use std::boxed::Box;

type V = Vec3<f64>;

fn double(v: Vec3<f32>) -> V {
    <[f32; 3]>::from(v).map(f64::from).into()
}

fn each(v: V, f: impl Fn(f64) -> f64) -> V {
    <[f64; 3]>::from(v).map(f).into()
}

fn both(a: V, b: V, f: impl Fn(f64, f64) -> f64) -> V {
    vec3(f(a.x, b.x), f(a.y, b.y), f(a.z, b.z))
}

/// Updates a first-order low-pass.
fn follow(mean: &mut V, now: V, share: f64) {
    *mean = *mean * (1.0 - share) + now * share;
}

struct InDouble {
    tilt_tau: f64,
    heading_tau: f64,
    declination: f64,
    detects_rest: bool,
    /// Body to world; `None` before the start.
    attitude: Option<Mat3<f64>>,
    age: f64,
    tilt_error: [f64; 2],
    mean_horizontal: [V; 2],
    mean_down: V,
    bias: V,
    variance: V,
    fast: [V; 2],
    slow: [V; 2],
    rest_s: f64,
    mag_dt: f64,
    /// Means of the horizontal and vertical part of the field, and their age.
    field_means: (f64, f64, f64),
    heading_age: f64,
    deviating: f64,
    offset: V,
    /// Whether a comparison was so close that rounding may change its result.
    ambiguous: bool,
}

const G64: f64 = 9.80665;
const RAD: f64 = core::f64::consts::PI / 180.0;

impl InDouble {
    fn new(params: RobustParams, declination: f32) -> Self {
        let zero = V::ZERO;
        Self {
            tilt_tau: params.tilt_tau_s.into(),
            heading_tau: params.heading_tau_s.into(),
            declination: declination.into(),
            detects_rest: true,
            attitude: None,
            age: 0.0,
            tilt_error: [0.0; 2],
            mean_horizontal: [zero; 2],
            mean_down: zero,
            bias: zero,
            variance: each(zero, |_| (3.0 * RAD).powi(2)),
            fast: [zero; 2],
            slow: [zero; 2],
            rest_s: 0.0,
            mag_dt: 0.0,
            field_means: (0.0, 0.0, 0.0),
            heading_age: 0.0,
            deviating: 0.0,
            offset: zero,
            ambiguous: false,
        }
    }

    /// Returns whether a < b, and marks a close comparison as ambiguous.
    fn below(&mut self, a: f64, b: f64) -> bool {
        self.ambiguous |= (a - b).abs() < 1e-3 * b.abs() + 1e-7;
        a < b
    }

    /// Returns whether a limit of time is reached, with the rounding of accumulated times.
    fn reached(&mut self, time: f64, limit: f64) -> bool {
        self.ambiguous |= (time - limit).abs() < 1e-5 * limit && time != limit;
        time >= limit
    }

    fn update(&mut self, gyro: V, accel: V, mag: Option<V>, dt: f64) {
        if !(gyro.norm() < 200.0 && accel.norm() < 1000.0) {
            return;
        }
        let dt = if dt > 0.0 { dt.min(1.0) } else { 0.0 };
        match self.attitude {
            None => {
                if !self.below(accel.norm(), 0.1 * G64) {
                    // The shortest rotation from the measured direction of down to the vertical.
                    let down = accel * (-1.0 / accel.norm());
                    let axis = down.cross(Vec3::Z);
                    self.ambiguous |= axis.norm() < 1e-2;
                    let angle = axis.norm().atan2(down.z);
                    self.attitude = Some(rotation(axis * (angle / axis.norm())));
                    (self.fast, self.slow) = ([gyro, accel], [gyro, accel]);
                }
            }
            Some(attitude) if dt > 0.0 => self.update_tilt(attitude, gyro, accel, dt),
            Some(_) => {}
        }
        self.mag_dt = (self.mag_dt + dt).min(1.0);
        if let Some(field) = mag.filter(|field| field.norm() < 1e4) {
            self.correct_heading(gyro, field);
        }
    }

    fn update_tilt(&mut self, before: Mat3<f64>, gyro: V, accel: V, dt: f64) {
        let rates = gyro - self.bias;
        let attitude = before * rotation(rates * dt);
        let force = (attitude * accel) * (1.0 / G64);
        // A force that points down by more than half a g counts as 1 g horizontal; free fall counts as zero.
        let side = force.x.hypot(force.y);
        let upside_down = !self.below(force.z, 0.5) && force.z != 0.5;
        let tilt_error_now = if upside_down {
            if self.below(side, 0.05) { [1.0, 0.0] } else { [force.x / side, force.y / side] }
        } else if self.below(force.norm(), 0.1) {
            [0.0, 0.0]
        } else {
            [force.x, force.y]
        };

        let settled = self.reached(self.age, self.tilt_tau);
        let tau = if settled {
            self.tilt_tau
        } else {
            self.age += dt;
            self.tilt_tau.min(self.age.powi(2) / self.tilt_tau + 2.0 * dt)
        };
        let share = 2.0 * dt / (tau + 2.0 * dt);
        let [x, y, z] = attitude.rows;
        for (tilt_error, now) in self.tilt_error.iter_mut().zip(tilt_error_now) {
            *tilt_error = *tilt_error * (1.0 - share) + now * share;
        }
        follow(&mut self.mean_horizontal[0], x, share);
        follow(&mut self.mean_horizontal[1], y, share);
        follow(&mut self.mean_down, z, dt / (self.heading_tau + dt));
        let [north, east] = self.tilt_error.map(|tilt_error| tilt_error * dt / tau);
        // In world axes a tilt error to the north is corrected by a rotation about east, and so on.
        self.attitude = Some(rotation(vec3(-east, north, 0.0)) * attitude);

        self.variance = each(self.variance, |p| p + (0.02 * RAD).powi(2) * dt);
        if self.detects_rest && self.is_at_rest(gyro, accel, dt) {
            let change = self.slow[0] - self.bias;
            let known = (1.0 * RAD).powi(2) + 9.0 * (self.variance.x + self.variance.y + self.variance.z);
            if self.below(known, change.dot(change)) {
                return;
            }
            // 1/P increases by the information of `dt` of rest, and the estimate moves by the same share.
            let information = dt / (0.1 * RAD).powi(2);
            let reduced = each(self.variance, |p| 1.0 / (1.0 / p + information));
            let gain = both(reduced, self.variance, |new, old| 1.0 - new / old);
            self.set_bias(self.bias + both(gain, rates, |gain, rate| gain * rate));
            self.variance = reduced;
        } else {
            let tilt_error = self.tilt_error[0].hypot(self.tilt_error[1]);
            if settled && self.below(tilt_error, 0.3) {
                let correction = self.mean_horizontal[1] * north - self.mean_horizontal[0] * east;
                let observed = both(self.mean_horizontal[0], self.mean_horizontal[1], |x, y| x * x + y * y);
                self.learn(correction, observed, dt);
            }
        }
    }

    fn is_at_rest(&mut self, gyro: V, accel: V, dt: f64) -> bool {
        let [fast, slow] = [0.02, 0.5].map(|tau| dt / (tau + dt));
        let mut off = [0.0; 2];
        for (sensor, now) in [gyro, accel].into_iter().enumerate() {
            follow(&mut self.fast[sensor], now, fast);
            let from = self.fast[sensor] - self.slow[sensor];
            off[sensor] = from.norm();
            self.slow[sensor] += from * slow;
        }
        let steady = self.below(off[0], 2.0 * RAD) & self.below(off[1], 0.2);
        let slow_turn = self.slow[0].norm();
        let still = steady & self.below(slow_turn, 0.35);
        self.rest_s = if still { (self.rest_s + dt).min(1.5) } else { 0.0 };
        self.reached(self.rest_s, 1.5)
    }

    fn learn(&mut self, correction: V, observed: V, dt: f64) {
        let information = 1.0 / (0.5 * RAD).powi(2);
        let max_gain = 0.35 / self.tilt_tau;
        let moved =
            both(self.variance, correction, |p, correction| (p * information).min(max_gain) * correction);
        self.set_bias(self.bias - moved);
        self.variance = both(self.variance, observed, |p, observed| {
            (1.0 / (1.0 / p + observed * information * dt)).min((3.0 * RAD).powi(2))
        });
    }

    fn set_bias(&mut self, bias: V) {
        self.bias = each(bias, |b| b.clamp(-0.35, 0.35));
    }

    fn correct_heading(&mut self, gyro: V, mag: V) {
        // Before the start the attitude is level and points north.
        let attitude = self.attitude.unwrap_or(Mat3::IDENTITY);
        let field = attitude * (mag - self.offset);
        let dt = core::mem::take(&mut self.mag_dt);
        let level = field.x.hypot(field.y);
        if self.below(level, 1.0) {
            return;
        }
        let tilt_settled = self.reached(self.age, self.tilt_tau);
        let Some((level_deviation, vertical_deviation)) = self.deviation(level, field.z, tilt_settled, dt)
        else {
            return;
        };
        let direction = field.y.atan2(field.x) - self.declination;
        let turns = direction / (2.0 * core::f64::consts::PI);
        self.ambiguous |= (turns.fract().abs() - 0.5).abs() < 1e-3;
        let heading_error = 2.0 * core::f64::consts::PI * (turns - turns.round());
        let settled = self.reached(self.heading_age, self.heading_tau);
        let share = if self.heading_age > 0.0 { dt / (self.heading_age + dt) } else { 1.0 };
        if !settled {
            self.heading_age = (self.heading_age + dt).max(1e-3);
        }
        let turned = rotation(vec3(0.0, 0.0, -share * heading_error)) * attitude;
        if self.attitude.is_some() {
            self.attitude = Some(turned);
        } else {
            // A field before the first specific force: the second filter does not model its effect on the start.
            self.ambiguous = true;
        }
        if !settled {
            return;
        }
        let at_rest = self.reached(self.rest_s, 1.5);
        if !at_rest {
            let down = self.mean_down;
            self.learn(down * (-share * heading_error), both(down, down, |a, b| a * b), dt);
        }
        let turning = (gyro - self.bias).norm();
        if !self.below(turning, 0.4) {
            // The difference to the mean horizontal field, which points to magnetic north.
            let usual = level - level_deviation;
            let (sin, cos) = self.declination.sin_cos();
            let residual = vec3(field.x - usual * cos, field.y - usual * sin, vertical_deviation);
            let learnt = self.offset + turned.transpose() * residual * (dt / 20.0);
            self.offset = each(learnt, |o| o.clamp(-10.0, 10.0));
        }
    }

    fn deviation(&mut self, level: f64, vertical: f64, tilt_settled: bool, dt: f64) -> Option<(f64, f64)> {
        let (mean_level, mean_vertical, over) = self.field_means;
        let off = (level - mean_level).hypot(vertical - mean_vertical);
        let usual = 0.1 * mean_level.hypot(mean_vertical);
        let mut over = over;
        if tilt_settled && over > 0.0 && !self.below(off, usual) {
            self.deviating += dt;
            if !self.reached(self.deviating, 60.0) {
                return None;
            }
            over = 0.0;
        }
        self.deviating = 0.0;
        let (mean_level, mean_vertical) =
            if over == 0.0 { (level, vertical) } else { (mean_level, mean_vertical) };
        let over = (over + dt).clamp(1e-3, 20.0);
        let share = (dt / over).min(1.0);
        let off = (level - mean_level, vertical - mean_vertical);
        self.field_means = (mean_level + share * off.0, mean_vertical + share * off.1, over);
        Some(off)
    }

    fn on_gyro_zeroed(&mut self) {
        self.bias = V::ZERO;
        self.variance = each(V::ZERO, |_| 0.1 * RAD * (0.02 * RAD));
        self.detects_rest = false;
        self.rest_s = 0.0;
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
    let level = Just(vec3(0.0, 0.0, -9.8_f32));
    let near_level = about(3.0).prop_map(|off| off + vec3(0.0, 0.0, -9.8));
    let gyro =
        prop_oneof![3 => about(0.03), 2 => about(1.0), 1 => about(6.0), 1 => Just(vec3(250.0, 0.0, 0.0))];
    let accel = prop_oneof![3 => level, 4 => near_level, 1 => about(15.0), 1 => about(0.3), 1 => Just(vec3(0.0, 0.0, 2.0e3))];
    let field = about(8.0).prop_map(|off| off + vec3(20.0, 10.0, 30.0));
    let field = prop_oneof![4 => field, 1 => about(50.0), 1 => Just(vec3(0.0, 2.0e4, 0.0))];
    let mag = prop::option::weighted(0.85, field);
    let noise = (
        prop_oneof![Just(0.0_f32), Just(0.002), Just(0.3)],
        prop_oneof![Just(0.0_f32), Just(0.05), Just(2.0)],
    );
    let dt_s = prop_oneof![
        Just(0.0053_f32),
        Just(0.0207),
        0.001..0.1_f32,
        Just(0.47),
        Just(0.0),
        Just(-0.5),
        Just(3.0)
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

/// Returns the differences between the two filters, each with its bound.
fn differences(ours: &RobustFilter, second: &InDouble) -> [(&'static str, f64, f64); 7] {
    let matrix = ours.q.to_matrix().rows.map(double);
    let theirs = second.attitude.unwrap_or(Mat3::IDENTITY).rows;
    let attitude = matrix.iter().zip(theirs).map(|(a, b)| (*a - b).norm()).fold(0.0, f64::max);
    let relative = both(double(ours.variance), second.variance, |a, b| (a / b - 1.0).abs());
    let tilt_error = [0, 1].map(|axis| (f64::from(ours.tilt_error[axis]) - second.tilt_error[axis]).abs());
    let field_means = (f64::from(ours.magnetic.level) - second.field_means.0).abs()
        + (f64::from(ours.magnetic.vertical) - second.field_means.1).abs();
    [
        ("attitude", attitude, 1e-3),
        ("tilt error", tilt_error[0] + tilt_error[1], 1e-3),
        ("bias", (double(ours.bias) - second.bias).norm(), 1e-4),
        ("variance", relative.x.max(relative.y).max(relative.z), 3e-3),
        ("offset", (double(ours.magnetic.offset) - second.offset).norm(), 3e-3),
        ("field means", field_means, 2e-2),
        ("deviating", (f64::from(ours.magnetic.deviating_s) - second.deviating).abs(), 1e-3),
    ]
}

proptest! {
    #[test]
    fn filter_equals_a_second_one_in_f64(
        tilt_tau_s in prop_oneof![2 => 0.1..1.0_f32, 1 => 0.1..100.0_f32],
        heading_tau_s in prop_oneof![2 => 0.1..1.0_f32, 1 => 0.1..1000.0_f32],
        declination in -3.0..3.0_f32,
        start in about(6.0),
        phases in prop::collection::vec(phase(), 1..6),
        zeroed_before in 0..12_usize,
    ) {
        let params = RobustParams { tilt_tau_s, heading_tau_s };
        let mut ours = RobustFilter::new(params, declination);
        let mut second = Box::new(InDouble::new(params, declination));
        let start = start + vec3(0.0, 0.0, -9.8);
        ours.update(Vec3::ZERO, start, None, 0.0);
        second.update(V::ZERO, double(start), None, 0.0);
        for (index, phase) in phases.iter().enumerate() {
            // With a step longer than τ the correction overshoots, and rounding errors grow from step to step.
            let dt_s = phase.dt_s.min(if tilt_tau_s < 2.0 { 0.5 * tilt_tau_s } else { 10.0 });
            if index == zeroed_before {
                ours.on_gyro_zeroed();
                second.on_gyro_zeroed();
            }
            for step in 0..phase.steps {
                let sign = if step % 2 == 0 { 1.0 } else { -1.0 };
                let mut noise = [0.0; 3];
                noise[step % 3] = sign;
                let noise = Vec3::from(noise);
                let (gyro, accel) = (phase.gyro + noise * phase.noise.0, phase.accel + noise * phase.noise.1);
                ours.update(gyro, accel, phase.mag, dt_s);
                second.update(double(gyro), double(accel), phase.mag.map(double), dt_s.into());
                if second.ambiguous {
                    return Ok(());
                }
                for (what, off, bound) in differences(&ours, &second) {
                    prop_assert!(off <= bound, "{} differs by {} in step {} of {:?}", what, off, step, phase);
                }
                prop_assert_eq!(ours.started(), second.attitude.is_some());
            }
        }
    }

    /// After a restart a filter is equal to a new one, after any samples.
    #[test]
    fn restart_equals_a_new_filter(phases in prop::collection::vec(phase(), 1..3), odd in [ANY, ANY, ANY]) {
        let params = RobustParams { tilt_tau_s: 0.5, heading_tau_s: 0.7 };
        let [mut used, mut fresh] = [RobustFilter::new(params, 0.3); 2];
        for Phase { gyro, accel, mag, dt_s, .. } in &phases {
            for _ in 0..50 {
                used.update(*gyro, *accel, *mag, *dt_s);
            }
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

#[test]
fn start_upside_down_rolls_by_half_a_turn() {
    for off in [Vec3::ZERO, vec3(1e-5, 0.0, 0.0), vec3(0.0, -1e-5, 0.0), vec3(0.02, 0.01, 0.0)] {
        let mut filter = RobustFilter::new(RobustParams { tilt_tau_s: 5.0, heading_tau_s: 9.0 }, 0.0);
        filter.update(Vec3::ZERO, vec3(0.0, 0.0, 9.8) + off, None, 0.0);
        assert!((filter.down() - vec3(0.0, 0.0, -1.0)).norm() < 3e-3, "{filter:?}");
        assert!((filter.attitude().norm_squared() - 1.0).abs() < 1e-6, "{filter:?}");
    }
}

#[test]
fn downward_force_counts_as_1_g_horizontal() {
    assert_eq!(horizontal_force(vec3(0.0, 0.0, 1.0)), [1.0, 0.0]);
    assert_eq!(horizontal_force(vec3(0.0, 0.6, 0.8)), [0.0, 1.0]);
    assert_eq!(horizontal_force(vec3(0.3, -0.4, 0.6)), [0.6, -0.8]);
    // Up to half a g down, and with the right side up, the force is unchanged; free fall gives zero.
    assert_eq!(horizontal_force(vec3(0.3, -0.4, 0.4)), [0.3, -0.4]);
    assert_eq!(horizontal_force(vec3(0.3, -0.4, -0.9)), [0.3, -0.4]);
    assert_eq!(horizontal_force(vec3(0.05, 0.05, -0.05)), [0.0, 0.0]);
    assert_eq!(horizontal_force(vec3(0.0, 0.11, 0.0)), [0.0, 0.11]);
}

/// Above 200 rad/s, 1,000 m/s² and 10,000 µT a reading has no effect; below it has.
#[test]
fn readings_beyond_their_limits_are_ignored() {
    let mut filter = RobustFilter::new(RobustParams { tilt_tau_s: 5.0, heading_tau_s: 9.0 }, 0.0);
    let (level, north) = (vec3(0.0, 0.0, -9.8), vec3(20.0, 0.0, 40.0));
    for _ in 0..3 {
        filter.update(Vec3::ZERO, level, Some(north), 0.001);
    }
    let effect = |gyro: Vec3<f32>, accel: Vec3<f32>, mag: Vec3<f32>| {
        let mut usual = filter;
        usual.update(Vec3::ZERO, level, None, 0.001);
        let mut other = filter;
        other.update(gyro, accel, Some(mag), 0.001);
        // An invalid sample does not even advance the time.
        (other.attitude() != usual.attitude(), std::format!("{other:?}") != std::format!("{filter:?}"))
    };
    for (size, valid) in [(0.99, true), (1.01, false)] {
        let zero = Vec3::ZERO;
        assert_eq!(effect(vec3(0.0, 0.0, 200.0 * size), level, zero), (valid, valid));
        assert_eq!(effect(zero, vec3(0.0, 1.0e3 * size, 0.0), zero), (valid, valid));
        // Without the field the sample is still valid.
        assert_eq!(effect(zero, level, vec3(0.0, 1.0e4 * size, 0.0)), (valid, true));
    }
}

/// Without a field a bias about the vertical is not observable. Its uncertainty grows by the random walk, after an
/// hour by √3600 · 0.02 °/s = 1.2 °/s, limited to the uncertainty at the start.
#[test]
fn variance_of_an_unobserved_bias_is_bounded() {
    let mut filter = RobustFilter::new(RobustParams { tilt_tau_s: 5.0, heading_tau_s: 9.0 }, 0.0);
    filter.detects_rest = false;
    let first = filter.variance.z;
    for step in 0..3600 {
        filter.update(Vec3::ZERO, vec3(0.0, 0.0, -9.8), None, 1.0);
        // During the start, which lasts for τ, the filter does not learn the bias.
        assert!(step < 6 || filter.variance.z <= first, "{filter:?}");
    }
    assert!(filter.variance.z > 0.99 * first && filter.variance.x < 0.01 * first, "{filter:?}");
}
