//! A filter that estimates what disturbs it: gyroscope bias, acceleration, and two kinds of magnetic field.
//!
//! ```text
//!  ω ─(− b)──► turn q ──┬──► world: f/g ──► low-pass ──► lean ──┬──► turn back, 1/τ ──► q
//!                       │                                       └──► b, at P/R of it
//!                       └──► world: m − o ──► like before? ──► heading off north ──► as lean
//!                                                          └──► o, the sensor's own field, while turning
//! ```
//!
//! **Acceleration.** In world axes the mean of f = a − g over a time T is Δv/T − g, whatever the vehicle did
//! meanwhile: averaged *there*, acceleration goes away by itself as long as the speed stays bounded, in free
//! flight too, where no single sample shows the tilt (Mahony et al. 2008 average in the body; that the mean
//! belongs into a nearly inertial frame is from Laidig and Seel, *VQF*, Information Fusion 91, 2023). The
//! low-pass is the first half of the loop, and the turning back the other. With θ the tilt error, l the lean,
//! a the horizontal acceleration and β what is left of the bias,
//!
//! l̇ = (θ + a/g − l) · 2/τ,  θ̇ = β − l/τ,  so  θ = −(a/g) · 2/(s²τ² + 2sτ + 2) + β (s τ² + 2τ)/(s²τ² + 2sτ + 2):
//!
//! a Butterworth low-pass of ω₀ = √2/τ from a/g to θ, and τ of the bias in the end. A jump of speed by Δv moves θ
//! by no more than the peak of its impulse response, 2/τ · e^(−π/4) sin(π/4) = 0.645/τ: 0.645 Δv/(g τ).
//!
//! Where it starts from, age²/τ takes the place of τ until the filter is τ old.
//!
//! **Bias.** What it takes in turning back, once the start is over, is the bias in the end. Three scalar
//! variances P weigh it: the filter is Kalman's for a bias that walks by [`BIAS_WALK`] and is seen through
//! white noise of [`MOVING_NOISE`], or of [`REST_NOISE`] when the sensor lies still and the gyroscope itself is
//! the measurement. Tilt says nothing of a bias about the vertical, heading of nothing else: P shrinks only in
//! the directions that were seen. What has come through a low-pass comes from where the body's axes were meanwhile: they
//! go through the same one (VQF does likewise). Taken for where they are now, the lean of a body that tumbles feeds
//! its bias the wrong way round, and after half an hour the two have run away together.
//!
//! **Magnetic field.** A field whose level and vertical parts differ from those of the last
//! [`FIELD_TAU_S`] by more than [`FIELD_TOLERANCE`] of its strength turns nothing (the test of VQF, in other
//! coordinates). One that lasts [`NEW_PLACE_S`] is the new place's. An offset that turns with the sensor is
//! no disturbance but a calibration that has moved on: it shows as the part of the field that doesn't stay
//! in the world, and is learnt slowly while the sensor turns.

use super::at_rest::MAX_BIAS;
use super::{Filter, MIN_HORIZONTAL_FIELD_SQUARED, MIN_SPECIFIC_FORCE_SQUARED, Setting};
use crate::STANDARD_GRAVITY;
use crate::arithmetic::{atan2, max, min, sin_cos, sqrt, wrap_pi};
use crate::geometry::{Quaternion, Vec3, vec3};

/// rad/°.
const DEGREE: f32 = core::f32::consts::PI / 180.0;

/// Readings beyond these are no readings: 11,000 °/s, 100 g, 200 times the Earth's field. What is within them
/// overflows nowhere below.
const MAX_RATE: f32 = 200.0;
const MAX_SPECIFIC_FORCE: f32 = 1.0e3;
const MAX_FIELD: f32 = 1.0e4;
/// Longest time between two samples that is integrated, s.
const MAX_DT_S: f32 = 1.0;

/// What is not known of the bias at first, rad/s.
const FIRST_BIAS: f32 = 3.0 * DEGREE;
/// Random walk of the bias, rad/s/√s: 0.2 °/s in 100 s, what a chip of 0.01 to 0.02 °/s/K does while it warms up by
/// 10 to 20 K.
const BIAS_WALK: f32 = 0.02 * DEGREE;
/// Noise of the bias as rest shows it, rad/s/√Hz: with the walk a time constant of 0.1/0.02 = 5 s, and a
/// deviation of √(0.1 · 0.02) = 0.045 °/s.
const REST_NOISE: f32 = 0.1 * DEGREE;
/// Noise of the bias as motion shows it, rad/s/√Hz: 0.5/0.02 = 25 s and √(0.5 · 0.02) = 0.1 °/s. A lean that
/// wanders by σ over τ makes σ √(2/τ) of it: 0.5 for σ = 0.8° and 5 s.
const MOVING_NOISE: f32 = 0.5 * DEGREE;
/// Largest share of a turn back that goes into the bias, s⁻¹, times τ. The loop l, θ, b has the polynomial
/// s³τ²/2 + s²τ + s + k, stable for k < 2/τ (Routh); this stays nearly 6 times below.
const MAX_LEARNING: f32 = 0.35;
/// A lean beyond this (17°) is a start from a wrong attitude, or a manoeuvre, not a bias.
const MAX_BIAS_LEAN: f32 = 0.3;

/// The sensor is at rest while its readings, smoothed over [`REST_FAST_S`], are this near to their means over
/// [`REST_SLOW_S`] for [`REST_FOR_S`]; rad/s, m/s². The smoothing makes the test the same at any rate: a
/// noise of N has N/√(4 · 0.02 s) behind it, the paper's noisiest axis 0.11 °/s. A steady turn by ω moves the
/// specific force by gω a second and it goes ahead of its mean by gω · 0.5 s: above 2.3 °/s it is seen, about a
/// level axis.
const REST_RATE: f32 = 2.0 * DEGREE;
const REST_FORCE: f32 = 0.2;
const REST_FAST_S: f32 = 0.02;
const REST_SLOW_S: f32 = 0.5;
const REST_FOR_S: f32 = 1.5;
/// A steady rate that is further than this (and three deviations) from the known bias is a slow turn, rad/s.
const REST_BIAS_CHANGE: f32 = 1.0 * DEGREE;

/// The field's parts are means over this, s.
const FIELD_TAU_S: f32 = 20.0;
/// A first sample has no time before it, and makes the mean this old all the same, s.
const MIN_AGE_S: f32 = 1.0e-3;
/// Share of the field's strength by which it may differ from its means.
const FIELD_TOLERANCE: f32 = 0.1;
/// A field that has been another for so long is the new one, s.
const NEW_PLACE_S: f32 = 60.0;
/// The sensor's own field is learnt over this, s, and only while it turns faster than the rate (rad/s, 23 °/s):
/// without a turn it can't be told from the world's.
const OFFSET_TAU_S: f32 = 20.0;
const OFFSET_RATE: f32 = 0.4;
/// Most that is learnt on an axis, µT, a fifth of the Earth's field. More is for a calibration.
const MAX_OFFSET: f32 = 10.0;

/// The time constants of [`RobustFilter`]. What else it holds are figures of sensors and of the Earth's field.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct RobustParams {
    /// τ of the tilt, s: the gyroscope above 1/(√2 π τ) Hz, the accelerometer below. In steps longer than τ more is
    /// turned back than there is to turn.
    pub tilt_tau_s: f32,
    /// τ of the heading, s.
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

/// Quaternion, lean, bias and field; see the module.
#[derive(Clone, Copy, Debug)]
pub struct RobustFilter {
    q: Quaternion<f32>,
    params: RobustParams,
    declination_rad: f32,
    /// Sine and cosine of the declination.
    declination_sc: (f32, f32),
    looks_for_rest: bool,
    tilt_started: bool,
    /// Time since the first sample, s, counted up to τ.
    tilt_age_s: f32,
    /// Low-passed level specific force in world axes, north and east, in g: in the mean the tilt error.
    lean: [f32; 2],
    /// World north and east in body axes behind the same low-pass: where a bias in the lean came from.
    seen: [Vec3<f32>; 2],
    /// Down in body axes, low-passed as slowly as the heading is turned.
    seen_down: Vec3<f32>,
    /// rad/s, body.
    bias: Vec3<f32>,
    /// (rad/s)², by axis.
    variance: Vec3<f32>,
    rest: Rest,
    north: North,
}

impl RobustFilter {
    pub(super) fn new(params: RobustParams, declination_rad: f32) -> Self {
        const FIRST: f32 = FIRST_BIAS * FIRST_BIAS;
        Self {
            params,
            declination_rad,
            declination_sc: sin_cos(declination_rad),
            looks_for_rest: true,
            q: Quaternion::IDENTITY,
            tilt_started: false,
            tilt_age_s: 0.0,
            lean: [0.0; 2],
            seen: [Vec3::ZERO; 2],
            seen_down: Vec3::ZERO,
            bias: Vec3::ZERO,
            variance: vec3(FIRST, FIRST, FIRST),
            rest: Rest::default(),
            north: North::default(),
        }
    }

    /// The shortest rotation that brings −f to the vertical.
    #[cold]
    fn start(&mut self, gyro: Vec3<f32>, f: Vec3<f32>) {
        if f.dot(f) < MIN_SPECIFIC_FORCE_SQUARED {
            return;
        }
        self.rest = Rest::from(gyro, f);
        let down = f * (-1.0 / f.norm());
        // (1 + cos, sin · axis), twice the half angle's; upside down any level axis serves.
        let q = Quaternion::new(1.0 + down.z, down.y, -down.x, 0.0);
        self.q = if q.norm_squared() > 1.0e-6 { q.normalized() } else { Quaternion::new(0.0, 1.0, 0.0, 0.0) };
        self.tilt_started = true;
    }

    /// Predicts by the gyroscope, and turns back by the lean.
    #[inline(always)]
    fn turn(&mut self, gyro: Vec3<f32>, accel: Vec3<f32>, dt_s: f32) {
        let rates = gyro - self.bias;
        self.q = self.q * Quaternion::from_rotation_vector(rates * dt_s);
        let [u_north, u_east] = level(self.q.rotate(accel) * (1.0 / STANDARD_GRAVITY));

        // While the filter is younger than τ, age²/τ takes the place of τ: a bias that nobody knows yet turns
        // it for a fifth of its age at most, not for all of it, and the noise is a mean of that long all the same.
        let tau_s = self.params.tilt_tau_s;
        let settled = self.tilt_settled();
        let tau_s = if settled {
            tau_s
        } else {
            self.tilt_age_s += dt_s;
            min(tau_s, self.tilt_age_s * self.tilt_age_s / tau_s + 2.0 * dt_s)
        };
        let share = dt_s / (0.5 * tau_s + dt_s);
        let [north, east] = &mut self.lean;
        *north += share * (u_north - *north);
        *east += share * (u_east - *east);
        // δ × (0, 0, −1) = (−δ_y, δ_x, 0) is to take the lean away.
        let (north, east) = (*north, *east);
        let [x, y, z] = self.q.to_matrix().rows;
        let [seen_x, seen_y] = &mut self.seen;
        *seen_x += (x - *seen_x) * share;
        *seen_y += (y - *seen_y) * share;
        self.seen_down += (z - self.seen_down) * (dt_s / (self.params.heading_tau_s + dt_s));
        let (seen_x, seen_y) = (*seen_x, *seen_y);
        let share = dt_s / tau_s;
        self.q = self.q * Quaternion::from_rotation_vector(y * (share * north) - x * (share * east));

        self.variance += vec3(1.0, 1.0, 1.0) * (BIAS_WALK * BIAS_WALK * dt_s);
        if self.looks_for_rest && self.rest.lasts(gyro, accel, dt_s) {
            self.learn_at_rest(rates, dt_s);
        } else if settled && north * north + east * east < MAX_BIAS_LEAN * MAX_BIAS_LEAN {
            let back = seen_y * (share * north) - seen_x * (share * east);
            self.learn(back, seen_x.scale_by(seen_x) + seen_y.scale_by(seen_y), dt_s);
        }
    }

    #[inline(always)]
    fn tilt_settled(&self) -> bool {
        self.tilt_age_s >= self.params.tilt_tau_s
    }

    /// At rest the gyroscope reads the bias.
    fn learn_at_rest(&mut self, rates: Vec3<f32>, dt_s: f32) {
        let change = self.rest.slow_gyro - self.bias;
        let Vec3 { x, y, z } = self.variance;
        if change.dot(change) > REST_BIAS_CHANGE * REST_BIAS_CHANGE + 9.0 * (x + y + z) {
            return;
        }
        let noise = REST_NOISE * REST_NOISE / dt_s;
        let gain = |p: f32| p / (p + noise);
        let gains = vec3(gain(x), gain(y), gain(z));
        self.take_bias(self.bias + rates.scale_by(gains));
        self.variance = self.variance.scale_by(vec3(1.0, 1.0, 1.0) - gains);
    }

    /// Takes a share of `back` (rad, body), which was needed after `dt_s`, for bias: what the gyroscope turned too
    /// far had to be turned back. `seen` is the square of what each axis has of the directions that were looked at.
    #[inline(always)]
    fn learn(&mut self, back: Vec3<f32>, seen: Vec3<f32>, dt_s: f32) {
        const INFORMATION: f32 = 1.0 / (MOVING_NOISE * MOVING_NOISE);
        let most = MAX_LEARNING / self.params.tilt_tau_s;
        let Vec3 { x, y, z } = self.variance;
        let gain = |p: f32| min(p * INFORMATION, most);
        self.take_bias(self.bias - back.scale_by(vec3(gain(x), gain(y), gain(z))));
        // P is bounded by what was not known at first.
        let narrowed =
            |p: f32, seen: f32| min(p / (1.0 + p * seen * (INFORMATION * dt_s)), FIRST_BIAS * FIRST_BIAS);
        self.variance = vec3(narrowed(x, seen.x), narrowed(y, seen.y), narrowed(z, seen.z));
    }

    #[inline(always)]
    fn take_bias(&mut self, bias: Vec3<f32>) {
        let within = |b: f32| max(min(b, MAX_BIAS), -MAX_BIAS);
        self.bias = vec3(within(bias.x), within(bias.y), within(bias.z));
    }

    /// Turns the heading about the vertical until the level field lies along magnetic north, if it is the
    /// field of before.
    #[inline(always)]
    fn correct_heading(&mut self, gyro: Vec3<f32>, m: Vec3<f32>) {
        let field = self.q.rotate(m - self.north.offset);
        let dt_s = core::mem::take(&mut self.north.since_s);
        let level_squared = field.x * field.x + field.y * field.y;
        if level_squared < MIN_HORIZONTAL_FIELD_SQUARED {
            return;
        }
        // While the tilt settles it moves the field's parts: nothing strange.
        let tolerance = if self.tilt_settled() { FIELD_TOLERANCE } else { f32::INFINITY };
        let Some((level_excess, vertical_excess)) =
            self.north.excess(sqrt(level_squared), field.z, tolerance, dt_s)
        else {
            return;
        };
        let excess = wrap_pi(atan2(field.y, field.x) - self.declination_rad);
        let tau_s = self.params.heading_tau_s;
        let settled = self.north.age_s >= tau_s;
        // The first sample sets the heading.
        let share = if self.north.age_s > 0.0 { dt_s / (self.north.age_s + dt_s) } else { 1.0 };
        if !settled {
            self.north.age_s = max(self.north.age_s + dt_s, MIN_AGE_S);
        }
        let back = -share * excess;
        self.q = Quaternion::from_rotation_vector(vec3(0.0, 0.0, back)) * self.q;
        if !settled {
            return;
        }
        if !self.rest.lasting() {
            let d = self.seen_down;
            self.learn(d * back, d.scale_by(d), dt_s);
        }
        let rates = gyro - self.bias;
        if rates.dot(rates) > OFFSET_RATE * OFFSET_RATE {
            // What the field has more than its means, pointing north.
            let level = sqrt(level_squared) - level_excess;
            let (sin, cos) = self.declination_sc;
            let strange = vec3(field.x - level * cos, field.y - level * sin, vertical_excess);
            self.north.learn_offset(self.q.conjugate().rotate(strange), dt_s);
        }
    }
}

impl Filter for RobustFilter {
    const IS_A_LOW_PASS: bool = true;

    // A function of its own: inlined into the controller's step it would cost the other filters registers.
    #[inline(never)]
    fn update(&mut self, gyro: Vec3<f32>, accel: Vec3<f32>, mag: Option<Vec3<f32>>, dt_s: f32) {
        // A comparison with NaN is false.
        let plausible = gyro.dot(gyro) < MAX_RATE * MAX_RATE
            && accel.dot(accel) < MAX_SPECIFIC_FORCE * MAX_SPECIFIC_FORCE;
        if !plausible {
            return;
        }
        let dt_s = if dt_s > 0.0 { min(dt_s, MAX_DT_S) } else { 0.0 };
        if !self.tilt_started {
            self.start(gyro, accel);
        } else if dt_s > 0.0 {
            self.turn(gyro, accel, dt_s);
        }
        self.north.since_s = min(self.north.since_s + dt_s, MAX_DT_S);
        match mag {
            Some(field) if field.dot(field) < MAX_FIELD * MAX_FIELD => self.correct_heading(gyro, field),
            _ => {}
        }
        // One Newton step for 1/√n at n = 1: a step's rounding leaves n within 1e-6 of 1, which it squares.
        self.q = self.q.scaled(1.5 - 0.5 * self.q.norm_squared());
    }

    fn gyro_zeroed(&mut self) {
        const ZEROED: f32 = REST_NOISE * BIAS_WALK;
        self.bias = Vec3::ZERO;
        self.variance = vec3(ZEROED, ZEROED, ZEROED);
        self.looks_for_rest = false;
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

/// The level part of a specific force in world axes, in g. Free fall says nothing; a force that hangs upside
/// down by more than half a g says that the estimate does, and counts as a whole g to the side.
#[inline(always)]
fn level(f: Vec3<f32>) -> [f32; 2] {
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

/// Whether the sensor lies still, from its own readings.
#[derive(Clone, Copy, Debug, Default)]
struct Rest {
    fast_gyro: Vec3<f32>,
    fast_accel: Vec3<f32>,
    slow_gyro: Vec3<f32>,
    slow_accel: Vec3<f32>,
    /// Length of the present stillness, s, counted up to [`REST_FOR_S`].
    still_s: f32,
}

impl Rest {
    fn from(gyro: Vec3<f32>, accel: Vec3<f32>) -> Self {
        Self { fast_gyro: gyro, fast_accel: accel, slow_gyro: gyro, slow_accel: accel, still_s: 0.0 }
    }

    #[inline(always)]
    fn lasts(&mut self, gyro: Vec3<f32>, accel: Vec3<f32>, dt_s: f32) -> bool {
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
        self.lasting()
    }

    fn lasting(&self) -> bool {
        self.still_s >= REST_FOR_S
    }
}

/// The magnetic field as it was, and the share of a new one.
#[derive(Clone, Copy, Debug, Default)]
struct North {
    /// Time since the magnetometer's last sample, s.
    since_s: f32,
    /// Means of the field's level and vertical parts, µT, and over how long they are, s.
    level: f32,
    vertical: f32,
    mean_s: f32,
    /// How long the field has turned the heading, s, counted up to the time constant.
    age_s: f32,
    /// How long the field has been another, s.
    strange_s: f32,
    /// The sensor's own field, µT, body.
    offset: Vec3<f32>,
}

impl North {
    /// By how much a field's level and vertical parts exceed their means, µT; `None` for a field that is not
    /// the place's.
    #[inline(always)]
    fn excess(&mut self, level: f32, vertical: f32, tolerance: f32, dt_s: f32) -> Option<(f32, f32)> {
        let off = (level - self.level, vertical - self.vertical);
        let strength = self.level * self.level + self.vertical * self.vertical;
        let strange = off.0 * off.0 + off.1 * off.1 > tolerance * tolerance * strength;
        if self.mean_s > 0.0 && strange {
            self.strange_s += dt_s;
            if self.strange_s < NEW_PLACE_S {
                return None;
            }
            self.mean_s = 0.0;
        }
        self.strange_s = 0.0;
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
    fn learn_offset(&mut self, strange: Vec3<f32>, dt_s: f32) {
        let learnt = self.offset + strange * (dt_s / OFFSET_TAU_S);
        let within = |o: f32| max(min(o, MAX_OFFSET), -MAX_OFFSET);
        self.offset = vec3(within(learnt.x), within(learnt.y), within(learnt.z));
    }
}

#[cfg(all(test, not(miri)))] // thousands of samples beside a second filter: minutes for each under Miri
mod tests;
