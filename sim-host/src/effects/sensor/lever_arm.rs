//! Lever arm: an accelerometer away from the centre of gravity measures the rotation of the body.
//!
//! f ← f + α × r + ω × (ω × r), rigid-body kinematics: the Euler and the centripetal acceleration at r. At
//! r = 2 cm a rate of 360 °/s makes 0.79 m/s².

use flight_core::geometry::Vec3;
use serde::Deserialize;

use crate::effects::{BoxedSensorEffect, BuildContext, EffectParams, SensorEffect, Snapshot};
use input::InputError;
use input::check;

/// `[effects.accel.lever_arm]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LeverArm {
    /// Position r of the accelerometer from the centre of gravity, m, body axes.
    pub r_m: [f64; 3],
}

impl EffectParams for LeverArm {
    type Effect = BoxedSensorEffect;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        check::keys_in_range(key, "r_m", self.r_m, -10.0, 10.0, "m")
    }

    fn build(&self, _: &BuildContext) -> BoxedSensorEffect {
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
    use crate::effects::sensor::testing::{STATE, build, snapshot};
    use crate::state::State;
    use flight_core::geometry::vec3;

    #[test]
    fn lever_arm_on_turntable_adds_both_accelerations() {
        let mut effect = build(&LeverArm { r_m: [0.5, 0.0, 0.2] }, 100.0);
        let state = State { rates: vec3(0.0, 0.0, 3.0), ..STATE };
        let at = Snapshot { angular_acceleration: vec3(0.0, 0.0, 2.0), ..snapshot(&state, 0.0) };
        // The acceleration is −ω² r inwards and α r along the motion. The offset along the axis of rotation has no
        // effect.
        let reading = effect.apply(Vec3::ZERO, &at);
        assert!((reading - vec3(-9.0 * 0.5, 2.0 * 0.5, 0.0)).norm() < 1e-15, "{reading:?}");
    }

    #[test]
    fn lever_arm_is_second_derivative_of_sensor_position() {
        // The expected acceleration is the second difference of the path of a point on a body that turns about y
        // by φ(t) = 0.3 sin 5t.
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
        let got =
            effect.apply(Vec3::ZERO, &Snapshot { angular_acceleration: turning, ..snapshot(&state, t) });
        assert!((got - body).norm() < 1e-6, "{got:?} {body:?}");
    }
}
