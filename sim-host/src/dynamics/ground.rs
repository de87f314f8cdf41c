//! The ground plane: four feet on springs and dampers, with friction.
//!
//! The feet are below the rotors. The ground pushes a foot at depth z > 0 and velocity v up with k z + c v_z, and
//! never pulls it down. Friction is μ times this force. It falls to zero with the sliding speed, so that a vehicle at
//! rest stays at rest.

use flight_core::geometry::{Mat3, Vec3, vec3};

use super::{GRAVITY, State, VehicleParams};

/// The ground and the vehicle's legs.
///
/// Stiffness and damping scale with the vehicle's weight: at rest the legs are compressed by 1 mm, and a bounce decays
/// within half a period. For OS4: k = 1,594 N/m and c = 23 N·s/m per foot. The fastest mode is the roll of a vehicle
/// on its feet, at 160 rad/s, which a 1 ms step resolves well.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ground {
    stiffness_n_m: f64,
    damping_n_s_m: f64,
    arm_m: f64,
}

/// Depth of a foot under its share of the weight, m.
const REST_DEPTH_M: f64 = 0.001;

/// Friction coefficient of rubber feet on dry ground.
const FRICTION: f64 = 0.6;

/// Sliding speed at which friction reaches 70 % of its value, m/s.
const CREEP_M_S: f64 = 0.05;

/// Force and torque of the ground on the body.
#[derive(Clone, Copy, Debug)]
pub(super) struct Contact {
    /// Force, N, world axes.
    pub force: Vec3<f64>,
    /// Torque, N·m, body axes, about the centre of gravity.
    pub torque: Vec3<f64>,
}

impl Ground {
    /// Creates the ground and the legs for a vehicle.
    pub fn new(params: &VehicleParams) -> Self {
        let share = params.mass_kg / 4.0;
        let stiffness_n_m = share * GRAVITY / REST_DEPTH_M;
        // 0.7 of critical damping.
        let damping_n_s_m = 1.4 * libm::sqrt(stiffness_n_m * share);
        Self { stiffness_n_m, damping_n_s_m, arm_m: params.arm_m() }
    }

    /// Returns the smallest moment of inertia on these legs for which steps of 1 ms are stable, kg·m².
    ///
    /// The vehicle has the mass m, the moment of inertia I, arms of length l and legs of length h. The damping rates of
    /// its rotation are:
    /// - 2 c l²/I by the four dampers, where the damping c is 34.7/s · m with the 1 mm of `REST_DEPTH_M`,
    /// - 118/s · m h²/I by friction at rest, where 118/s is μ g divided by the creep speed,
    /// - 118/s · m l²/I by friction about the vertical.
    ///
    /// All are below 120/s · m (l² + 2h²)/I. With the smallest I that is 2,400/s, and RK4 is stable up to 2,780/s. OS4
    /// has 600/s.
    pub fn min_inertia_kg_m2(params: &VehicleParams) -> f64 {
        let VehicleParams { mass_kg, feet_m, .. } = params;
        let arm_m = params.arm_m();
        mass_kg * (arm_m * arm_m + 2.0 * feet_m * feet_m) / 20.0
    }

    /// Returns the position of the centre of gravity at rest, m, down (negative).
    pub(super) fn rest_position_m(&self, params: &VehicleParams) -> f64 {
        REST_DEPTH_M - params.feet_m
    }

    /// Returns true if a foot could touch the ground in some attitude. In flight this is the only computation for the
    /// ground.
    #[inline(always)]
    pub(super) fn is_near(&self, params: &VehicleParams, state: &State) -> bool {
        state.position.z > -(self.arm_m + params.feet_m)
    }

    #[inline(always)]
    pub(super) fn touches(&self, params: &VehicleParams, state: &State) -> bool {
        self.is_near(params, state) && self.foot_touches(params, state)
    }

    fn foot_touches(&self, params: &VehicleParams, state: &State) -> bool {
        let down = state.attitude.down();
        feet(params).iter().any(|foot| state.position.z + down.dot(*foot) > 0.0)
    }

    pub(super) fn contact(&self, params: &VehicleParams, state: &State, matrix: &Mat3<f64>) -> Contact {
        let mut contact = Contact { force: Vec3::ZERO, torque: Vec3::ZERO };
        for foot in feet(params) {
            let depth = state.position.z + matrix[2].dot(foot);
            if depth <= 0.0 {
                continue;
            }
            let velocity = state.velocity + *matrix * state.rates.cross(foot);
            let push = (self.stiffness_n_m * depth + self.damping_n_s_m * velocity.z).max(0.0);
            let sliding =
                libm::sqrt(velocity.x * velocity.x + velocity.y * velocity.y + CREEP_M_S * CREEP_M_S);
            let hold = FRICTION * push / sliding;
            let force = vec3(-hold * velocity.x, -hold * velocity.y, -push);
            contact.force += force;
            contact.torque += foot.cross(matrix.transpose() * force);
        }
        contact
    }
}

/// Returns the positions of the feet in body axes, m: below the rotors.
fn feet(params: &VehicleParams) -> [Vec3<f64>; 4] {
    [(1.0, -1.0), (1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0)]
        .map(|(x, y)| vec3(x * params.forward_m, y * params.right_m, params.feet_m))
}
