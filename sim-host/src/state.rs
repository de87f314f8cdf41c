//! Where the vehicle is and how it moves.

use flight_core::geometry::{Quaternion, Vec3};

/// Where the vehicle is and how it moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct State {
    /// North, east, down, m. The ground is at 0.
    pub position: Vec3<f64>,
    /// North, east, down, m/s.
    pub velocity: Vec3<f64>,
    /// Body to world.
    pub attitude: Quaternion<f64>,
    /// Body rates, rad/s.
    pub rates: Vec3<f64>,
}

impl State {
    /// Cosine of the angle between the body's and the world's down.
    pub fn cos_tilt(&self) -> f64 {
        self.attitude.down().z
    }

    /// Whether every number is finite.
    pub fn is_finite(&self) -> bool {
        let sum = self.position.dot(Vec3::X + Vec3::Z)
            + self.position.y
            + self.velocity.norm()
            + self.attitude.norm_squared()
            + self.rates.norm();
        sum.is_finite()
    }
}
