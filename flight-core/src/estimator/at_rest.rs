//! Zeroing of the gyroscope while the vehicle is at rest.

use crate::STANDARD_GRAVITY;
use crate::geometry::Vec3;

/// Largest deviation of a gyroscope at rest from its running mean, rad/s: 3 °/s. This is eleven times the prefiltered
/// noise of the noisiest axis of the paper, 0.26 °/s, and less than the motion of a vehicle that is held in a hand.
const STILL_GYRO: f32 = 0.052;

/// Largest deviation of an accelerometer at rest from its running mean, m/s².
const STILL_ACCEL: f32 = 0.6;

/// Largest bias, rad/s: 20 °/s, the largest zero-rate output in the datasheets of common chips (MPU-6050). A larger
/// steady rate is a real rotation, as on a turntable.
pub(super) const MAX_BIAS: f32 = 0.35;

/// Time at rest before the mean is used, s.
const MIN_STILL_S: f32 = 1.0;

/// Longest averaging time of the mean, s. The mean follows a drift that is slower.
const MAX_MEAN_S: f32 = 10.0;

/// Estimates the bias of the gyroscope as its mean while the vehicle is at rest, and keeps it in flight.
///
/// White noise of density N leaves an error of N/√T after T seconds. For the 0.0323 °/s/√Hz of the paper and 2 s this
/// is 0.023 °/s, which causes 0.23° of attitude error in the estimator `flight`, whose τ is 10 s.
#[derive(Clone, Copy, Debug, Default)]
pub struct GyroZero {
    bias: Vec3<f32>,
    mean_gyro: Vec3<f32>,
    mean_accel: Vec3<f32>,
    /// Duration of the present rest, s, counted up to [`MAX_MEAN_S`].
    still_s: f32,
    zeroed: bool,
}

impl GyroZero {
    /// Updates the mean with a prefiltered sample (rad/s, m/s², body axes) that covers `dt_s` (s). Call it only while
    /// disarmed.
    #[inline]
    pub fn learn(&mut self, gyro: Vec3<f32>, accel: Vec3<f32>, dt_s: f32) {
        let gyro_deviation = gyro - self.mean_gyro;
        let accel_deviation = accel - self.mean_accel;
        let still = gyro_deviation.dot(gyro_deviation) < STILL_GYRO * STILL_GYRO
            && accel_deviation.dot(accel_deviation) < STILL_ACCEL * STILL_ACCEL
            && (accel.norm() - STANDARD_GRAVITY).abs() < 0.1 * STANDARD_GRAVITY;
        if !still || self.still_s == 0.0 {
            self.mean_gyro = gyro;
            self.mean_accel = accel;
            self.still_s = if dt_s > 0.0 { dt_s } else { 0.0 };
            return;
        }
        if self.still_s < MAX_MEAN_S {
            self.still_s += dt_s;
        }
        let share = dt_s / self.still_s;
        self.mean_gyro += gyro_deviation * share;
        self.mean_accel += accel_deviation * share;
        if self.still_s < MIN_STILL_S {
            return;
        }
        if self.mean_gyro.dot(self.mean_gyro) < MAX_BIAS * MAX_BIAS {
            self.bias = self.mean_gyro;
            self.zeroed = true;
        } else {
            // A steady rate this large is not rest, even after zeroing. It is a turntable, or a gyroscope that is
            // stuck.
            self.still_s = 0.0;
        }
    }

    /// Starts a new rest: the motion during a gap in the samples is unknown.
    pub fn interrupt(&mut self) {
        self.still_s = 0.0;
    }

    /// Returns whether the vehicle has been at rest for the 1 s that a zeroing takes, up to the last sample. A steady
    /// turn is no rest.
    pub fn still(&self) -> bool {
        self.still_s >= MIN_STILL_S
    }

    /// Returns whether a bias has been estimated.
    pub fn zeroed(&self) -> bool {
        self.zeroed
    }

    /// Returns the bias to subtract, rad/s, body axes; zero before the first rest.
    #[inline(always)]
    pub fn bias(&self) -> Vec3<f32> {
        self.bias
    }
}
