//! Detector of rest.

use super::super::at_rest::MAX_BIAS;
use super::DEGREE;
use crate::arithmetic::min;
use crate::geometry::Vec3;

/// The sensor is at rest while its readings, smoothed over [`FAST_S`], have differed from their means over
/// [`SLOW_S`] by less than these for [`FOR_S`], rad/s and m/s². The smoothing makes the test the same at any sample
/// rate: a noise density N leaves N/√(4 · 0.02 s), 0.11 °/s for the noisiest axis of the paper. A steady turn at ω
/// about a horizontal axis changes the specific force by gω per second, so that it leads its mean by gω · 0.5 s: the
/// test detects a turn above 2.3 °/s.
const RATE: f32 = 2.0 * DEGREE;
const FORCE: f32 = 0.2;
const FAST_S: f32 = 0.02;
const SLOW_S: f32 = 0.5;
const FOR_S: f32 = 1.5;

/// Detector of rest, from the readings of the sensor.
#[derive(Clone, Copy, Debug, Default)]
pub struct RestDetector {
    fast_gyro: Vec3<f32>,
    fast_accel: Vec3<f32>,
    slow_gyro: Vec3<f32>,
    slow_accel: Vec3<f32>,
    /// Duration of the present rest, s, counted up to [`FOR_S`].
    still_s: f32,
}

impl RestDetector {
    pub fn from(gyro: Vec3<f32>, accel: Vec3<f32>) -> Self {
        Self { fast_gyro: gyro, fast_accel: accel, slow_gyro: gyro, slow_accel: accel, still_s: 0.0 }
    }

    #[inline(always)]
    pub fn update(&mut self, gyro: Vec3<f32>, accel: Vec3<f32>, dt_s: f32) {
        let (fast, slow) = (dt_s / (FAST_S + dt_s), dt_s / (SLOW_S + dt_s));
        self.fast_gyro += (gyro - self.fast_gyro) * fast;
        self.fast_accel += (accel - self.fast_accel) * fast;
        let gyro_off = self.fast_gyro - self.slow_gyro;
        let accel_off = self.fast_accel - self.slow_accel;
        self.slow_gyro += gyro_off * slow;
        self.slow_accel += accel_off * slow;
        let still = gyro_off.dot(gyro_off) < RATE * RATE
            && accel_off.dot(accel_off) < FORCE * FORCE
            && self.slow_gyro.dot(self.slow_gyro) < MAX_BIAS * MAX_BIAS;
        self.still_s = if still { min(self.still_s + dt_s, FOR_S) } else { 0.0 };
    }

    /// Returns whether the sensor is at rest.
    pub fn at_rest(&self) -> bool {
        self.still_s >= FOR_S
    }

    /// Returns the mean rate of the last half second, rad/s.
    pub fn mean_gyro(&self) -> Vec3<f32> {
        self.slow_gyro
    }

    /// Returns the mean specific force of the last half second, m/s².
    pub fn mean_accel(&self) -> Vec3<f32> {
        self.slow_accel
    }

    /// Starts the time of rest again.
    pub fn interrupt(&mut self) {
        self.still_s = 0.0;
    }
}
