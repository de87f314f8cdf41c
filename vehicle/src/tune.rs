//! Computes gains for a given phase margin: see docs/tuning.md.

use flight_core::control::ControlParams;
use flight_core::geometry::vec3;

use crate::plant::{Loop, Margin, Plant};
use crate::{GRAVITY, VehicleParams};

/// Gains of the cascade, and the limits of its integrators.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tuned {
    /// Gains of roll and pitch.
    pub tilt: Loop,
    /// Gains of yaw.
    pub yaw: Loop,
    /// Maximum angular acceleration that the integrators may hold: roll, pitch, yaw, rad/s².
    pub max_integral_rad_s2: [f64; 3],
}

/// The ratios of a loop's other gains to P. The crossover is proportional to P, so the ratios keep the shape of the loop.
struct Shape {
    /// D/P over the rotors' lag τ: a zero whose phase lead compensates the lag.
    lead: f64,
    /// I/P².
    i: f64,
    /// K/P.
    k: f64,
    /// Whether the margin includes the angle loop. If not, it is that of the rate loop alone.
    with_angle: bool,
}

/// Ratios of roll and pitch. A lead of 0.8 τ leaves a fifth of the lag, with a fourth of the noise of full compensation.
/// The angle loop at a fifth of P and the integral at a fortieth of it are at least a decade below the crossover.
const TILT: Shape = Shape { lead: 0.8, i: 0.024, k: 0.22, with_angle: true };

/// Ratios of yaw. Its torque is the propellers' drag and follows their speed; it has no lead. Heading control can be slower
/// than tilt control: the margin is that of the rate loop, and the angle loop uses a third of it.
const YAW: Shape = Shape { lead: 0.0, i: 0.11, k: 0.42, with_angle: false };

/// Maximum P, 1/s: with a larger P the gyroscope's noise drives the motors.
const MAX_P: f64 = 300.0;

/// Maximum of the integrators, as a share of the angular acceleration that the rotors can make at hover: enough to
/// compensate a centre of gravity that is off the middle, and no more.
const INTEGRAL_SHARE: f64 = 0.15;

impl Shape {
    /// Returns the gains for a P, 1/s.
    fn at(&self, p: f64, lag_s: f64) -> Loop {
        Loop { p, i: rounded(self.i * p * p), d: rounded(self.lead * lag_s * p), k: rounded(self.k * p) }
    }

    fn margin(&self, plant: &Plant, p: f64) -> Margin {
        let gains = self.at(p, plant.lag_s);
        let k = if self.with_angle { gains.k } else { 0.0 };
        plant.margin(&Loop { k, ..gains })
    }

    /// Returns the gains with the largest P for which it and all smaller P have this phase margin, degrees, and a
    /// crossover below 1/τ. Above 1/τ a command must exceed the speed change that it makes, and reaches the rotors'
    /// limits more often.
    fn for_margin(&self, plant: &Plant, margin_deg: f64) -> Loop {
        let is_within_limits = |p: f64| {
            let margin = self.margin(plant, p);
            margin.phase_deg >= margin_deg && margin.crossover_rad_s * plant.lag_s <= 1.0
        };
        let (mut low, mut high) = (0.1, 0.1);
        while high < MAX_P && is_within_limits(high) {
            low = high;
            high *= 1.02;
        }
        for _ in 0..40 {
            let p = 0.5 * (low + high);
            if is_within_limits(p) { low = p } else { high = p }
        }
        self.at(rounded(low), plant.lag_s)
    }
}

/// Rounds to three digits. The result is then the same on every machine, although the last bits of complex functions
/// differ, and short enough for a file.
fn rounded(value: f64) -> f64 {
    format!("{value:.2e}").parse().unwrap_or(value)
}

/// Returns gains with at least this phase margin, degrees.
pub fn tune(params: &VehicleParams, plant: &Plant, margin_deg: f64) -> Tuned {
    let tilt = TILT.for_margin(plant, margin_deg);
    let yaw = YAW.for_margin(plant, margin_deg);
    let authority = authority_rad_s2(params);
    Tuned { tilt, yaw, max_integral_rad_s2: authority.map(|max| rounded(INTEGRAL_SHARE * max)) }
}

/// Returns the maximum angular accelerations about the body's x, y and z axes at hover thrust, rad/s².
pub fn authority_rad_s2(params: &VehicleParams) -> [f64; 3] {
    let VehicleParams { thrust_coefficient: b, torque_coefficient: d, inertia_kg_m2: inertia, .. } = params;
    // Squared rotor speeds, rad²/s². Two rotors speed up and two slow down by the same amount: the limits are standstill
    // and full speed.
    let hover = params.mass_kg * GRAVITY / (4.0 * b);
    let max_change = hover.min(params.max_rad_s * params.max_rad_s - hover).max(0.0);
    let tilt = 4.0 * b * max_change;
    [tilt * params.right_m / inertia.x, tilt * params.forward_m / inertia.y, 4.0 * d * max_change / inertia.z]
}

impl Tuned {
    /// Writes these gains to `control`.
    pub fn apply_to(&self, control: &mut ControlParams) {
        let three = |of: fn(&Loop) -> f64| {
            let (tilt, yaw) = (of(&self.tilt) as f32, of(&self.yaw) as f32);
            vec3(tilt, tilt, yaw)
        };
        control.rate_p = three(|gains| gains.p);
        control.rate_i = three(|gains| gains.i);
        control.rate_d = three(|gains| gains.d);
        control.tilt_p = self.tilt.k as f32;
        control.heading_p = self.yaw.k as f32;
        let [x, y, z] = self.max_integral_rad_s2.map(|max| max as f32);
        control.max_integral_rad_s2 = vec3(x, y, z);
    }
}

/// Phase margin for which gains are proposed, degrees: the step response overshoots by a few percent.
pub const MARGIN_DEG: f64 = 60.0;
