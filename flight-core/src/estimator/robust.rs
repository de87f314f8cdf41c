//! A Kalman filter for the attitude that also estimates its disturbances: bias and scale of the gyroscope,
//! acceleration, and two kinds of magnetic disturbance.
//!
//! ```text
//!  ω ─(− b − s ω)──► rotate q ─┬─► world: f ──► ∫ ──► v = 0 ──────┐
//!                              │                                  ├──► gains ──► q, v, b, s
//!                              └─► world: m − o ──► heading = 0 ──┘
//! ```
//!
//! The states are the attitude q, the horizontal velocity v, and the bias b and scale error s of the gyroscope, with
//! the covariance of their errors: the error-state filter of Solà, *Quaternion kinematics for the error-state Kalman
//! filter* (2017), with attitude errors in world axes.
//!
//! **Acceleration.** No sensor measures the velocity, but it is bounded: "the velocity is zero" is a measurement with
//! an error as large as the velocity itself. A tilt error θ turns gravity into the horizontal, where it integrates to
//! gθt, which soon is larger than the true velocity; the acceleration of the vehicle integrates to its true velocity
//! and no further. So acceleration cancels by itself, also in free flight, where no single sample shows the tilt.
//! (Mahony et al. 2008 average in body axes; averaging in a nearly inertial frame is from Laidig and Seel, *VQF*,
//! Information Fusion 91, 2023; the measurement of velocity zero is known from foot-mounted navigation.) The specific
//! force is integrated without any exception for large or small values: leaving out single samples would break the
//! balance, and rectify the motion. The error of the measurement is σ² = `speed_m_s`² + [`SPEED_SHARE`] · mean v²,
//! over a time of correlation of [`SPEED_S`]: slow motion is corrected quickly, fast motion slowly.
//!
//! **Bias and scale.** The covariances between them and the attitude follow from the motion itself: while the sensor
//! turns, R in ∫ R dt changes, and with it the axis that a tilt error speaks about. Gyroscopes have scale errors of
//! some tenths of a percent, which at 400 °/s are 1 to 2 °/s. At rest the gyroscope measures its bias directly.
//!
//! **Start.** The first sample sets the tilt, and the mean of the first tenth of a second sets it again, with a standard
//! deviation of 30°: in motion it may be that wrong. The
//! gains of a Kalman filter then fall with time as they should, for any bias up to some [`FIRST_BIAS`]. A vehicle that
//! starts upside down, with a specific force that points down in the mean over [`FORCE_S`], is turned round. At rest an estimate whose tilt is wrong by more than 30° starts again, with its bias. Without
//! gravity in the specific force, as phones deliver it, the filter starts level after [`NO_GRAVITY_S`], and integrates
//! the gyroscope.
//!
//! **Magnetic field.** A field whose horizontal and vertical parts differ from their means has little weight for the
//! heading (the test of VQF, in other coordinates and with a continuous weight). A field that lasts is accepted as the
//! field of a new place. A field that rotates with the sensor is not a disturbance but a change of its calibration: it
//! is the part of the field that is not constant in the world, and is estimated slowly while the sensor turns. See
//! `robust/field.rs`.
//!
//! **Time.** Rotation and sums are updated with each sample. The work on the covariance is a cycle of
//! [`PARTS`] parts in at least [`CYCLE_S`], spread over the samples, so that no sample takes long.

mod covariance;
mod field;
mod rest;

use super::at_rest::MAX_BIAS;
use super::{Filter, FilterInput, MIN_HORIZONTAL_FIELD_SQUARED, MIN_SPECIFIC_FORCE_SQUARED, Setting};
use crate::STANDARD_GRAVITY;
use crate::arithmetic::{atan2, max, min, sin_cos, sqrt, wrap_pi};
use crate::geometry::{Quaternion, Vec3, vec3};
use covariance::{ATTITUDE, BIAS, Covariance, SCALE, STATES, Transition, VELOCITY};
use field::MagneticField;
use rest::RestDetector;

/// rad/°.
const DEGREE: f32 = core::f32::consts::PI / 180.0;

/// Limits of valid readings: 11,000 °/s (rad/s), 100 g (m/s²), 200 times the Earth's field (µT). Readings within them
/// cause no overflow below.
const MAX_RATE: f32 = 200.0;
const MAX_SPECIFIC_FORCE: f32 = 1.0e3;
const MAX_FIELD: f32 = 1.0e4;
/// Longest time between two samples that is integrated, s.
const MAX_DT_S: f32 = 1.0;

/// Standard deviations at the start: tilt and heading (rad), velocity (m/s), bias (rad/s), scale (1).
const FIRST_TILT: f32 = 30.0 * DEGREE;
/// Before the first field the heading is zero by definition; its error comes from the tilt at the start.
const FIRST_HEADING: f32 = 10.0 * DEGREE;
const FIRST_VELOCITY: f32 = 1.0;
const FIRST_BIAS: f32 = 3.0 * DEGREE;
const FIRST_SCALE: f32 = 0.005;
/// Standard deviation of the heading after the first field, rad. It is large, so that the first fields count alike.
const FIELD_HEADING: f32 = 30.0 * DEGREE;
/// Largest standard deviations of attitude (rad) and velocity (m/s). Bias and scale are limited to the first ones.
const MAX_ATTITUDE: f32 = 60.0 * DEGREE;
const MAX_VELOCITY: f32 = 100.0;

/// Noise of the attitude, rad/√s: what no other state explains, as a wrong sample. With the noise of the velocity in slow
/// motion it gives the tilt a time constant of some 5 s.
const TURN_NOISE: f32 = 0.1 * DEGREE;
/// Share of the rate that adds to this noise, rad per rad/s and √s: what is left of misaligned axes.
const TURN_NOISE_SHARE: f32 = 0.001;
/// Share of the change of velocity that adds to its error: the accelerometer's errors of scale and alignment. It also
/// keeps the error above the rounding of the covariances at any specific force.
const FORCE_SHARE: f32 = 0.001;
/// Random walk of the bias, rad/s/√s: 0.05 °/s in 100 s.
const BIAS_WALK: f32 = 0.005 * DEGREE;
/// Noise of the bias measurement at rest, rad/s/√Hz.
const REST_NOISE: f32 = 0.17 * DEGREE;
/// Standard deviation of the velocity at rest, m/s.
const REST_SPEED: f32 = 0.05;
/// Difference between a steady rate and the known bias, plus three standard deviations, above which the rate is a
/// slow turn, rad/s.
const REST_BIAS_CHANGE: f32 = 1.0 * DEGREE;
/// Cosine of the tilt error at rest above which the filter starts again: 30°.
const COS_REST_TILT: f32 = 0.866_025;
/// Correlation time of the velocity, s: twice its half is the noise density of "the velocity is zero".
const SPEED_S: f32 = 1.0;
/// Share of the mean squared velocity that adds to the error of this measurement, and its averaging time, s.
const SPEED_SHARE: f32 = 0.2;
const MEAN_SPEED_S: f32 = 5.0;
/// Averaging time of the vertical specific force, s. Over this time a vehicle cannot accelerate down by more than g.
const FORCE_S: f32 = 2.0;
/// Smallest mean of the vertical specific force with which a velocity shows a tilt, m/s².
const MIN_GRAVITY: f32 = 0.3 * STANDARD_GRAVITY;
/// Time after the first sample over which the specific force sets the tilt again, by its mean, s. One sample may be a
/// shock: the feet of a vehicle slip in a gust.
const LEVEL_S: f32 = 0.1;
/// Time without gravity after which the filter starts level, s.
const NO_GRAVITY_S: f32 = 1.0;

/// Shortest time of a cycle of the covariance, s, and the number of its parts: three of the prediction, two
/// velocities, three biases at rest, heading.
const CYCLE_S: f32 = 0.02;
const PARTS: u32 = 9;
/// Rate above which the field of the sensor is estimated, rad/s (23 °/s): without rotation it cannot be distinguished
/// from the field of the world.
const OFFSET_RATE: f32 = 0.4;

/// The parameters of [`RobustFilter`] that depend on the vehicle and its place. Its other constants are properties of
/// sensors and of the Earth's field.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct RobustParams {
    /// Standard deviation of the velocity in slow motion, m/s: 0.05 to 50. Faster motion is noticed.
    pub speed_m_s: f32,
    /// Noise density of the direction of the field, rad/√Hz: 0.001 to 10.
    pub heading_noise_rad: f32,
}

impl RobustParams {
    pub(super) fn settings(&mut self) -> [Setting<'_>; 2] {
        [
            Setting::new("estimator.speed_m_s", &mut self.speed_m_s, 0.05, 50.0),
            Setting::new("estimator.heading_noise_rad", &mut self.heading_noise_rad, 1.0e-3, 10.0),
        ]
    }
}

/// The filter: see the module documentation.
#[derive(Clone, Copy, Debug)]
pub struct RobustFilter {
    q: Quaternion<f32>,
    /// Horizontal velocity north and east, m/s, as far as the specific force tells.
    velocity: [f32; 2],
    /// Bias of the gyroscope, rad/s, and its scale error, per axis of the body.
    bias: Vec3<f32>,
    scale: Vec3<f32>,
    covariance: Covariance,
    params: RobustParams,
    declination_rad: f32,
    /// Sine and cosine of the declination.
    declination_sc: (f32, f32),
    detects_rest: bool,
    started: bool,
    /// Time since the first sample, s: before the start, and counted up to [`FORCE_S`] after it.
    age_s: f32,
    /// Low-passed vertical specific force in world axes, m/s².
    vertical_force: f32,
    /// Low-passed square of the velocity, m²/s².
    mean_speed_squared: f32,
    /// The cycle that collects samples, and the last complete one.
    collected: Cycle,
    complete: Cycle,
    /// The next part of the work on the complete cycle.
    part: u32,
    /// Usual time between two samples, s; 0 before the first.
    usual_dt_s: f32,
    rest: RestDetector,
    magnetic: MagneticField,
    /// Whether a field has set the heading.
    heading_set: bool,
    /// The last field, µT, world axes, and the time since the last one that was used, s.
    field: Option<Vec3<f32>>,
    field_dt_s: f32,
}

/// Sums over the samples of a cycle.
#[derive(Clone, Copy, Debug, Default)]
struct Cycle {
    dt_s: f32,
    transition: Transition,
    /// ∫ ω dt, rad, body axes, with its bias.
    gyro: Vec3<f32>,
    /// ∫ |ω|² dt, rad²/s.
    rate_squared: f32,
}

impl RobustFilter {
    pub(super) fn new(params: RobustParams, declination_rad: f32) -> Self {
        Self {
            q: Quaternion::IDENTITY,
            velocity: [0.0; 2],
            bias: Vec3::ZERO,
            scale: Vec3::ZERO,
            covariance: first_covariance(),
            params,
            declination_rad,
            declination_sc: sin_cos(declination_rad),
            detects_rest: true,
            started: false,
            age_s: 0.0,
            vertical_force: 0.0,
            mean_speed_squared: 0.0,
            collected: Cycle::default(),
            complete: Cycle::default(),
            part: PARTS,
            usual_dt_s: 0.0,
            rest: RestDetector::default(),
            magnetic: MagneticField::default(),
            heading_set: false,
            field: None,
            field_dt_s: 0.0,
        }
    }

    /// Sets the attitude to the shortest rotation that brings −f to the vertical.
    #[cold]
    fn start(&mut self, gyro: Vec3<f32>, f: Vec3<f32>, dt_s: f32) {
        if f.dot(f) < MIN_SPECIFIC_FORCE_SQUARED {
            self.age_s += dt_s;
            self.started = self.age_s >= NO_GRAVITY_S;
        } else {
            self.q = level(f);
            self.started = true;
        }
        if self.started {
            self.age_s = 0.0;
            self.rest = RestDetector::from(gyro, f);
        }
    }

    /// Turns the attitude by the shortest rotation that brings the mean specific force since the first sample to the
    /// vertical. The next field sets the heading again.
    #[cold]
    fn level_start(&mut self) {
        let [north, east] = self.velocity;
        let mean = vec3(north / self.age_s, east / self.age_s, self.vertical_force);
        if mean.dot(mean) < MIN_SPECIFIC_FORCE_SQUARED {
            return;
        }
        self.q = level(mean) * self.q;
        self.velocity = [0.0; 2];
        self.vertical_force = -mean.norm();
        self.collected = Cycle::default();
        self.heading_set = false;
        self.field = None;
    }

    /// Turns an estimate that is upside down by the shortest rotation to the present specific force, and starts the
    /// covariance again.
    #[cold]
    fn turn_round(&mut self, f: Vec3<f32>) {
        if f.dot(f) < MIN_SPECIFIC_FORCE_SQUARED {
            return;
        }
        let (variance, bias, scale) = (self.covariance, self.bias, self.scale);
        let Self { params, declination_rad, detects_rest, rest, .. } = *self;
        *self = Self::new(params, declination_rad);
        *self = Self { q: level(f), bias, scale, detects_rest, rest, started: true, ..*self };
        for state in BIAS..STATES {
            self.covariance.set(state, variance.variance(state));
        }
    }

    /// Returns whether the sensor is at rest, and the estimated tilt differs from the measured one by more than 30°.
    #[inline(always)]
    fn contradicts_rest(&self) -> bool {
        let force = self.rest.mean_accel();
        let squared = force.dot(force);
        let along = -force.dot(self.q.down());
        self.rest.at_rest()
            && squared > MIN_SPECIFIC_FORCE_SQUARED
            && (along < 0.0 || along * along < COS_REST_TILT * COS_REST_TILT * squared)
    }

    /// Starts again from the specific force at rest. A tilt that was wrong by so much has also taught a wrong bias.
    #[cold]
    fn start_at_rest(&mut self) {
        let Self { params, declination_rad, detects_rest, rest, .. } = *self;
        *self = Self::new(params, declination_rad);
        *self = Self { q: level(rest.mean_accel()), detects_rest, rest, started: true, ..*self };
    }

    /// Predicts attitude and velocity, and collects what the covariance needs.
    #[inline(always)]
    fn predict(&mut self, gyro: Vec3<f32>, accel: Vec3<f32>, dt_s: f32) {
        let rates = gyro - self.bias - gyro.scale_by(self.scale);
        self.q = self.q * Quaternion::from_rotation_vector(rates * dt_s);
        // One Newton step for 1/√n at n = 1. The rounding of a step leaves n within 1e-6 of 1; the Newton step
        // squares this error.
        self.q = self.q.scaled(1.5 - 0.5 * self.q.norm_squared());
        let rows = self.q.to_matrix().rows;
        let force = vec3(rows[0].dot(accel), rows[1].dot(accel), rows[2].dot(accel));
        self.velocity[0] += force.x * dt_s;
        self.velocity[1] += force.y * dt_s;

        let cycle = &mut self.collected;
        let turned = gyro * dt_s;
        for (axis, row) in rows.into_iter().enumerate() {
            cycle.transition.rotation[axis] += row * dt_s;
            cycle.transition.turned[axis] += row.scale_by(turned);
        }
        cycle.transition.speed_change += force * dt_s;
        cycle.gyro += turned;
        cycle.rate_squared += rates.dot(rates) * dt_s;
        cycle.dt_s += dt_s;

        let new = self.age_s < LEVEL_S;
        self.age_s = min(self.age_s + dt_s, FORCE_S);
        self.vertical_force += (force.z - self.vertical_force) * (dt_s / self.age_s);
        if new && self.age_s >= LEVEL_S {
            self.level_start();
        }
        if self.detects_rest {
            self.rest.update(gyro, accel, dt_s);
        }
        if self.vertical_force > 0.0 && self.age_s >= FORCE_S {
            self.turn_round(accel);
        }
    }

    /// Does the parts of a cycle that are due with this sample: one at 1 kHz, all at 50 Hz. A single long step, as after
    /// lost samples, does not make more of them due.
    #[inline(always)]
    fn work(&mut self, dt_s: f32) {
        if self.part >= PARTS && self.collected.dt_s >= CYCLE_S {
            if self.contradicts_rest() {
                self.start_at_rest();
                return;
            }
            self.complete = core::mem::take(&mut self.collected);
            self.part = 0;
        }
        let usual_s = if self.usual_dt_s > 0.0 { self.usual_dt_s } else { dt_s };
        self.usual_dt_s = usual_s + (min(dt_s, 4.0 * usual_s) - usual_s) * 0.125;
        let mut due_s = self.usual_dt_s;
        while self.part < PARTS {
            self.work_on(self.part);
            self.part += 1;
            due_s -= CYCLE_S / PARTS as f32;
            if due_s <= 0.0 {
                break;
            }
        }
    }

    #[inline(always)]
    fn work_on(&mut self, part: u32) {
        match part {
            0 => self.covariance.predict_rows(0..BIAS, &self.complete.transition),
            1 => self.covariance.predict_rows(BIAS..STATES, &self.complete.transition),
            2 => {
                self.covariance.predict_columns(&self.complete.transition);
                self.add_noise();
            }
            3 => self.measure_velocity(0),
            4 => self.measure_velocity(1),
            5..=7 if self.is_at_bias_rest() => self.measure_bias(part as usize - 5),
            5..=7 => {}
            _ => self.measure_heading(),
        }
    }

    #[inline(always)]
    fn add_noise(&mut self) {
        let Cycle { dt_s, transition, rate_squared, .. } = self.complete;
        let turn = TURN_NOISE * TURN_NOISE * dt_s + TURN_NOISE_SHARE * TURN_NOISE_SHARE * rate_squared;
        let walk = BIAS_WALK * BIAS_WALK * dt_s;
        for axis in 0..3 {
            self.covariance.add(ATTITUDE + axis, turn, MAX_ATTITUDE * MAX_ATTITUDE);
            self.covariance.add(BIAS + axis, walk, FIRST_BIAS * FIRST_BIAS);
        }
        let change = transition.speed_change;
        let pushed = FORCE_SHARE * FORCE_SHARE * change.dot(change);
        for axis in 0..2 {
            self.covariance.add(VELOCITY + axis, pushed, MAX_VELOCITY * MAX_VELOCITY);
        }
    }

    /// Processes "the velocity is zero" along one horizontal axis.
    fn measure_velocity(&mut self, axis: usize) {
        if self.vertical_force > -MIN_GRAVITY {
            // In free fall, or where gravity was removed from the readings, the velocity shows no tilt.
            self.velocity[axis] = 0.0;
            self.covariance.set(VELOCITY + axis, FIRST_VELOCITY * FIRST_VELOCITY);
            return;
        }
        let dt_s = self.complete.dt_s;
        if axis == 0 {
            let [north, east] = self.velocity;
            let change = north * north + east * east - self.mean_speed_squared;
            self.mean_speed_squared += change * (dt_s / (MEAN_SPEED_S + dt_s));
        }
        let slow = self.params.speed_m_s;
        let variance = if self.rest.at_rest() {
            REST_SPEED * REST_SPEED
        } else {
            slow * slow + SPEED_SHARE * self.mean_speed_squared
        };
        self.correct(VELOCITY + axis, -self.velocity[axis], variance * (2.0 * SPEED_S / dt_s));
    }

    /// Returns whether the sensor is at rest, and its rate not a slow turn.
    fn is_at_bias_rest(&self) -> bool {
        let change = self.rest.mean_gyro() - self.bias;
        let known = |axis: usize| self.covariance.variance(BIAS + axis);
        self.rest.at_rest()
            && change.dot(change)
                <= REST_BIAS_CHANGE * REST_BIAS_CHANGE + 9.0 * (known(0) + known(1) + known(2))
    }

    /// Measures the bias about one axis by the gyroscope at rest.
    fn measure_bias(&mut self, axis: usize) {
        let Cycle { dt_s, gyro, .. } = self.complete;
        let off = gyro * (1.0 / dt_s) - self.bias;
        let off = <[f32; 3]>::from(off)[axis];
        self.correct(BIAS + axis, off, REST_NOISE * REST_NOISE / dt_s);
    }

    /// Corrects all states by the measurement of one: `off` is what the measurement adds to its present value.
    #[inline(never)]
    fn correct(&mut self, state: usize, off: f32, noise: f32) {
        let gains = self.covariance.correct(state, noise);
        let change = |state: usize| gains[state] * off;
        let changes = |first: usize| vec3(change(first), change(first + 1), change(first + 2));
        self.q = Quaternion::from_rotation_vector(changes(ATTITUDE)) * self.q;
        self.velocity[0] += change(VELOCITY);
        self.velocity[1] += change(VELOCITY + 1);
        let within = |v: Vec3<f32>, limit: f32| {
            let within = |x: f32| max(min(x, limit), -limit);
            vec3(within(v.x), within(v.y), within(v.z))
        };
        self.bias = within(self.bias + changes(BIAS), MAX_BIAS);
        self.scale = within(self.scale + changes(SCALE), 4.0 * FIRST_SCALE);
    }

    /// Takes a sample of the magnetometer. The first one sets the heading.
    #[inline(always)]
    fn take_field(&mut self, m: Vec3<f32>) {
        let field = self.q.rotate(m - self.magnetic.offset);
        self.field = Some(field);
        if !self.heading_set && field.x * field.x + field.y * field.y >= MIN_HORIZONTAL_FIELD_SQUARED {
            self.set_heading(field);
        }
    }

    #[cold]
    fn set_heading(&mut self, field: Vec3<f32>) {
        self.turn(-self.heading_error(field));
        self.heading_set = true;
        self.covariance.set(ATTITUDE + 2, FIELD_HEADING * FIELD_HEADING);
        self.field = None;
        self.field_dt_s = 0.0;
    }

    /// Turns attitude and velocity about the vertical by an angle, rad.
    fn turn(&mut self, angle: f32) {
        self.q = Quaternion::from_rotation_vector(vec3(0.0, 0.0, angle)) * self.q;
        let (sin, cos) = sin_cos(angle);
        let [north, east] = self.velocity;
        self.velocity = [cos * north - sin * east, sin * north + cos * east];
    }

    /// Returns the angle from north to the horizontal part of a field in world axes, rad.
    fn heading_error(&self, field: Vec3<f32>) -> f32 {
        wrap_pi(atan2(field.y, field.x) - self.declination_rad)
    }

    /// Corrects the heading, so that the horizontal field points to magnetic north, and estimates the field of the
    /// sensor.
    fn measure_heading(&mut self) {
        let Some(field) = self.field.take() else {
            return;
        };
        let dt_s = core::mem::take(&mut self.field_dt_s);
        let level_squared = field.x * field.x + field.y * field.y;
        // A measurement of less than a microsecond has a noise close to the largest number.
        if level_squared < MIN_HORIZONTAL_FIELD_SQUARED || dt_s < 1.0e-6 {
            return;
        }
        let level = sqrt(level_squared);
        let (weight, [level_off, vertical_off]) =
            self.magnetic.update(level, field.z, self.age_s < FORCE_S, dt_s);
        if weight < 1.0e-3 {
            return;
        }
        let noise = self.params.heading_noise_rad;
        // A tilt error θ turns the horizontal field by θ tan(dip). It lasts much longer than a cycle, so that it does not
        // average out.
        let dip = field.z / level;
        let tilt = self.covariance.variance(ATTITUDE) + self.covariance.variance(ATTITUDE + 1);
        let noise = noise * noise / (weight * dt_s) + dip * dip * tilt;
        self.correct(ATTITUDE + 2, -self.heading_error(field), noise);
        let turning_squared = self.complete.rate_squared / self.complete.dt_s;
        if turning_squared > OFFSET_RATE * OFFSET_RATE {
            // The difference between the field and its means, which point to magnetic north.
            let level = level - level_off;
            let (sin, cos) = self.declination_sc;
            let residual = vec3(field.x - level * cos, field.y - level * sin, vertical_off);
            self.magnetic.learn_offset(self.q.conjugate().rotate(residual), weight * dt_s);
        }
    }
}

impl Filter for RobustFilter {
    const INPUT: FilterInput = FilterInput::Calibrated;

    // Not inlined: inside the step of the flight controller it would cost the other filters registers.
    #[inline(never)]
    fn update(&mut self, gyro: Vec3<f32>, accel: Vec3<f32>, mag: Option<Vec3<f32>>, dt_s: f32) {
        // A comparison with NaN is false, so NaN is rejected.
        let plausible = gyro.dot(gyro) < MAX_RATE * MAX_RATE
            && accel.dot(accel) < MAX_SPECIFIC_FORCE * MAX_SPECIFIC_FORCE;
        if !plausible {
            return;
        }
        let dt_s = if dt_s > 0.0 { min(dt_s, MAX_DT_S) } else { 0.0 };
        if !self.started {
            self.start(gyro, accel, dt_s);
        } else if dt_s > 0.0 {
            self.predict(gyro, accel, dt_s);
        }
        self.field_dt_s = min(self.field_dt_s + dt_s, MAX_DT_S);
        match mag {
            Some(field) if field.dot(field) < MAX_FIELD * MAX_FIELD && self.started => self.take_field(field),
            _ => {}
        }
        self.work(dt_s);
    }

    fn on_gyro_zeroed(&mut self) {
        // The standard deviation that the random walk and the noise at rest leave: √(0.17 · 0.005) = 0.03 °/s.
        const ZEROED: f32 = REST_NOISE * BIAS_WALK;
        self.bias = Vec3::ZERO;
        for axis in 0..3 {
            self.covariance.set(BIAS + axis, ZEROED);
        }
        self.detects_rest = false;
        self.rest.interrupt();
    }

    fn restart(&mut self) {
        *self = Self::new(self.params, self.declination_rad);
    }

    fn started(&self) -> bool {
        self.started
    }

    #[inline(always)]
    fn down(&self) -> Vec3<f32> {
        self.q.down()
    }

    #[inline(always)]
    fn attitude(&self) -> Quaternion<f32> {
        self.q
    }

    #[inline(always)]
    fn gyro_bias(&self) -> Vec3<f32> {
        self.bias
    }
}

fn first_covariance() -> Covariance {
    let first = [
        FIRST_TILT,
        FIRST_TILT,
        FIRST_HEADING,
        FIRST_VELOCITY,
        FIRST_VELOCITY,
        FIRST_BIAS,
        FIRST_BIAS,
        FIRST_BIAS,
        FIRST_SCALE,
        FIRST_SCALE,
        FIRST_SCALE,
    ];
    Covariance::diagonal(first.map(|deviation| deviation * deviation))
}

/// Returns the shortest rotation that brings −f to the vertical.
fn level(f: Vec3<f32>) -> Quaternion<f32> {
    let down = f * (-1.0 / f.norm());
    // (1 + cos, sin · axis) is twice the quaternion times the cosine of the half angle. Upside down every horizontal
    // axis is equivalent.
    let q = Quaternion::new(1.0 + down.z, down.y, -down.x, 0.0);
    if q.norm_squared() > 1.0e-6 { q.normalized() } else { Quaternion::new(0.0, 1.0, 0.0, 0.0) }
}

#[cfg(all(test, not(miri)))] // thousands of samples through two filters: minutes for each test under Miri
mod tests;
