//! Eq 18 on roll, pitch and yaw, each separately, as in the paper.

use super::{Filter, MIN_HORIZONTAL_FIELD_SQUARED, MIN_SPECIFIC_FORCE_SQUARED, Weight};
use crate::arithmetic::{atan2, direction, elevation, sin_cos, sqrt, wrap_pi};
use crate::geometry::{Quaternion, Vec3, vec3};

/// Smallest |cos θ| in the Euler rates, which contain 1/cos θ. Within 0.06° of the vertical the factor is limited to
/// 1/0.001, which keeps a step at 2,000 °/s and 1 kHz below 35 rad: wrong there, as Euler angles are, but finite.
const MIN_COS_PITCH: f32 = 0.001;

/// The complementary filter in Euler angles.
///
/// An update costs two [`sin_cos`] (of the new roll and pitch; the heading of this update, the kinematics of the next
/// one and the direction of down use them), three [`atan2`] and one square root.
#[derive(Clone, Copy, Debug)]
pub struct EulerFilter {
    weight: Weight,
    declination_rad: f32,
    roll: f32,
    pitch: f32,
    yaw: f32,
    /// Sine and cosine of `roll` and `pitch`.
    roll_sc: (f32, f32),
    pitch_sc: (f32, f32),
    /// Time since the last magnetometer sample, s.
    mag_dt_s: f32,
    tilt_started: bool,
    heading_started: bool,
}

impl EulerFilter {
    pub(super) fn new(weight: Weight, declination_rad: f32) -> Self {
        Self {
            weight,
            declination_rad,
            roll: 0.0,
            pitch: 0.0,
            yaw: 0.0,
            roll_sc: (0.0, 1.0),
            pitch_sc: (0.0, 1.0),
            mag_dt_s: 0.0,
            tilt_started: false,
            heading_started: false,
        }
    }

    /// a\[k\] = o\[k−1\] + Δt · (φ̇, θ̇, ψ̇), with the Euler rates computed from the body rates at the last attitude.
    #[inline(always)]
    fn predict(&mut self, gyro: Vec3<f32>, dt_s: f32) {
        let (sin_roll, cos_roll) = self.roll_sc;
        let (sin_pitch, cos_pitch) = self.pitch_sc;
        let cos_pitch =
            if cos_pitch.abs() >= MIN_COS_PITCH { cos_pitch } else { MIN_COS_PITCH.copysign(cos_pitch) };
        let yaw_rate = (gyro.y * sin_roll + gyro.z * cos_roll) / cos_pitch;
        self.roll += dt_s * (gyro.x + yaw_rate * sin_pitch);
        self.pitch += dt_s * (gyro.y * cos_roll - gyro.z * sin_roll);
        self.yaw += dt_s * yaw_rate;
    }

    /// o = a + (1 − α)(b − a), with the difference wrapped to ±180°, so that a crossing of ±180° causes no jump.
    #[inline(always)]
    fn correct_tilt(&mut self, f: Vec3<f32>, dt_s: f32) {
        let across = f.y * f.y + f.z * f.z;
        if across + f.x * f.x < MIN_SPECIFIC_FORCE_SQUARED {
            return;
        }
        let roll = atan2(-f.y, -f.z);
        let pitch = elevation(f.x, sqrt(across));
        let share = if self.tilt_started { self.weight.measurement_weight(dt_s) } else { 1.0 };
        self.tilt_started = true;
        self.roll += share * wrap_pi(roll - self.roll);
        self.pitch += share * wrap_pi(pitch - self.pitch);
    }

    /// Computes the heading from the field, rotated to level by roll and pitch, plus the declination.
    #[inline(always)]
    fn correct_heading(&mut self, m: Vec3<f32>) {
        let (sin_roll, cos_roll) = self.roll_sc;
        let (sin_pitch, cos_pitch) = self.pitch_sc;
        let forward = m.x * cos_pitch + (m.y * sin_roll + m.z * cos_roll) * sin_pitch;
        let right = m.y * cos_roll - m.z * sin_roll;
        // NaN fails this comparison too.
        let usable = forward * forward + right * right >= MIN_HORIZONTAL_FIELD_SQUARED;
        if !usable {
            return;
        }
        let yaw = direction(-right, forward) + self.declination_rad;
        let share = if self.heading_started { self.weight.measurement_weight(self.mag_dt_s) } else { 1.0 };
        self.heading_started = true;
        self.mag_dt_s = 0.0;
        self.yaw += share * wrap_pi(yaw - self.yaw);
    }

    #[cfg(test)]
    pub(super) fn angles(&self) -> [f32; 3] {
        [self.roll, self.pitch, self.yaw]
    }
}

impl Filter for EulerFilter {
    #[inline]
    fn update(&mut self, gyro: Vec3<f32>, accel: Vec3<f32>, mag: Option<Vec3<f32>>, dt_s: f32) {
        self.predict(gyro, dt_s);
        self.correct_tilt(accel, dt_s);
        // The differences are wrapped for any value of the prediction, so one wrap per update is enough.
        self.roll = wrap_pi(self.roll);
        self.pitch = wrap_pi(self.pitch);
        self.roll_sc = sin_cos(self.roll);
        self.pitch_sc = sin_cos(self.pitch);
        self.mag_dt_s += dt_s;
        if let Some(field) = mag {
            self.correct_heading(field);
        }
        self.yaw = wrap_pi(self.yaw);
    }

    fn restart(&mut self) {
        *self = Self::new(self.weight, self.declination_rad);
    }

    fn started(&self) -> bool {
        self.tilt_started
    }

    /// Returns (−sin θ, sin φ cos θ, cos φ cos θ): the last row of the rotation matrix.
    #[inline(always)]
    fn down(&self) -> Vec3<f32> {
        let (sin_roll, cos_roll) = self.roll_sc;
        let (sin_pitch, cos_pitch) = self.pitch_sc;
        vec3(-sin_pitch, sin_roll * cos_pitch, cos_roll * cos_pitch)
    }

    #[inline(always)]
    fn heading(&self) -> f32 {
        self.yaw
    }

    fn attitude(&self) -> Quaternion<f32> {
        Quaternion::from_half_angles(
            sin_cos(0.5 * self.roll),
            sin_cos(0.5 * self.pitch),
            sin_cos(0.5 * self.yaw),
        )
    }
}
