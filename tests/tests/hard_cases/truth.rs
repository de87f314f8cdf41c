//! A rotating body in f64, and the readings of perfect sensors on it.

use flight_core::estimator::{Estimator, EstimatorParams};
use flight_core::geometry::{Quaternion, Vec3, vec3};
use sim_host::attitude_error::AttitudeError;

/// Gravity, m/s²; axes north, east, down.
pub const GRAVITY: Vec3<f64> = vec3(0.0, 0.0, 9.80665);
pub const FIELD_UT: Vec3<f64> = vec3(25.0, 0.0, 41.0);

/// Returns the rotation by a rotation vector (axis times angle, rad).
pub fn rotation(r: Vec3<f64>) -> Quaternion<f64> {
    let angle = r.norm();
    let share = if angle > 1e-9 { libm::sin(0.5 * angle) / angle } else { 0.5 };
    Quaternion { w: libm::cos(0.5 * angle), v: r * share }
}

pub fn single(v: Vec3<f64>) -> Vec3<f32> {
    Vec3::from(<[f64; 3]>::from(v).map(|x| x as f32))
}

pub fn double(q: Quaternion<f32>) -> Quaternion<f64> {
    let [w, x, y, z] = q.to_array().map(f64::from);
    Quaternion::new(w, x, y, z)
}

/// A body with its true attitude, and an estimator that gets its samples.
pub struct Body {
    pub attitude: Quaternion<f64>,
    pub estimator: Estimator,
}

impl Body {
    /// Creates a body at this attitude, with an estimator that has seen one sample there.
    pub fn at(attitude: Quaternion<f64>, params: &EstimatorParams) -> Self {
        let mut body = Self { attitude, estimator: Estimator::new(params).unwrap() };
        body.sample(Vec3::ZERO, 0.0, true, true);
        body
    }

    /// Updates the estimator with this rate and the readings of gravity and field, or zero and none.
    fn sample(&mut self, gyro: Vec3<f64>, dt_s: f64, gravity: bool, field: bool) {
        let into_body = |v| self.attitude.conjugate().rotate(v);
        let accel = if gravity { into_body(-GRAVITY) } else { Vec3::ZERO };
        let mag = field.then(|| single(into_body(FIELD_UT)));
        self.estimator.update(single(gyro), single(accel), mag, dt_s as f32);
    }

    /// Turns at a constant rate (rad/s, body axes) for one sample.
    pub fn turn(&mut self, rate: Vec3<f64>, dt_s: f64) {
        self.attitude = (self.attitude * rotation(rate * dt_s)).normalized();
        self.sample(rate, dt_s, true, true);
    }

    /// Turns for one sample in which neither gravity nor field is visible.
    pub fn turn_without_references(&mut self, rate: Vec3<f64>, dt_s: f64) {
        self.attitude = (self.attitude * rotation(rate * dt_s)).normalized();
        self.sample(rate, dt_s, false, false);
    }

    fn error(&self) -> Option<AttitudeError> {
        let estimate = double(self.estimator.attitude());
        let finite = estimate.to_array().iter().all(|part| part.is_finite());
        finite.then(|| AttitudeError::between(estimate, self.attitude))
    }

    /// Returns the error of the estimate, degrees; NaN if the estimate is not finite.
    pub fn error_deg(&self) -> f64 {
        self.error().map_or(f64::NAN, |error| error.total_rad.to_degrees())
    }

    /// Returns the tilt part of the error, degrees.
    pub fn inclination_deg(&self) -> f64 {
        self.error().map_or(f64::NAN, |error| error.inclination_rad.to_degrees())
    }
}

/// Returns whether the preset's accuracy is specified everywhere: true for the two presets for flight.
pub fn is_accurate(name: &str) -> bool {
    matches!(name, "flight" | "robust")
}

/// Returns the time constant of a preset's tilt at 1 kHz, s. `robust` has none; after a push its tilt error is largest
/// after 5 to 6 s.
pub fn tau_s(params: &EstimatorParams) -> f64 {
    let mut params = *params;
    let of_tilt = params.settings().next().unwrap();
    let value = f64::from(*of_tilt.value);
    match of_tilt.name {
        "estimator.alpha" => 1e-3 * value / (1.0 - value),
        "estimator.tau_s" => value,
        "estimator.speed_m_s" => 5.0,
        other => panic!("{other} is not a time constant"),
    }
}
