//! The ground plane: four feet on springs and dampers, with friction.
//!
//! Feet stand below the rotors. A foot at depth z > 0 moving at v is pushed up with k z + c v_z (never
//! pulled down) and held back with μ times that, fading to zero with the sliding speed so that rest is rest.

use flight_core::geometry::{Mat3, Vec3, vec3};

use super::{GRAVITY, State, VehicleParams};

/// The ground and the legs that meet it.
///
/// Stiffness and damping scale with the vehicle's weight: at rest the legs give by 1 mm, and a bounce dies
/// within half a period. For OS4: k = 1,594 N/m and c = 23 N·s/m a foot; the fastest mode is the roll of a
/// vehicle on its feet, at 160 rad/s, well inside what a 1 ms step resolves.
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

/// Sliding speed at which friction has risen to 70 % of its value, m/s.
const CREEP_M_S: f64 = 0.05;

/// What the ground does to the body.
#[derive(Clone, Copy, Debug)]
pub(super) struct Contact {
    /// N, world axes.
    pub force: Vec3<f64>,
    /// N·m, body axes, about the centre of gravity.
    pub torque: Vec3<f64>,
}

impl Ground {
    /// Ground and legs for a vehicle.
    pub fn new(params: &VehicleParams) -> Self {
        let share = params.mass_kg / 4.0;
        let stiffness_n_m = share * GRAVITY / REST_DEPTH_M;
        // 0.7 of critical.
        let damping_n_s_m = 1.4 * libm::sqrt(stiffness_n_m * share);
        Self { stiffness_n_m, damping_n_s_m, arm_m: params.arm_m() }
    }

    /// The smallest moment of inertia that steps of 1 ms can follow on these legs, kg·m².
    ///
    /// The four dampers turn the body back by 2 c l²/I, with c = 34.7/s · m for the 1 mm of `REST_DEPTH_M`; friction at
    /// rest by (μ g/creep = 118/s) · m h²/I with legs of h, and about the vertical by 118/s · m l²/I. All are below
    /// 120/s · m (l² + 2h²)/I, which with this bound is 2,400/s (RK4 is stable to 2,780/s); OS4's is 600/s.
    pub fn least_inertia_kg_m2(params: &VehicleParams) -> f64 {
        let VehicleParams { mass_kg, feet_m, .. } = params;
        let arm_m = params.arm_m();
        mass_kg * (arm_m * arm_m + 2.0 * feet_m * feet_m) / 20.0
    }

    /// Position of the centre of gravity at rest, m down (negative).
    pub(super) fn rest_position_m(&self, params: &VehicleParams) -> f64 {
        REST_DEPTH_M - params.feet_m
    }

    /// Whether a foot could touch in any attitude: the only work that flight does for the ground.
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

/// The feet in body axes, m: below the rotors.
fn feet(params: &VehicleParams) -> [Vec3<f64>; 4] {
    [(1.0, -1.0), (1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0)]
        .map(|(x, y)| vec3(x * params.forward_m, y * params.right_m, params.feet_m))
}
