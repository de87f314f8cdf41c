//! Zeroing of the gyroscope while the vehicle lies still.

use crate::STANDARD_GRAVITY;
use crate::geometry::Vec3;

/// A gyroscope that moves less than this about its running mean is at rest, rad/s (3 °/s: eleven times the
/// prefiltered noise of the paper's noisiest axis, 0.26 °/s, and below what a hand does to a vehicle).
const STILL_GYRO: f32 = 0.052;

/// Likewise for the accelerometer about its running mean, m/s².
const STILL_ACCEL: f32 = 0.6;

/// A steady rate above this is a turntable, not a bias, rad/s (20 °/s: the largest zero-rate output in the
/// datasheets of common chips, the MPU-6050's).
pub(super) const MAX_BIAS: f32 = 0.35;

/// Stillness that it takes before a mean is believed, s.
const MIN_STILL_S: f32 = 1.0;

/// The mean is over no more than this, s: it follows a drift slower than that.
const MAX_MEAN_S: f32 = 10.0;

/// Learns the gyroscope's bias as its mean over rest, and keeps it in flight.
///
/// White noise of density N leaves an error of N/√T after T seconds: for the paper's 0.0323 °/s/√Hz and
/// 2 s, 0.023 °/s, which the flight filter's τ of 10 s turns into 0.23° of attitude.
#[derive(Clone, Copy, Debug, Default)]
pub struct GyroZero {
    bias: Vec3<f32>,
    mean_gyro: Vec3<f32>,
    mean_accel: Vec3<f32>,
    /// Length of the present stillness, s, counted up to [`MAX_MEAN_S`].
    still_s: f32,
    zeroed: bool,
}

impl GyroZero {
    /// Takes a prefiltered sample (rad/s, m/s², body axes) that covers `dt_s`. Call it only while disarmed.
    #[inline]
    pub fn learn(&mut self, gyro: Vec3<f32>, accel: Vec3<f32>, dt_s: f32) {
        let gyro_off = gyro - self.mean_gyro;
        let accel_off = accel - self.mean_accel;
        let still = gyro_off.dot(gyro_off) < STILL_GYRO * STILL_GYRO
            && accel_off.dot(accel_off) < STILL_ACCEL * STILL_ACCEL
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
        self.mean_gyro += gyro_off * share;
        self.mean_accel += accel_off * share;
        if self.still_s < MIN_STILL_S {
            return;
        }
        if self.mean_gyro.dot(self.mean_gyro) < MAX_BIAS * MAX_BIAS {
            self.bias = self.mean_gyro;
            self.zeroed = true;
        } else {
            // A turntable is no rest, zeroed before or not, and a gyroscope that reads the same 2,000 °/s for ever is broken.
            self.still_s = 0.0;
        }
    }

    /// Begins a new stillness: after a gap, nobody knows what happened in it.
    pub fn interrupt(&mut self) {
        self.still_s = 0.0;
    }

    /// Whether the vehicle has been still for as long as a zero takes, up to the last sample, and not turning steadily.
    pub fn still(&self) -> bool {
        self.still_s >= MIN_STILL_S
    }

    /// Whether a bias has been learnt.
    pub fn zeroed(&self) -> bool {
        self.zeroed
    }

    /// The bias to subtract, rad/s, body axes; zero before the first rest.
    #[inline(always)]
    pub fn bias(&self) -> Vec3<f32> {
        self.bias
    }
}
