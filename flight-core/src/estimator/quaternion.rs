//! Eq 18 on a quaternion: predicts with the gyroscope, then rotates by the share 1 − α of the shortest rotation from
//! the prediction to the measurement, first in tilt, then in heading.

use super::{Filter, MIN_HORIZONTAL_FIELD_SQUARED, MIN_SPECIFIC_FORCE_SQUARED, Weight};
use crate::arithmetic::{direction, wrap_pi};
use crate::geometry::{Quaternion, Vec3, vec3};

/// The complementary filter on a quaternion.
///
/// While the age of the filter is less than τ, the age replaces τ. The attitude then starts as the mean of the first
/// measurements; otherwise the noise of the first sample would decay over τ.
#[derive(Clone, Copy, Debug)]
pub struct QuaternionFilter {
    q: Quaternion<f32>,
    weight: Weight,
    declination_rad: f32,
    /// Time since the first sample, s, counted up to τ.
    tilt_age_s: f32,
    /// Time since the first magnetometer sample, s, counted up to τ.
    heading_age_s: f32,
    /// Time since the last magnetometer sample, s.
    mag_dt_s: f32,
    tilt_started: bool,
    heading_started: bool,
}

impl QuaternionFilter {
    pub(super) fn new(weight: Weight, declination_rad: f32) -> Self {
        Self {
            weight,
            declination_rad,
            q: Quaternion::IDENTITY,
            tilt_age_s: 0.0,
            heading_age_s: 0.0,
            mag_dt_s: 0.0,
            tilt_started: false,
            heading_started: false,
        }
    }

    /// Rotates the predicted direction of down towards the measured one, −f.
    #[inline(always)]
    fn correct_tilt(&mut self, f: Vec3<f32>, dt_s: f32) {
        if f.dot(f) < MIN_SPECIFIC_FORCE_SQUARED {
            return;
        }
        let predicted = self.q.down();
        let axis = predicted.cross(f); // −f × predicted, times |f|: the axis of the rotation of the body
        let sine = axis.norm();
        let angle = direction(sine, -f.dot(predicted));
        let share = Self::share(self.weight, &mut self.tilt_age_s, dt_s);
        let share = if self.tilt_started { share } else { 1.0 };
        self.tilt_started = true;
        let turn = if sine > 1.0e-6 {
            axis * (share * angle / sine)
        } else {
            // Parallel: no correction. Antiparallel: every horizontal axis is equivalent.
            let across = if predicted.y.abs() < 0.7 { vec3(0.0, 1.0, 0.0) } else { Vec3::X };
            let level = across.cross(predicted);
            level * (share * angle / level.norm())
        };
        self.q = self.q * Quaternion::from_rotation_vector(turn);
    }

    /// Corrects the heading about the vertical so that the horizontal field points to magnetic north.
    #[inline(always)]
    fn correct_heading(&mut self, m: Vec3<f32>) {
        let field = self.q.rotate(m);
        if field.x * field.x + field.y * field.y < MIN_HORIZONTAL_FIELD_SQUARED {
            return;
        }
        let excess = wrap_pi(direction(field.y, field.x) - self.declination_rad);
        let share = Self::share(self.weight, &mut self.heading_age_s, self.mag_dt_s);
        let share = if self.heading_started { share } else { 1.0 };
        self.heading_started = true;
        self.mag_dt_s = 0.0;
        self.q = Quaternion::from_rotation_vector(vec3(0.0, 0.0, -share * excess)) * self.q;
    }

    /// Returns 1 − α for a filter of this age, and increases the age by `dt_s`.
    #[inline(always)]
    fn share(weight: Weight, age_s: &mut f32, dt_s: f32) -> f32 {
        match weight {
            // A sample that covers no time has no weight, also at age 0.
            Weight::TimeConstant { tau_s } if *age_s < tau_s && dt_s > 0.0 => {
                *age_s += dt_s;
                dt_s / *age_s
            }
            weight => weight.measurement_weight(dt_s),
        }
    }
}

impl Filter for QuaternionFilter {
    #[inline]
    fn update(&mut self, gyro: Vec3<f32>, accel: Vec3<f32>, mag: Option<Vec3<f32>>, dt_s: f32) {
        self.q = self.q * Quaternion::from_rotation_vector(gyro * dt_s);
        self.correct_tilt(accel, dt_s);
        self.mag_dt_s += dt_s;
        if let Some(field) = mag {
            self.correct_heading(field);
        }
        // One Newton step for 1/√n at n = 1. The rounding of a step leaves n within 1e-6 of 1; the Newton step
        // squares this error.
        self.q = self.q.scaled(1.5 - 0.5 * self.q.norm_squared());
    }

    fn restart(&mut self) {
        *self = Self::new(self.weight, self.declination_rad);
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
}
