//! The state of motion of the vehicle.

use flight_core::geometry::{Quaternion, Vec3};

/// Position, velocity, attitude and rates of the vehicle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct State {
    /// Position, m, north, east, down. The ground is at 0.
    pub position: Vec3<f64>,
    /// Velocity, m/s, north, east, down.
    pub velocity: Vec3<f64>,
    /// Attitude, body to world.
    pub attitude: Quaternion<f64>,
    /// Body rates, rad/s.
    pub rates: Vec3<f64>,
}

impl State {
    /// Returns the cosine of the tilt, the angle between the body's z axis and the vertical.
    pub fn cos_tilt(&self) -> f64 {
        self.attitude.down().z
    }

    /// Returns true if every number is finite.
    pub fn is_finite(&self) -> bool {
        let sum = self.position.dot(Vec3::X + Vec3::Z)
            + self.position.y
            + self.velocity.norm()
            + self.attitude.norm_squared()
            + self.rates.norm();
        sum.is_finite()
    }
}
