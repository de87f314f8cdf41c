//! The whole filter against a second one: in f64, on a rotation matrix instead of a quaternion, turned in the world
//! instead of the body, with the variances as information. And its parts at the ends of their ranges.

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

/// A first-order low-pass.
fn follow(mean: &mut V, now: V, share: f64) {
    *mean = *mean * (1.0 - share) + now * share;
}

struct InDouble {
    tilt_tau: f64,
    heading_tau: f64,
    declination: f64,
    looks_for_rest: bool,
    /// Body to world, once it has started.
    attitude: Option<Mat3<f64>>,
    age: f64,
    lean: [f64; 2],
    seen: [V; 2],
    seen_down: V,
    bias: V,
    variance: V,
    fast: [V; 2],
    slow: [V; 2],
    still: f64,
    since: f64,
    /// Level and vertical, and over how long they are.
    place: (f64, f64, f64),
    heading_age: f64,
    strange: f64,
    offset: V,
    /// A comparison that rounding may decide the other way.
    doubtful: bool,
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
            looks_for_rest: true,
            attitude: None,
            age: 0.0,
            lean: [0.0; 2],
            seen: [zero; 2],
            seen_down: zero,
            bias: zero,
            variance: each(zero, |_| (3.0 * RAD).powi(2)),
            fast: [zero; 2],
            slow: [zero; 2],
            still: 0.0,
            since: 0.0,
            place: (0.0, 0.0, 0.0),
            heading_age: 0.0,
            strange: 0.0,
            offset: zero,
            doubtful: false,
        }
    }

    /// Whether a < b.
    fn below(&mut self, a: f64, b: f64) -> bool {
        self.doubtful |= (a - b).abs() < 1e-3 * b.abs() + 1e-7;
        a < b
    }

    /// Whether a time has come: times add up with rounding of their own.
    fn lasted(&mut self, time: f64, limit: f64) -> bool {
        self.doubtful |= (time - limit).abs() < 1e-5 * limit && time != limit;
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
                    // The shortest way from the measured down to the vertical.
                    let down = accel * (-1.0 / accel.norm());
                    let axis = down.cross(Vec3::Z);
                    self.doubtful |= axis.norm() < 1e-2;
                    let angle = axis.norm().atan2(down.z);
                    self.attitude = Some(rotation(axis * (angle / axis.norm())));
                    (self.fast, self.slow) = ([gyro, accel], [gyro, accel]);
                }
            }
            Some(attitude) if dt > 0.0 => self.turn(attitude, gyro, accel, dt),
            Some(_) => {}
        }
        self.since = (self.since + dt).min(1.0);
        if let Some(field) = mag.filter(|field| field.norm() < 1e4) {
            self.correct_heading(gyro, field);
        }
    }

    fn turn(&mut self, before: Mat3<f64>, gyro: V, accel: V, dt: f64) {
        let rates = gyro - self.bias;
        let attitude = before * rotation(rates * dt);
        let force = (attitude * accel) * (1.0 / G64);
        // Upside down by more than half a g, a whole g to the side; in free fall nothing.
        let side = force.x.hypot(force.y);
        let upside_down = !self.below(force.z, 0.5) && force.z != 0.5;
        let lean_now = if upside_down {
            if self.below(side, 0.05) { [1.0, 0.0] } else { [force.x / side, force.y / side] }
        } else if self.below(force.norm(), 0.1) {
            [0.0, 0.0]
        } else {
            [force.x, force.y]
        };

        let settled = self.lasted(self.age, self.tilt_tau);
        let tau = if settled {
            self.tilt_tau
        } else {
            self.age += dt;
            self.tilt_tau.min(self.age.powi(2) / self.tilt_tau + 2.0 * dt)
        };
        let share = 2.0 * dt / (tau + 2.0 * dt);
        let [x, y, z] = attitude.rows;
        for (lean, now) in self.lean.iter_mut().zip(lean_now) {
            *lean = *lean * (1.0 - share) + now * share;
        }
        follow(&mut self.seen[0], x, share);
        follow(&mut self.seen[1], y, share);
        follow(&mut self.seen_down, z, dt / (self.heading_tau + dt));
        let [north, east] = self.lean.map(|lean| lean * dt / tau);
        // In the world: a lean to the north is taken away by a turn about east, and so on.
        self.attitude = Some(rotation(vec3(-east, north, 0.0)) * attitude);

        self.variance = each(self.variance, |p| p + (0.02 * RAD).powi(2) * dt);
        if self.looks_for_rest && self.rests(gyro, accel, dt) {
            let change = self.slow[0] - self.bias;
            let known = (1.0 * RAD).powi(2) + 9.0 * (self.variance.x + self.variance.y + self.variance.z);
            if self.below(known, change.dot(change)) {
                return;
            }
            // 1/P grows by what dt of rest tells, and the estimate moves by that share.
            let information = dt / (0.1 * RAD).powi(2);
            let narrowed = each(self.variance, |p| 1.0 / (1.0 / p + information));
            let gain = both(narrowed, self.variance, |new, old| 1.0 - new / old);
            self.take_bias(self.bias + both(gain, rates, |gain, rate| gain * rate));
            self.variance = narrowed;
        } else {
            let lean = self.lean[0].hypot(self.lean[1]);
            if settled && self.below(lean, 0.3) {
                let back = self.seen[1] * north - self.seen[0] * east;
                let seen = both(self.seen[0], self.seen[1], |x, y| x * x + y * y);
                self.learn(back, seen, dt);
            }
        }
    }

    fn rests(&mut self, gyro: V, accel: V, dt: f64) -> bool {
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
        self.still = if still { (self.still + dt).min(1.5) } else { 0.0 };
        self.lasted(self.still, 1.5)
    }

    fn learn(&mut self, back: V, seen: V, dt: f64) {
        let information = 1.0 / (0.5 * RAD).powi(2);
        let most = 0.35 / self.tilt_tau;
        let moved = both(self.variance, back, |p, back| (p * information).min(most) * back);
        self.take_bias(self.bias - moved);
        self.variance = both(self.variance, seen, |p, seen| {
            (1.0 / (1.0 / p + seen * information * dt)).min((3.0 * RAD).powi(2))
        });
    }

    fn take_bias(&mut self, bias: V) {
        self.bias = each(bias, |b| b.clamp(-0.35, 0.35));
    }

    fn correct_heading(&mut self, gyro: V, mag: V) {
        // Before the start the attitude is level, and north is ahead.
        let attitude = self.attitude.unwrap_or(Mat3::IDENTITY);
        let field = attitude * (mag - self.offset);
        let dt = core::mem::take(&mut self.since);
        let level = field.x.hypot(field.y);
        if self.below(level, 1.0) {
            return;
        }
        let tilt_settled = self.lasted(self.age, self.tilt_tau);
        let Some((level_excess, vertical_excess)) = self.excess(level, field.z, tilt_settled, dt) else {
            return;
        };
        let direction = field.y.atan2(field.x) - self.declination;
        let turns = direction / (2.0 * core::f64::consts::PI);
        self.doubtful |= (turns.fract().abs() - 0.5).abs() < 1e-3;
        let excess = 2.0 * core::f64::consts::PI * (turns - turns.round());
        let settled = self.lasted(self.heading_age, self.heading_tau);
        let share = if self.heading_age > 0.0 { dt / (self.heading_age + dt) } else { 1.0 };
        if !settled {
            self.heading_age = (self.heading_age + dt).max(1e-3);
        }
        let turned = rotation(vec3(0.0, 0.0, -share * excess)) * attitude;
        if self.attitude.is_some() {
            self.attitude = Some(turned);
        } else {
            // A field before the first specific force: what a start makes of it is not the twin's to say.
            self.doubtful = true;
        }
        if !settled {
            return;
        }
        let lasting = self.lasted(self.still, 1.5);
        if !lasting {
            let down = self.seen_down;
            self.learn(down * (-share * excess), both(down, down, |a, b| a * b), dt);
        }
        let turning = (gyro - self.bias).norm();
        if !self.below(turning, 0.4) {
            // What is more than the place's level field, which points to magnetic north.
            let usual = level - level_excess;
            let (sin, cos) = self.declination.sin_cos();
            let strange = vec3(field.x - usual * cos, field.y - usual * sin, vertical_excess);
            let learnt = self.offset + turned.transpose() * strange * (dt / 20.0);
            self.offset = each(learnt, |o| o.clamp(-10.0, 10.0));
        }
    }

    fn excess(&mut self, level: f64, vertical: f64, tilt_settled: bool, dt: f64) -> Option<(f64, f64)> {
        let (mean_level, mean_vertical, over) = self.place;
        let off = (level - mean_level).hypot(vertical - mean_vertical);
        let usual = 0.1 * mean_level.hypot(mean_vertical);
        let mut over = over;
        if tilt_settled && over > 0.0 && !self.below(off, usual) {
            self.strange += dt;
            if !self.lasted(self.strange, 60.0) {
                return None;
            }
            over = 0.0;
        }
        self.strange = 0.0;
        let (mean_level, mean_vertical) =
            if over == 0.0 { (level, vertical) } else { (mean_level, mean_vertical) };
        let over = (over + dt).clamp(1e-3, 20.0);
        let share = (dt / over).min(1.0);
        let off = (level - mean_level, vertical - mean_vertical);
        self.place = (mean_level + share * off.0, mean_vertical + share * off.1, over);
        Some(off)
    }

    fn gyro_zeroed(&mut self) {
        self.bias = V::ZERO;
        self.variance = each(V::ZERO, |_| 0.1 * RAD * (0.02 * RAD));
        self.looks_for_rest = false;
        self.still = 0.0;
    }
}

/// Some time in which the readings are about the same.
#[derive(Clone, Debug)]
struct Phase {
    gyro: Vec3<f32>,
    accel: Vec3<f32>,
    mag: Option<Vec3<f32>>,
    /// Rate and force of what is added in every step, each to another axis.
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

/// What is apart between the two, in the unit of each bound.
fn apart(ours: &RobustFilter, twin: &InDouble) -> [(&'static str, f64, f64); 7] {
    let matrix = ours.q.to_matrix().rows.map(double);
    let theirs = twin.attitude.unwrap_or(Mat3::IDENTITY).rows;
    let attitude = matrix.iter().zip(theirs).map(|(a, b)| (*a - b).norm()).fold(0.0, f64::max);
    let relative = both(double(ours.variance), twin.variance, |a, b| (a / b - 1.0).abs());
    let lean = [0, 1].map(|axis| (f64::from(ours.lean[axis]) - twin.lean[axis]).abs());
    let place = (f64::from(ours.north.level) - twin.place.0).abs()
        + (f64::from(ours.north.vertical) - twin.place.1).abs();
    [
        ("attitude", attitude, 1e-3),
        ("lean", lean[0] + lean[1], 1e-3),
        ("bias", (double(ours.bias) - twin.bias).norm(), 1e-4),
        ("variance", relative.x.max(relative.y).max(relative.z), 3e-3),
        ("offset", (double(ours.north.offset) - twin.offset).norm(), 3e-3),
        ("place", place, 2e-2),
        ("strange", (f64::from(ours.north.strange_s) - twin.strange).abs(), 1e-3),
    ]
}

proptest! {
    #[test]
    fn it_is_a_second_filter_in_f64_over_any_motion(
        tilt_tau_s in prop_oneof![2 => 0.1..1.0_f32, 1 => 0.1..100.0_f32],
        heading_tau_s in prop_oneof![2 => 0.1..1.0_f32, 1 => 0.1..1000.0_f32],
        declination in -3.0..3.0_f32,
        start in about(6.0),
        phases in prop::collection::vec(phase(), 1..6),
        zeroed_before in 0..12_usize,
    ) {
        let params = RobustParams { tilt_tau_s, heading_tau_s };
        let mut ours = RobustFilter::new(params, declination);
        let mut twin = Box::new(InDouble::new(params, declination));
        let start = start + vec3(0.0, 0.0, -9.8);
        ours.update(Vec3::ZERO, start, None, 0.0);
        twin.update(V::ZERO, double(start), None, 0.0);
        for (index, phase) in phases.iter().enumerate() {
            // In a step longer than τ more is turned back than the lean, and rounding grows from step to step.
            let dt_s = phase.dt_s.min(if tilt_tau_s < 2.0 { 0.5 * tilt_tau_s } else { 10.0 });
            if index == zeroed_before {
                ours.gyro_zeroed();
                twin.gyro_zeroed();
            }
            for step in 0..phase.steps {
                let sign = if step % 2 == 0 { 1.0 } else { -1.0 };
                let mut noise = [0.0; 3];
                noise[step % 3] = sign;
                let noise = Vec3::from(noise);
                let (gyro, accel) = (phase.gyro + noise * phase.noise.0, phase.accel + noise * phase.noise.1);
                ours.update(gyro, accel, phase.mag, dt_s);
                twin.update(double(gyro), double(accel), phase.mag.map(double), dt_s.into());
                if twin.doubtful {
                    return Ok(());
                }
                for (what, off, bound) in apart(&ours, &twin) {
                    prop_assert!(off <= bound, "{} is {} apart in step {} of {:?}", what, off, step, phase);
                }
                prop_assert_eq!(ours.started(), twin.attitude.is_some());
            }
        }
    }

    /// Whatever a filter has been through, begun again it is a new one.
    #[test]
    fn a_restart_leaves_nothing(phases in prop::collection::vec(phase(), 1..3), odd in [ANY, ANY, ANY]) {
        let params = RobustParams { tilt_tau_s: 0.5, heading_tau_s: 0.7 };
        let [mut used, mut fresh] = [RobustFilter::new(params, 0.3); 2];
        for Phase { gyro, accel, mag, dt_s, .. } in &phases {
            for _ in 0..50 {
                used.update(*gyro, *accel, *mag, *dt_s);
            }
        }
        used.update(odd.into(), odd.into(), Some(odd.into()), odd[0]);
        used.gyro_zeroed();
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
fn a_start_upside_down_is_half_a_turn_about_ahead() {
    for off in [Vec3::ZERO, vec3(1e-5, 0.0, 0.0), vec3(0.0, -1e-5, 0.0), vec3(0.02, 0.01, 0.0)] {
        let mut filter = RobustFilter::new(RobustParams { tilt_tau_s: 5.0, heading_tau_s: 9.0 }, 0.0);
        filter.update(Vec3::ZERO, vec3(0.0, 0.0, 9.8) + off, None, 0.0);
        assert!((filter.down() - vec3(0.0, 0.0, -1.0)).norm() < 3e-3, "{filter:?}");
        assert!((filter.attitude().norm_squared() - 1.0).abs() < 1e-6, "{filter:?}");
    }
}

#[test]
fn what_hangs_upside_down_leans_by_a_whole_g_to_one_side() {
    assert_eq!(level(vec3(0.0, 0.0, 1.0)), [1.0, 0.0]);
    assert_eq!(level(vec3(0.0, 0.6, 0.8)), [0.0, 1.0]);
    assert_eq!(level(vec3(0.3, -0.4, 0.6)), [0.6, -0.8]);
    // Within half a g of it, and right side up, as it is; in free fall nothing.
    assert_eq!(level(vec3(0.3, -0.4, 0.4)), [0.3, -0.4]);
    assert_eq!(level(vec3(0.3, -0.4, -0.9)), [0.3, -0.4]);
    assert_eq!(level(vec3(0.05, 0.05, -0.05)), [0.0, 0.0]);
    assert_eq!(level(vec3(0.0, 0.11, 0.0)), [0.0, 0.11]);
}

/// 200 rad/s, 1,000 m/s² and 10,000 µT: what is more changes nothing, and what is less is taken in.
#[test]
fn readings_beyond_their_limits_are_none() {
    let mut filter = RobustFilter::new(RobustParams { tilt_tau_s: 5.0, heading_tau_s: 9.0 }, 0.0);
    let (level, north) = (vec3(0.0, 0.0, -9.8), vec3(20.0, 0.0, 40.0));
    for _ in 0..3 {
        filter.update(Vec3::ZERO, level, Some(north), 0.001);
    }
    let taken = |gyro: Vec3<f32>, accel: Vec3<f32>, mag: Vec3<f32>| {
        let mut usual = filter;
        usual.update(Vec3::ZERO, level, None, 0.001);
        let mut other = filter;
        other.update(gyro, accel, Some(mag), 0.001);
        // A sample that is none is not even a time that has passed.
        (other.attitude() != usual.attitude(), std::format!("{other:?}") != std::format!("{filter:?}"))
    };
    for (size, is_one) in [(0.99, true), (1.01, false)] {
        let none = vec3(0.0, 0.0, 0.0);
        assert_eq!(taken(vec3(0.0, 0.0, 200.0 * size), level, none), (is_one, is_one));
        assert_eq!(taken(none, vec3(0.0, 1.0e3 * size, 0.0), none), (is_one, is_one));
        // Without its field it is still a sample.
        assert_eq!(taken(none, level, vec3(0.0, 1.0e4 * size, 0.0)), (is_one, true));
    }
}

/// Nothing is seen of a bias about the vertical without a field. What is not known of it grows with its walk, and after
/// an hour by √3600 · 0.02 °/s = 1.2 °/s, but for the bound that is what was not known at first.
#[test]
fn what_is_not_seen_is_known_no_less_than_at_first() {
    let mut filter = RobustFilter::new(RobustParams { tilt_tau_s: 5.0, heading_tau_s: 9.0 }, 0.0);
    filter.looks_for_rest = false;
    let first = filter.variance.z;
    for step in 0..3600 {
        filter.update(Vec3::ZERO, vec3(0.0, 0.0, -9.8), None, 1.0);
        // It starts for τ, and learns nothing.
        assert!(step < 6 || filter.variance.z <= first, "{filter:?}");
    }
    assert!(filter.variance.z > 0.99 * first && filter.variance.x < 0.01 * first, "{filter:?}");
}
