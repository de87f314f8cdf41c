//! Lever arm: an accelerometer off the centre of gravity feels the body turn.
//!
//! f ← f + α × r + ω × (ω × r), rigid-body kinematics: the Euler and the centripetal acceleration at r. At
//! r = 2 cm a spin of 360 °/s is 0.79 m/s².

use flight_core::geometry::Vec3;
use serde::Deserialize;

use crate::effects::{BoxedSensorEffect, Build, Recipe, SensorEffect, Snapshot};
use input::InputError;
use input::check;

/// `[effects.accel.lever_arm]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LeverArm {
    /// r, m: where the accelerometer is, from the centre of gravity, body axes.
    pub r_m: [f64; 3],
}

impl Recipe for LeverArm {
    type Effect = BoxedSensorEffect;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        check::keys_in_range(key, "r_m", self.r_m, -10.0, 10.0, "m")
    }

    fn build(&self, _: &Build) -> BoxedSensorEffect {
        Box::new(Arm(self.r_m.into()))
    }
}

struct Arm(Vec3<f64>);

impl SensorEffect for Arm {
    #[inline]
    fn apply_to(&mut self, reading: &mut Vec3<f64>, at: &Snapshot) {
        let rates = at.state.rates;
        *reading += at.angular_acceleration.cross(self.0) + rates.cross(rates.cross(self.0));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::sensor::testing::{STATE, build, moment};
    use crate::state::State;
    use flight_core::geometry::vec3;

    #[test]
    fn a_turntable_pulls_inwards_and_along() {
        let mut effect = build(&LeverArm { r_m: [0.5, 0.0, 0.2] }, 100.0);
        let state = State { rates: vec3(0.0, 0.0, 3.0), ..STATE };
        let at = Snapshot { angular_acceleration: vec3(0.0, 0.0, 2.0), ..moment(&state, 0.0) };
        // −ω² r inwards, α r along; what lies on the axis feels nothing.
        let felt = effect.apply(Vec3::ZERO, &at);
        assert!((felt - vec3(-9.0 * 0.5, 2.0 * 0.5, 0.0)).norm() < 1e-15, "{felt:?}");
    }

    #[test]
    fn is_the_second_derivative_of_where_the_sensor_is() {
        // A point of a body that turns about y by φ(t) = 0.3 sin 5t; differences of its true path.
        let r = vec3(0.1, 0.0, -0.04);
        let mut effect = build(&LeverArm { r_m: r.into() }, 100.0);
        let place = |t: f64| {
            let (s, c) = (0.3 * (5.0 * t).sin()).sin_cos();
            vec3(c * r.x + s * r.z, 0.0, c * r.z - s * r.x)
        };
        let (t, h) = (0.37, 1e-4);
        let world = (place(t + h) - place(t) * 2.0 + place(t - h)) * (1.0 / (h * h));
        let (s, c) = (0.3 * (5.0 * t).sin()).sin_cos();
        let body = vec3(c * world.x - s * world.z, 0.0, c * world.z + s * world.x);
        let state = State { rates: vec3(0.0, 1.5 * (5.0 * t).cos(), 0.0), ..STATE };
        let turning = vec3(0.0, -7.5 * (5.0 * t).sin(), 0.0);
        let got = effect.apply(Vec3::ZERO, &Snapshot { angular_acceleration: turning, ..moment(&state, t) });
        assert!((got - body).norm() < 1e-6, "{got:?} {body:?}");
    }
}
