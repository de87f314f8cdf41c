//! An attitude filter that also estimates its disturbances: gyroscope bias, acceleration, and two kinds of magnetic
//! disturbance.
//!
//! ```text
//!  ω ─(− b)──► rotate q ─┬─► world: f/g ──► low-pass ──► tilt error ──┬──► correction, 1/τ ──► q
//!                        │                                            └──► b, with gain P/R
//!                        └─► world: m − o ──► known field? ─┬──► heading error ──► as the tilt error
//!                                                           └──► o, the field of the sensor, while turning
//! ```
//!
//! **Acceleration.** In world axes the mean of f = a − g over a time T is Δv/T − g, for any motion of the vehicle.
//! Averaged in world axes, acceleration therefore cancels by itself as long as the speed stays bounded, also in free
//! flight, where no single sample shows the tilt. (Mahony et al. 2008 average in body axes; averaging in a nearly
//! inertial frame is from Laidig and Seel, *VQF*, Information Fusion 91, 2023.) The low-pass is the first half of the
//! loop, the correction the second. With θ the tilt error, l the low-passed tilt error, a the horizontal acceleration
//! and β the remaining bias,
//!
//! l̇ = (θ + a/g − l) · 2/τ,  θ̇ = β − l/τ,  so  θ = −(a/g) · 2/(s²τ² + 2sτ + 2) + β (s τ² + 2τ)/(s²τ² + 2sτ + 2):
//!
//! This is a Butterworth low-pass with ω₀ = √2/τ from a/g to θ; a constant bias causes a final error of τ times the
//! bias. A step of the speed by Δv changes θ by no more than the peak of the impulse response, 2/τ · e^(−π/4)
//! sin(π/4) = 0.645/τ: 0.645 Δv/(g τ).
//!
//! After the start, age²/τ replaces τ until the age of the filter reaches τ.
//!
//! **Bias.** After the start, the mean correction rate is the bias. Three scalar variances P weight the correction:
//! the filter is a Kalman filter for a bias with a random walk of [`BIAS_WALK`], observed through white noise of
//! [`MOVING_NOISE`], or of [`REST_NOISE`] when the sensor is at rest and the gyroscope itself is the measurement.
//! Tilt contains no information about a bias about the vertical, and heading only about that one: P decreases only in
//! the observed directions. The low-passed tilt error belongs to the orientations of the body over the time of the
//! low-pass. The directions of the body axes therefore pass through the same low-pass (VQF does the same). With the
//! present directions instead, the tilt error of a tumbling body would change the bias with the wrong sign, and both
//! would diverge within half an hour.
//!
//! **Magnetic field.** A field whose horizontal and vertical parts differ from their means over the last
//! [`FIELD_TAU_S`] by more than [`FIELD_TOLERANCE`] of its strength does not correct the heading (the test of VQF, in
//! other coordinates). A field that lasts for [`NEW_FIELD_S`] is accepted as the field of a new place. A field that
//! rotates with the sensor is not a disturbance but a change of its calibration: it is the part of the field that is
//! not constant in the world, and is estimated slowly while the sensor turns.

use super::at_rest::MAX_BIAS;
use super::{Filter, MIN_HORIZONTAL_FIELD_SQUARED, MIN_SPECIFIC_FORCE_SQUARED, Setting};
use crate::STANDARD_GRAVITY;
use crate::arithmetic::{atan2, max, min, sin_cos, sqrt, wrap_pi};
use crate::geometry::{Quaternion, Vec3, vec3};

/// rad/°.
const DEGREE: f32 = core::f32::consts::PI / 180.0;

/// Limits of valid readings: 11,000 °/s (rad/s), 100 g (m/s²), 200 times the Earth's field (µT). Readings within them
/// cause no overflow below.
const MAX_RATE: f32 = 200.0;
const MAX_SPECIFIC_FORCE: f32 = 1.0e3;
const MAX_FIELD: f32 = 1.0e4;
/// Longest time between two samples that is integrated, s.
const MAX_DT_S: f32 = 1.0;

/// Standard deviation of the bias at the start, rad/s.
const FIRST_BIAS: f32 = 3.0 * DEGREE;
/// Random walk of the bias, rad/s/√s: 0.2 °/s in 100 s, as of a chip with 0.01 to 0.02 °/s/K that warms up by 10 to
/// 20 K.
const BIAS_WALK: f32 = 0.02 * DEGREE;
/// Noise of the bias measurement at rest, rad/s/√Hz. With the random walk it gives a time constant of 0.1/0.02 = 5 s
/// and a standard deviation of √(0.1 · 0.02) = 0.045 °/s.
const REST_NOISE: f32 = 0.1 * DEGREE;
/// Noise of the bias measurement in motion, rad/s/√Hz: a time constant of 0.5/0.02 = 25 s and √(0.5 · 0.02) =
/// 0.1 °/s. A tilt error that varies by σ over τ is a noise of σ √(2/τ): 0.5 for σ = 0.8° and 5 s.
const MOVING_NOISE: f32 = 0.5 * DEGREE;
/// Largest share of the correction that changes the bias, s⁻¹, times τ. The loop of l, θ and b with gain k has the
/// polynomial s³τ²/2 + s²τ + s + k, which is stable for k < 2/τ (Routh); this limit is nearly 6 times lower.
const MAX_LEARNING: f32 = 0.35;
/// Largest tilt error that counts as caused by a bias, in g (17°). A larger one is a start with a wrong attitude, or
/// a manoeuvre.
const MAX_BIAS_TILT_ERROR: f32 = 0.3;

/// The sensor is at rest while its readings, smoothed over [`REST_FAST_S`], have differed from their means over
/// [`REST_SLOW_S`] by less than these for [`REST_FOR_S`], rad/s and m/s². The smoothing makes the test the same at
/// any sample rate: a noise density N leaves N/√(4 · 0.02 s), 0.11 °/s for the noisiest axis of the paper. A steady
/// turn at ω about a horizontal axis changes the specific force by gω per second, so that it leads its mean by gω ·
/// 0.5 s: the test detects a turn above 2.3 °/s.
const REST_RATE: f32 = 2.0 * DEGREE;
const REST_FORCE: f32 = 0.2;
const REST_FAST_S: f32 = 0.02;
const REST_SLOW_S: f32 = 0.5;
const REST_FOR_S: f32 = 1.5;
/// A steady rate counts as a slow turn if its difference from the estimated bias exceeds this value plus three standard
/// deviations, rad/s.
const REST_BIAS_CHANGE: f32 = 1.0 * DEGREE;

/// Averaging time of the horizontal and vertical part of the field, s.
const FIELD_TAU_S: f32 = 20.0;
/// Minimum age of these means after the first sample, which covers no time, s.
const MIN_AGE_S: f32 = 1.0e-3;
/// Largest deviation of the field from its means, as a share of its strength.
const FIELD_TOLERANCE: f32 = 0.1;
/// Time after which a deviating field is accepted as the new one, s.
const NEW_FIELD_S: f32 = 60.0;
/// Time constant of the estimate of the field of the sensor itself, s, and the smallest rate for the estimate, rad/s
/// (23 °/s): without rotation this field cannot be distinguished from the field of the world.
const OFFSET_TAU_S: f32 = 20.0;
const OFFSET_RATE: f32 = 0.4;
/// Largest estimate per axis, µT: a fifth of the Earth's field. A larger offset needs a calibration.
const MAX_OFFSET: f32 = 10.0;

/// The time constants of [`RobustFilter`]. Its other constants are properties of sensors and of the Earth's field.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct RobustParams {
    /// Time constant τ of the tilt, s: 0.1 to 100. The gyroscope dominates above 1/(√2 π τ) Hz, the accelerometer
    /// below. With steps longer than τ the correction overshoots.
    pub tilt_tau_s: f32,
    /// Time constant τ of the heading, s: 0.1 to 1,000.
    pub heading_tau_s: f32,
}

impl RobustParams {
    pub(super) fn settings(&mut self) -> [Setting<'_>; 2] {
        [
            Setting::new("estimator.tilt_tau_s", &mut self.tilt_tau_s, 0.1, 100.0),
            Setting::new("estimator.heading_tau_s", &mut self.heading_tau_s, 0.1, 1.0e3),
        ]
    }
}

/// The filter: quaternion, tilt error, bias and magnetic field. See the module documentation.
#[derive(Clone, Copy, Debug)]
pub struct RobustFilter {
    q: Quaternion<f32>,
    params: RobustParams,
    declination_rad: f32,
    /// Sine and cosine of the declination.
    declination_sc: (f32, f32),
    detects_rest: bool,
    tilt_started: bool,
    /// Time since the first sample, s, counted up to τ.
    tilt_age_s: f32,
    /// Low-passed horizontal specific force in world axes, north and east, in g: in the mean the tilt error.
    tilt_error: [f32; 2],
    /// World north and east in body axes after the same low-pass: the directions from which a bias enters the tilt
    /// error.
    mean_horizontal: [Vec3<f32>; 2],
    /// Down in body axes, low-passed with the time constant of the heading.
    mean_down: Vec3<f32>,
    /// Bias of the gyroscope, rad/s, body axes.
    bias: Vec3<f32>,
    /// Variance of the bias per axis, (rad/s)².
    variance: Vec3<f32>,
    rest: RestDetector,
    magnetic: MagneticField,
}

impl RobustFilter {
    pub(super) fn new(params: RobustParams, declination_rad: f32) -> Self {
        const FIRST: f32 = FIRST_BIAS * FIRST_BIAS;
        Self {
            params,
            declination_rad,
            declination_sc: sin_cos(declination_rad),
            detects_rest: true,
            q: Quaternion::IDENTITY,
            tilt_started: false,
            tilt_age_s: 0.0,
            tilt_error: [0.0; 2],
            mean_horizontal: [Vec3::ZERO; 2],
            mean_down: Vec3::ZERO,
            bias: Vec3::ZERO,
            variance: vec3(FIRST, FIRST, FIRST),
            rest: RestDetector::default(),
            magnetic: MagneticField::default(),
        }
    }

    /// Sets the attitude to the shortest rotation that brings −f to the vertical.
    #[cold]
    fn start(&mut self, gyro: Vec3<f32>, f: Vec3<f32>) {
        if f.dot(f) < MIN_SPECIFIC_FORCE_SQUARED {
            return;
        }
        self.rest = RestDetector::from(gyro, f);
        let down = f * (-1.0 / f.norm());
        // (1 + cos, sin · axis) is twice the quaternion times the cosine of the half angle. Upside down every
        // horizontal axis is equivalent.
        let q = Quaternion::new(1.0 + down.z, down.y, -down.x, 0.0);
        self.q = if q.norm_squared() > 1.0e-6 { q.normalized() } else { Quaternion::new(0.0, 1.0, 0.0, 0.0) };
        self.tilt_started = true;
    }

    /// Predicts the attitude with the gyroscope, and corrects it by the tilt error.
    #[inline(always)]
    fn update_tilt(&mut self, gyro: Vec3<f32>, accel: Vec3<f32>, dt_s: f32) {
        let rates = gyro - self.bias;
        self.q = self.q * Quaternion::from_rotation_vector(rates * dt_s);
        let [now_north, now_east] = horizontal_force(self.q.rotate(accel) * (1.0 / STANDARD_GRAVITY));

        // While the age is less than τ, age²/τ replaces τ. An unknown bias then causes an error of at most a fifth of
        // the age times the bias, and not of the whole age times the bias; the noise is still averaged over that
        // time.
        let tau_s = self.params.tilt_tau_s;
        let settled = self.tilt_settled();
        let tau_s = if settled {
            tau_s
        } else {
            self.tilt_age_s += dt_s;
            min(tau_s, self.tilt_age_s * self.tilt_age_s / tau_s + 2.0 * dt_s)
        };
        let share = dt_s / (0.5 * tau_s + dt_s);
        let [north, east] = &mut self.tilt_error;
        *north += share * (now_north - *north);
        *east += share * (now_east - *east);
        // The rotation δ must cancel the tilt error: δ × (0, 0, −1) = (−δ_y, δ_x, 0).
        let (north, east) = (*north, *east);
        let [x, y, z] = self.q.to_matrix().rows;
        let [mean_x, mean_y] = &mut self.mean_horizontal;
        *mean_x += (x - *mean_x) * share;
        *mean_y += (y - *mean_y) * share;
        self.mean_down += (z - self.mean_down) * (dt_s / (self.params.heading_tau_s + dt_s));
        let (mean_x, mean_y) = (*mean_x, *mean_y);
        let share = dt_s / tau_s;
        self.q = self.q * Quaternion::from_rotation_vector(y * (share * north) - x * (share * east));

        self.variance += vec3(1.0, 1.0, 1.0) * (BIAS_WALK * BIAS_WALK * dt_s);
        if self.detects_rest && self.rest.update(gyro, accel, dt_s) {
            self.learn_at_rest(rates, dt_s);
        } else if settled && north * north + east * east < MAX_BIAS_TILT_ERROR * MAX_BIAS_TILT_ERROR {
            let correction = mean_y * (share * north) - mean_x * (share * east);
            self.learn(correction, mean_x.scale_by(mean_x) + mean_y.scale_by(mean_y), dt_s);
        }
    }

    #[inline(always)]
    fn tilt_settled(&self) -> bool {
        self.tilt_age_s >= self.params.tilt_tau_s
    }

    /// Updates the bias at rest, where the gyroscope measures it directly.
    fn learn_at_rest(&mut self, rates: Vec3<f32>, dt_s: f32) {
        let change = self.rest.slow_gyro - self.bias;
        let Vec3 { x, y, z } = self.variance;
        if change.dot(change) > REST_BIAS_CHANGE * REST_BIAS_CHANGE + 9.0 * (x + y + z) {
            return;
        }
        let noise = REST_NOISE * REST_NOISE / dt_s;
        let gain = |p: f32| p / (p + noise);
        let gains = vec3(gain(x), gain(y), gain(z));
        self.set_bias(self.bias + rates.scale_by(gains));
        self.variance = self.variance.scale_by(vec3(1.0, 1.0, 1.0) - gains);
    }

    /// Updates the bias with a share of `correction` (rad, body axes), which was needed after `dt_s` (s): the
    /// correction cancels the rotation that the bias has caused. `observed` is the squared component of each axis in
    /// the observed directions.
    #[inline(always)]
    fn learn(&mut self, correction: Vec3<f32>, observed: Vec3<f32>, dt_s: f32) {
        const INFORMATION: f32 = 1.0 / (MOVING_NOISE * MOVING_NOISE);
        let max_gain = MAX_LEARNING / self.params.tilt_tau_s;
        let Vec3 { x, y, z } = self.variance;
        let gain = |p: f32| min(p * INFORMATION, max_gain);
        self.set_bias(self.bias - correction.scale_by(vec3(gain(x), gain(y), gain(z))));
        // P is limited to its value at the start.
        let reduced = |p: f32, observed: f32| {
            min(p / (1.0 + p * observed * (INFORMATION * dt_s)), FIRST_BIAS * FIRST_BIAS)
        };
        self.variance = vec3(reduced(x, observed.x), reduced(y, observed.y), reduced(z, observed.z));
    }

    #[inline(always)]
    fn set_bias(&mut self, bias: Vec3<f32>) {
        let within = |b: f32| max(min(b, MAX_BIAS), -MAX_BIAS);
        self.bias = vec3(within(bias.x), within(bias.y), within(bias.z));
    }

    /// Corrects the heading about the vertical so that the horizontal field points to magnetic north. Makes no
    /// correction if strength and dip of the field differ too much from their means: see [`FIELD_TOLERANCE`].
    #[inline(always)]
    fn correct_heading(&mut self, gyro: Vec3<f32>, m: Vec3<f32>) {
        let field = self.q.rotate(m - self.magnetic.offset);
        let dt_s = core::mem::take(&mut self.magnetic.mag_dt_s);
        let level_squared = field.x * field.x + field.y * field.y;
        if level_squared < MIN_HORIZONTAL_FIELD_SQUARED {
            return;
        }
        // While the tilt settles, its changes alter the parts of the field: this is no disturbance.
        let tolerance = if self.tilt_settled() { FIELD_TOLERANCE } else { f32::INFINITY };
        let Some((level_deviation, vertical_deviation)) =
            self.magnetic.deviation(sqrt(level_squared), field.z, tolerance, dt_s)
        else {
            return;
        };
        let heading_error = wrap_pi(atan2(field.y, field.x) - self.declination_rad);
        let tau_s = self.params.heading_tau_s;
        let settled = self.magnetic.heading_age_s >= tau_s;
        // The first sample sets the heading.
        let share =
            if self.magnetic.heading_age_s > 0.0 { dt_s / (self.magnetic.heading_age_s + dt_s) } else { 1.0 };
        if !settled {
            self.magnetic.heading_age_s = max(self.magnetic.heading_age_s + dt_s, MIN_AGE_S);
        }
        let correction = -share * heading_error;
        self.q = Quaternion::from_rotation_vector(vec3(0.0, 0.0, correction)) * self.q;
        if !settled {
            return;
        }
        if !self.rest.at_rest() {
            let d = self.mean_down;
            self.learn(d * correction, d.scale_by(d), dt_s);
        }
        let rates = gyro - self.bias;
        if rates.dot(rates) > OFFSET_RATE * OFFSET_RATE {
            // The difference between the field and its means, which point to magnetic north.
            let level = sqrt(level_squared) - level_deviation;
            let (sin, cos) = self.declination_sc;
            let residual = vec3(field.x - level * cos, field.y - level * sin, vertical_deviation);
            self.magnetic.learn_offset(self.q.conjugate().rotate(residual), dt_s);
        }
    }
}

impl Filter for RobustFilter {
    const IS_LOW_PASS: bool = true;

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
        if !self.tilt_started {
            self.start(gyro, accel);
        } else if dt_s > 0.0 {
            self.update_tilt(gyro, accel, dt_s);
        }
        self.magnetic.mag_dt_s = min(self.magnetic.mag_dt_s + dt_s, MAX_DT_S);
        match mag {
            Some(field) if field.dot(field) < MAX_FIELD * MAX_FIELD => self.correct_heading(gyro, field),
            _ => {}
        }
        // One Newton step for 1/√n at n = 1. The rounding of a step leaves n within 1e-6 of 1; the Newton step
        // squares this error.
        self.q = self.q.scaled(1.5 - 0.5 * self.q.norm_squared());
    }

    fn on_gyro_zeroed(&mut self) {
        const ZEROED: f32 = REST_NOISE * BIAS_WALK;
        self.bias = Vec3::ZERO;
        self.variance = vec3(ZEROED, ZEROED, ZEROED);
        self.detects_rest = false;
        self.rest.still_s = 0.0;
    }

    fn restart(&mut self) {
        *self = Self::new(self.params, self.declination_rad);
    }

    fn started(&self) -> bool {
        self.tilt_started
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

/// Returns the horizontal part of a specific force in world axes, in g. Free fall gives zero. A force that points
/// down by more than half a g shows that the estimate is upside down, and gives 1 g in its horizontal direction.
#[inline(always)]
fn horizontal_force(f: Vec3<f32>) -> [f32; 2] {
    let squared = f.x * f.x + f.y * f.y;
    if f.z > 0.5 {
        let side = sqrt(squared);
        return if side > 0.05 { [f.x / side, f.y / side] } else { [1.0, 0.0] };
    }
    if squared + f.z * f.z < MIN_SPECIFIC_FORCE_SQUARED / (STANDARD_GRAVITY * STANDARD_GRAVITY) {
        return [0.0; 2];
    }
    [f.x, f.y]
}

/// Detector of rest, from the readings of the sensor.
#[derive(Clone, Copy, Debug, Default)]
struct RestDetector {
    fast_gyro: Vec3<f32>,
    fast_accel: Vec3<f32>,
    slow_gyro: Vec3<f32>,
    slow_accel: Vec3<f32>,
    /// Duration of the present rest, s, counted up to [`REST_FOR_S`].
    still_s: f32,
}

impl RestDetector {
    fn from(gyro: Vec3<f32>, accel: Vec3<f32>) -> Self {
        Self { fast_gyro: gyro, fast_accel: accel, slow_gyro: gyro, slow_accel: accel, still_s: 0.0 }
    }

    #[inline(always)]
    fn update(&mut self, gyro: Vec3<f32>, accel: Vec3<f32>, dt_s: f32) -> bool {
        let (fast, slow) = (dt_s / (REST_FAST_S + dt_s), dt_s / (REST_SLOW_S + dt_s));
        self.fast_gyro += (gyro - self.fast_gyro) * fast;
        self.fast_accel += (accel - self.fast_accel) * fast;
        let gyro_off = self.fast_gyro - self.slow_gyro;
        let accel_off = self.fast_accel - self.slow_accel;
        self.slow_gyro += gyro_off * slow;
        self.slow_accel += accel_off * slow;
        let still = gyro_off.dot(gyro_off) < REST_RATE * REST_RATE
            && accel_off.dot(accel_off) < REST_FORCE * REST_FORCE
            && self.slow_gyro.dot(self.slow_gyro) < MAX_BIAS * MAX_BIAS;
        self.still_s = if still { min(self.still_s + dt_s, REST_FOR_S) } else { 0.0 };
        self.at_rest()
    }

    fn at_rest(&self) -> bool {
        self.still_s >= REST_FOR_S
    }
}

/// Model of the magnetic field: its means, how long it has deviated, and the field of the sensor itself.
#[derive(Clone, Copy, Debug, Default)]
struct MagneticField {
    /// Time since the last sample of the magnetometer, s.
    mag_dt_s: f32,
    /// Means of the horizontal and vertical part of the field, µT, and their age, s, counted up to [`FIELD_TAU_S`].
    level: f32,
    vertical: f32,
    mean_s: f32,
    /// Time for which the field has corrected the heading, s, counted up to the time constant.
    heading_age_s: f32,
    /// Time for which the field has deviated, s.
    deviating_s: f32,
    /// Field of the sensor itself, µT, body axes.
    offset: Vec3<f32>,
}

impl MagneticField {
    /// Updates the means with the horizontal and vertical part of a field, µT. Returns the deviations from the means,
    /// µT, or `None` for a field that deviates too much.
    #[inline(always)]
    fn deviation(&mut self, level: f32, vertical: f32, tolerance: f32, dt_s: f32) -> Option<(f32, f32)> {
        let off = (level - self.level, vertical - self.vertical);
        let strength = self.level * self.level + self.vertical * self.vertical;
        let deviates = off.0 * off.0 + off.1 * off.1 > tolerance * tolerance * strength;
        if self.mean_s > 0.0 && deviates {
            self.deviating_s += dt_s;
            if self.deviating_s < NEW_FIELD_S {
                return None;
            }
            self.mean_s = 0.0;
        }
        self.deviating_s = 0.0;
        if self.mean_s == 0.0 {
            (self.level, self.vertical) = (level, vertical);
        }
        self.mean_s = min(max(self.mean_s + dt_s, MIN_AGE_S), FIELD_TAU_S);
        let off = (level - self.level, vertical - self.vertical);
        let share = min(dt_s / self.mean_s, 1.0);
        self.level += share * off.0;
        self.vertical += share * off.1;
        Some(off)
    }

    #[inline(always)]
    fn learn_offset(&mut self, residual: Vec3<f32>, dt_s: f32) {
        let learnt = self.offset + residual * (dt_s / OFFSET_TAU_S);
        let within = |o: f32| max(min(o, MAX_OFFSET), -MAX_OFFSET);
        self.offset = vec3(within(learnt.x), within(learnt.y), within(learnt.z));
    }
}

#[cfg(all(test, not(miri)))] // thousands of samples through two filters: minutes for each test under Miri
mod tests;
