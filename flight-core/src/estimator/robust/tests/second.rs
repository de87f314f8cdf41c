//! The filter again, in f64 and in another form: the attitude is a rotation matrix, the transition a dense matrix that
//! multiplies the covariance from both sides, and a measurement is processed in Joseph's form. Written from the
//! module documentation; it shares only the geometry with the filter.

#![allow(clippy::needless_range_loop, reason = "an index stands for a row and for a column")]

use super::super::super::tests::properties::rotation;
use super::super::RobustParams;
use crate::geometry::{Mat3, Vec3, vec3};

pub type V = Vec3<f64>;
pub const G64: f64 = 9.80665;
pub const RAD: f64 = core::f64::consts::PI / 180.0;
const N: usize = 11;
/// Parts of a cycle: three of the prediction, two velocities, three biases, heading.
const PARTS: usize = 9;
pub type Matrix = [[f64; N]; N];

pub fn double(v: Vec3<f32>) -> V {
    <[f32; 3]>::from(v).map(f64::from).into()
}

fn within(v: V, limit: f64) -> V {
    <[f64; 3]>::from(v).map(|x| x.clamp(-limit, limit)).into()
}

fn product(a: &Matrix, b: &Matrix) -> Matrix {
    let mut out = [[0.0; N]; N];
    for (out, a) in out.iter_mut().zip(a) {
        for (a, b) in a.iter().zip(b) {
            for (out, b) in out.iter_mut().zip(b) {
                *out += a * b;
            }
        }
    }
    out
}

fn transposed(a: &Matrix) -> Matrix {
    core::array::from_fn(|row| core::array::from_fn(|column| a[column][row]))
}

fn unit() -> Matrix {
    core::array::from_fn(|row| core::array::from_fn(|column| f64::from(u8::from(row == column))))
}

fn first_variances() -> Matrix {
    let (tilt, heading, bias) = (30.0 * RAD, 10.0 * RAD, 3.0 * RAD);
    let deviations = [tilt, tilt, heading, 1.0, 1.0, bias, bias, bias, 0.005, 0.005, 0.005];
    let mut p = unit();
    for (state, deviation) in deviations.into_iter().enumerate() {
        p[state][state] = deviation * deviation;
    }
    p
}

/// What the samples of a cycle add up to.
#[derive(Clone, Copy)]
struct Sums {
    dt: f64,
    /// ∫ R [1 | diag ω] dt: the rotation by a bias and by an error of the scale.
    turn: [[f64; 6]; 3],
    /// ∫ R f dt, m/s.
    pushed: V,
    /// ∫ ω dt, rad, as measured.
    gyro: V,
    /// ∫ |ω|² dt, rad²/s, corrected.
    rate_squared: f64,
}

const NOTHING: Sums =
    Sums { dt: 0.0, turn: [[0.0; 6]; 3], pushed: V::ZERO, gyro: V::ZERO, rate_squared: 0.0 };

impl Sums {
    fn transition(&self) -> Matrix {
        let V { x, y, z } = self.pushed;
        // A tilt error turns the change of velocity: θ × Δv.
        let turned = [[0.0, z, -y], [-z, 0.0, x]];
        let mut a = unit();
        for of in 0..6 {
            for axis in 0..3 {
                a[axis][5 + of] = -self.turn[axis][of];
            }
            for (north_or_east, turned) in turned.iter().enumerate() {
                // The mean of an error that grows evenly is half of the last one.
                a[3 + north_or_east][5 + of] =
                    (0..3).map(|axis| -0.5 * turned[axis] * self.turn[axis][of]).sum();
            }
        }
        for (north_or_east, turned) in turned.iter().enumerate() {
            a[3 + north_or_east][..3].copy_from_slice(turned);
        }
        a
    }
}

pub struct InDouble {
    speed: f64,
    heading_noise: f64,
    declination: f64,
    detects_rest: bool,
    /// Body to world; `None` before the start.
    pub attitude: Option<Mat3<f64>>,
    /// Time of the samples before the start, then since the start up to 2 s.
    age: f64,
    pub velocity: [f64; 2],
    pub bias: V,
    pub scale: V,
    pub p: Matrix,
    vertical_force: f64,
    mean_speed_squared: f64,
    now: Sums,
    last: Sums,
    /// Parts of the last cycle that are done.
    done: usize,
    /// Usual time between two samples, s; 0 before the first.
    usual_dt: f64,
    fast: [V; 2],
    slow: [V; 2],
    rest_s: f64,
    heading_set: bool,
    field: Option<V>,
    field_dt: f64,
    /// Means of the horizontal and vertical part of the field, and their age.
    pub field_means: [f64; 2],
    field_age: f64,
    deviation: f64,
    pub deviating: f64,
    pub offset: V,
    /// Whether a comparison was so close that rounding may change its result.
    pub ambiguous: bool,
}

impl InDouble {
    pub fn new(params: RobustParams, declination: f32) -> Self {
        Self {
            speed: params.speed_m_s.into(),
            heading_noise: params.heading_noise_rad.into(),
            declination: declination.into(),
            detects_rest: true,
            attitude: None,
            age: 0.0,
            velocity: [0.0; 2],
            bias: V::ZERO,
            scale: V::ZERO,
            p: first_variances(),
            vertical_force: 0.0,
            mean_speed_squared: 0.0,
            now: NOTHING,
            last: NOTHING,
            done: PARTS,
            usual_dt: 0.0,
            fast: [V::ZERO; 2],
            slow: [V::ZERO; 2],
            rest_s: 0.0,
            heading_set: false,
            field: None,
            field_dt: 0.0,
            field_means: [0.0; 2],
            field_age: 0.0,
            deviation: 0.0,
            deviating: 0.0,
            offset: V::ZERO,
            ambiguous: false,
        }
    }

    /// Marks the comparison as ambiguous, if it is.
    fn note(&mut self, ambiguous: bool) {
        self.ambiguous |= ambiguous;
    }

    /// Returns whether a < b, and marks a close comparison as ambiguous.
    fn below(&mut self, a: f64, b: f64) -> bool {
        self.note((a - b).abs() < 1e-3 * b.abs() + 1e-7);
        a < b
    }

    /// Returns whether a limit of time is reached, with the rounding of accumulated times.
    fn reached(&mut self, time: f64, limit: f64) -> bool {
        self.note((time - limit).abs() < 1e-5 * limit && time != limit);
        time >= limit
    }

    /// Counts a time up to a limit, and marks where rounding decides whether it is reached.
    fn counted(&mut self, time: f64, dt: f64, limit: f64) -> f64 {
        let off = (time + dt - limit).abs();
        self.note(off > 0.0 && off < 1e-5 * limit && time != limit);
        (time + dt).min(limit)
    }

    pub fn update(&mut self, gyro: V, accel: V, mag: Option<V>, dt: f64) {
        if !(gyro.norm() < 200.0 && accel.norm() < 1000.0) {
            return;
        }
        let dt = if dt > 0.0 { dt.min(1.0) } else { 0.0 };
        match self.attitude {
            None => self.start(gyro, accel, dt),
            Some(attitude) if dt > 0.0 => self.predict(attitude, gyro, accel, dt),
            Some(_) => {}
        }
        self.field_dt = (self.field_dt + dt).min(1.0);
        if let (Some(m), Some(attitude)) = (mag.filter(|m| m.norm() < 1e4), self.attitude) {
            let field = attitude * (m - self.offset);
            self.field = Some(field);
            if !self.heading_set && !self.below(field.x.hypot(field.y), 1.0) {
                self.set_heading(attitude, field);
            }
        }
        self.work(dt);
    }

    fn start(&mut self, gyro: V, accel: V, dt: f64) {
        if self.below(accel.norm(), 0.1 * G64) {
            self.age += dt;
            if self.reached(self.age, 1.0) {
                self.attitude = Some(Mat3::IDENTITY);
            }
        } else {
            self.attitude = Some(self.level(accel));
        }
        if self.attitude.is_some() {
            self.age = 0.0;
            (self.fast, self.slow) = ([gyro, accel], [gyro, accel]);
        }
    }

    /// Returns the shortest rotation from the measured direction of down to the vertical.
    fn level(&mut self, accel: V) -> Mat3<f64> {
        let down = accel * (-1.0 / accel.norm());
        let axis = down.cross(Vec3::Z);
        if axis.norm() == 0.0 && down.z > 0.0 {
            return Mat3::IDENTITY;
        }
        self.note(axis.norm() < 1e-2 && down.z < 0.0);
        let angle = axis.norm().atan2(down.z);
        rotation(axis * (angle / axis.norm()))
    }

    fn predict(&mut self, before: Mat3<f64>, gyro: V, accel: V, dt: f64) {
        let rates = gyro - self.bias - gyro.scale_by(self.scale);
        let attitude = before * rotation(rates * dt);
        self.attitude = Some(attitude);
        let force = attitude * accel;
        self.velocity[0] += force.x * dt;
        self.velocity[1] += force.y * dt;
        let measured = <[f64; 3]>::from(gyro);
        for (sums, row) in self.now.turn.iter_mut().zip(attitude.rows) {
            for (axis, r) in <[f64; 3]>::from(row).into_iter().enumerate() {
                sums[axis] += r * dt;
                sums[3 + axis] += r * measured[axis] * dt;
            }
        }
        self.now.pushed += force * dt;
        self.now.gyro += gyro * dt;
        self.now.rate_squared += rates.dot(rates) * dt;
        self.now.dt += dt;

        let before = self.age;
        self.age = self.counted(self.age, dt, 2.0);
        self.vertical_force = self.vertical_force * (1.0 - dt / self.age) + force.z * dt / self.age;
        self.note(before < 0.11 && (self.age - 0.1).abs() < 1e-5);
        if before < 0.1 && self.age >= 0.1 {
            self.level_start();
        }
        if self.detects_rest {
            self.detect_rest(gyro, accel, dt);
        }
        let settled = self.reached(self.age, 2.0);
        self.note(settled && self.vertical_force.abs() < 1e-2);
        if settled && self.vertical_force > 0.0 && !self.below(accel.norm(), 0.1 * G64) {
            self.turn_round(accel);
        }
    }

    /// Starts again, except for what is known of the gyroscope and of rest.
    fn turn_round(&mut self, accel: V) {
        self.attitude = Some(self.level(accel));
        let mut p = first_variances();
        for (state, row) in p.iter_mut().enumerate().skip(5) {
            row[state] = self.p[state][state];
        }
        let new = Self::new(RobustParams { speed_m_s: 1.0, heading_noise_rad: 1.0 }, 0.0);
        *self = Self {
            p,
            speed: self.speed,
            heading_noise: self.heading_noise,
            declination: self.declination,
            detects_rest: self.detects_rest,
            attitude: self.attitude,
            bias: self.bias,
            scale: self.scale,
            fast: self.fast,
            slow: self.slow,
            rest_s: self.rest_s,
            ambiguous: self.ambiguous,
            ..new
        };
    }

    fn level_start(&mut self) {
        let [north, east] = self.velocity.map(|velocity| velocity / self.age);
        let mean = vec3(north, east, self.vertical_force);
        if self.below(mean.norm(), 0.1 * G64) {
            return;
        }
        let turn = self.level(mean);
        self.attitude = self.attitude.map(|attitude| turn * attitude);
        self.velocity = [0.0; 2];
        self.vertical_force = -mean.norm();
        self.now = NOTHING;
        self.heading_set = false;
        self.field = None;
    }

    fn contradicts_rest(&mut self) -> bool {
        let (force, Some(attitude)) = (self.slow[1], self.attitude) else { return false };
        let down = attitude.rows[2];
        let angle = force.cross(down).norm().atan2(-force.dot(down));
        // The attitudes of the two filters differ by up to 0.01 rad.
        let at_rest = self.rest_s > 1.4;
        self.note(at_rest && (angle - 30.0 * RAD).abs() < 0.02);
        self.at_rest() && !self.below(force.norm(), 0.1 * G64) && !self.below(angle, 30.0 * RAD)
    }

    fn start_at_rest(&mut self) {
        let new = Self::new(RobustParams { speed_m_s: 1.0, heading_noise_rad: 1.0 }, 0.0);
        *self = Self {
            speed: self.speed,
            heading_noise: self.heading_noise,
            declination: self.declination,
            detects_rest: self.detects_rest,
            attitude: Some(self.level(self.slow[1])),
            fast: self.fast,
            slow: self.slow,
            rest_s: self.rest_s,
            ambiguous: self.ambiguous,
            ..new
        };
    }

    fn detect_rest(&mut self, gyro: V, accel: V, dt: f64) {
        let [fast, slow] = [0.02, 0.5].map(|tau| dt / (tau + dt));
        let mut off = [0.0; 2];
        for (sensor, now) in [gyro, accel].into_iter().enumerate() {
            self.fast[sensor] = self.fast[sensor] * (1.0 - fast) + now * fast;
            off[sensor] = (self.fast[sensor] - self.slow[sensor]).norm();
            self.slow[sensor] = self.slow[sensor] * (1.0 - slow) + self.fast[sensor] * slow;
        }
        let steady = self.below(off[0], 2.0 * RAD) & self.below(off[1], 0.2);
        let still = steady & self.below(self.slow[0].norm(), 0.35);
        self.rest_s = if still { self.counted(self.rest_s, dt, 1.5) } else { 0.0 };
    }

    fn at_rest(&mut self) -> bool {
        self.reached(self.rest_s, 1.5)
    }

    fn work(&mut self, dt: f64) {
        if self.done == PARTS && self.reached(self.now.dt, 0.02) {
            if self.contradicts_rest() {
                self.start_at_rest();
                return;
            }
            (self.last, self.now) = (self.now, NOTHING);
            self.done = 0;
        }
        // One part for each ninth of the cycle's shortest time that has begun in the usual time between samples.
        let before = if self.usual_dt > 0.0 { self.usual_dt } else { dt };
        self.usual_dt = 0.875 * before + 0.125 * dt.min(4.0 * before);
        let parts = self.usual_dt / 0.02 * PARTS as f64;
        self.note(parts > 0.5 && parts < 1.1 * PARTS as f64 && (parts - parts.round()).abs() < 2e-5);
        for _ in 0..(parts.ceil() as usize).clamp(1, PARTS) {
            let at_rest = (5..=7).contains(&self.done) && self.is_at_bias_rest();
            match self.done {
                // The first two parts prepare the third.
                0 | 1 => {}
                2 => self.grow(),
                3 | 4 => self.standstill(self.done - 3),
                5..=7 if at_rest => {
                    let axis = self.done - 5;
                    let rate = <[f64; 3]>::from(self.last.gyro)[axis] / self.last.dt;
                    let off = rate - <[f64; 3]>::from(self.bias)[axis];
                    self.measure(5 + axis, off, (0.17 * RAD).powi(2) / self.last.dt);
                }
                5..=7 => {}
                8 => self.measure_heading(),
                _ => return,
            }
            self.done += 1;
        }
    }

    fn grow(&mut self) {
        let a = self.last.transition();
        self.p = product(&product(&a, &self.p), &transposed(&a));
        let dt = self.last.dt;
        let turn = (0.1 * RAD).powi(2) * dt + 0.001_f64.powi(2) * self.last.rate_squared;
        let walk = (0.005 * RAD).powi(2) * dt;
        let (attitude, velocity, bias) = (60.0 * RAD, 100.0, 3.0 * RAD);
        let pushed = (0.001 * self.last.pushed.norm()).powi(2);
        let noise = [turn, turn, turn, pushed, pushed, walk, walk, walk, 0.0, 0.0, 0.0];
        let limits = [attitude, attitude, attitude, velocity, velocity, bias, bias, bias];
        // D P D with a diagonal D, so that no variance is above the square of its limit.
        let mut limit = unit();
        for state in 0..N {
            self.p[state][state] += noise[state];
            let deviation = self.p[state][state].sqrt();
            limit[state][state] = limits.get(state).map_or(1.0, |limit| (limit / deviation).min(1.0));
        }
        self.p = product(&product(&limit, &self.p), &limit);
    }

    fn standstill(&mut self, axis: usize) {
        self.note((self.vertical_force + 0.3 * G64).abs() < 1e-2);
        if self.vertical_force > -0.3 * G64 {
            self.velocity[axis] = 0.0;
            for state in 0..N {
                (self.p[3 + axis][state], self.p[state][3 + axis]) = (0.0, 0.0);
            }
            self.p[3 + axis][3 + axis] = 1.0;
            return;
        }
        let dt = self.last.dt;
        if axis == 0 {
            let share = dt / (5.0 + dt);
            let squared = self.velocity[0].powi(2) + self.velocity[1].powi(2);
            self.mean_speed_squared = (1.0 - share) * self.mean_speed_squared + share * squared;
        }
        let variance =
            if self.at_rest() { 0.05 * 0.05 } else { self.speed.powi(2) + 0.2 * self.mean_speed_squared };
        self.measure(3 + axis, -self.velocity[axis], variance * 2.0 / dt);
    }

    fn is_at_bias_rest(&mut self) -> bool {
        let change = self.slow[0] - self.bias;
        let known = RAD.powi(2) + 9.0 * (self.p[5][5] + self.p[6][6] + self.p[7][7]);
        self.at_rest() && self.below(change.dot(change), known)
    }

    /// Processes the measurement of a state with Joseph's form, (1 − K H) P (1 − K H)ᵀ + K R Kᵀ.
    fn measure(&mut self, state: usize, off: f64, noise: f64) {
        let gain = self.p.map(|row| row[state] / (self.p[state][state] + noise));
        let mut kept = unit();
        for row in 0..N {
            kept[row][state] -= gain[row];
        }
        self.p = product(&product(&kept, &self.p), &transposed(&kept));
        for row in 0..N {
            for column in 0..N {
                self.p[row][column] += gain[row] * noise * gain[column];
            }
        }
        let [a0, a1, a2, v0, v1, b0, b1, b2, s0, s1, s2] = gain.map(|gain| gain * off);
        // Large corrections overshoot, and rounding errors grow from one to the next.
        self.note(vec3(a0, a1, a2).norm() > 1.0);
        self.attitude = self.attitude.map(|attitude| rotation(vec3(a0, a1, a2)) * attitude);
        self.velocity = [self.velocity[0] + v0, self.velocity[1] + v1];
        self.bias = within(self.bias + vec3(b0, b1, b2), 0.35);
        self.scale = within(self.scale + vec3(s0, s1, s2), 0.02);
    }

    /// Returns the angle from north to a field, rad.
    fn heading_error(&mut self, field: V) -> f64 {
        let turns = (field.y.atan2(field.x) - self.declination) / core::f64::consts::TAU;
        self.note((turns.fract().abs() - 0.5).abs() < 1e-3);
        core::f64::consts::TAU * (turns - turns.round())
    }

    fn set_heading(&mut self, attitude: Mat3<f64>, field: V) {
        let turn = rotation(vec3(0.0, 0.0, -self.heading_error(field)));
        self.attitude = Some(turn * attitude);
        let velocity = turn * vec3(self.velocity[0], self.velocity[1], 0.0);
        self.velocity = [velocity.x, velocity.y];
        for state in 0..N {
            (self.p[2][state], self.p[state][2]) = (0.0, 0.0);
        }
        self.p[2][2] = (30.0 * RAD).powi(2);
        self.heading_set = true;
        self.field = None;
        self.field_dt = 0.0;
    }

    fn measure_heading(&mut self) {
        let (Some(field), Some(_)) = (self.field.take(), self.attitude) else {
            return;
        };
        let dt = core::mem::take(&mut self.field_dt);
        let level = field.x.hypot(field.y);
        if self.below(level, 1.0) || dt < 1e-6 {
            return;
        }
        let (weight, off) = self.field_weight([level, field.z], dt);
        if self.below(weight, 1e-3) {
            return;
        }
        let error = self.heading_error(field);
        let tilt = self.p[0][0] + self.p[1][1];
        let noise = self.heading_noise.powi(2) / (weight * dt) + tilt * (field.z / level).powi(2);
        self.measure(2, -error, noise);
        let turning = (self.last.rate_squared / self.last.dt).sqrt();
        if !self.below(turning, 0.4) {
            // The difference to the mean horizontal field, which points to magnetic north.
            let usual = level - off[0];
            let (sin, cos) = self.declination.sin_cos();
            let residual = vec3(field.x - usual * cos, field.y - usual * sin, off[1]);
            let attitude = self.attitude.unwrap_or(Mat3::IDENTITY);
            let learnt = self.offset + attitude.transpose() * residual * (weight * dt / 30.0);
            self.offset = within(learnt, 10.0);
        }
    }

    /// Returns the weight of a field with these parts, and its deviations from their means.
    fn field_weight(&mut self, parts: [f64; 2], dt: f64) -> (f64, [f64; 2]) {
        let off = |means: [f64; 2]| [parts[0] - means[0], parts[1] - means[1]];
        let mut weight = 1.0;
        if self.field_age > 0.0 && self.reached(self.age, 2.0) {
            let [level_off, vertical_off] = off(self.field_means);
            let strength = self.field_means[0].hypot(self.field_means[1]).max(1.0);
            let squared = (level_off.hypot(vertical_off) / strength).powi(2).min(1.0);
            let share = dt / (0.25 + dt);
            self.deviation = (1.0 - share) * self.deviation + share * squared;
            weight = 1.0 / (1.0 + (self.deviation / 0.06_f64.powi(2)).powi(2));
            if self.below(weight, 0.5) {
                self.deviating += dt;
            } else {
                self.deviating = 0.0;
            }
            if self.reached(self.deviating, 60.0) {
                (self.field_age, self.deviation, self.deviating) = (0.0, 0.0, 0.0);
            }
        }
        if self.field_age == 0.0 {
            self.field_means = parts;
        }
        self.field_age = (self.field_age + dt).clamp(1e-3, 20.0);
        let off = off(self.field_means);
        let share = (weight * dt / self.field_age).min(1.0);
        self.field_means = [self.field_means[0] + share * off[0], self.field_means[1] + share * off[1]];
        (weight, off)
    }

    pub fn on_gyro_zeroed(&mut self) {
        self.bias = V::ZERO;
        for state in 5..8 {
            for other in 0..N {
                (self.p[state][other], self.p[other][state]) = (0.0, 0.0);
            }
            self.p[state][state] = 0.17 * RAD * (0.005 * RAD);
        }
        self.detects_rest = false;
        self.rest_s = 0.0;
    }
}
