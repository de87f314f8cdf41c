//! Gains for a stated phase margin: docs/tuning.md.

use flight_core::control::ControlParams;
use flight_core::geometry::vec3;

use crate::plant::{Loop, Margin, Plant};
use crate::{GRAVITY, VehicleParams};

/// Gains of the cascade, and the largest integrals.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tuned {
    /// Roll and pitch.
    pub tilt: Loop,
    /// Yaw.
    pub yaw: Loop,
    /// Largest angular acceleration that the integrators may hold: roll, pitch, yaw, rad/s².
    pub max_integral_rad_s2: [f64; 3],
}

/// Shape of a loop: its other gains by P. They keep their proportions to the crossover, which goes with P.
struct Shape {
    /// D/P over the rotors' lag: a zero that leads what the rotors lag.
    lead: f64,
    /// I/P².
    i: f64,
    /// K/P.
    k: f64,
    /// Whether the margin is that of both loops, or of the rate loop alone.
    with_angle: bool,
}

/// Of roll and pitch. The lead of 0.8 τ leaves a fifth of the lag, and a fourth of the noise that all of it would bring.
/// The angle loop at a fifth of P and the integral at a fortieth of it are a decade and more below the crossover.
const TILT: Shape = Shape { lead: 0.8, i: 0.024, k: 0.22, with_angle: true };

/// Of yaw, whose torque is the propellers' drag, and follows their speed without a lead. A heading need not be held as
/// tightly as a tilt: the margin is that of the rate loop, and the angle loop around it takes a third of it.
const YAW: Shape = Shape { lead: 0.0, i: 0.11, k: 0.42, with_angle: false };

/// Largest P, 1/s: beyond it a gyroscope's noise turns the motors.
const MAX_P: f64 = 300.0;

/// Share of what the rotors can do about an axis at hover that the integrators may hold: room for a centre of gravity
/// that is off, and no more.
const INTEGRAL_SHARE: f64 = 0.15;

impl Shape {
    fn at(&self, p: f64, lag_s: f64) -> Loop {
        Loop { p, i: rounded(self.i * p * p), d: rounded(self.lead * lag_s * p), k: rounded(self.k * p) }
    }

    fn margin(&self, plant: &Plant, p: f64) -> Margin {
        let gains = self.at(p, plant.lag_s);
        let k = if self.with_angle { gains.k } else { 0.0 };
        plant.margin(&Loop { k, ..gains })
    }

    /// The gains up to which every smaller P has this phase margin, degrees, and crosses over below 1/τ: beyond it a
    /// rotor's command must be larger than the change that it is to make, and more of them end at a limit.
    fn for_margin(&self, plant: &Plant, margin_deg: f64) -> Loop {
        let enough = |p: f64| {
            let margin = self.margin(plant, p);
            margin.phase_deg >= margin_deg && margin.crossover_rad_s * plant.lag_s <= 1.0
        };
        let (mut low, mut high) = (0.1, 0.1);
        while high < MAX_P && enough(high) {
            low = high;
            high *= 1.02;
        }
        for _ in 0..40 {
            let p = 0.5 * (low + high);
            if enough(p) { low = p } else { high = p }
        }
        self.at(rounded(low), plant.lag_s)
    }
}

/// Three digits: what people write, and the same on every machine, whatever its complex functions do to the last bit.
fn rounded(value: f64) -> f64 {
    format!("{value:.2e}").parse().unwrap_or(value)
}

/// Gains with this phase margin, degrees, or more.
pub fn tune(params: &VehicleParams, plant: &Plant, margin_deg: f64) -> Tuned {
    let tilt = TILT.for_margin(plant, margin_deg);
    let yaw = YAW.for_margin(plant, margin_deg);
    let authority = authority_rad_s2(params);
    Tuned { tilt, yaw, max_integral_rad_s2: authority.map(|most| rounded(INTEGRAL_SHARE * most)) }
}

/// Largest angular accelerations about the body's axes at hover thrust, rad/s².
pub fn authority_rad_s2(params: &VehicleParams) -> [f64; 3] {
    let VehicleParams { thrust_coefficient: b, torque_coefficient: d, inertia_kg_m2: inertia, .. } = params;
    let hover = params.mass_kg * GRAVITY / (4.0 * b);
    // Up and down by as much: the two that slow down can stop, the two that speed up have the rest.
    let room = hover.min(params.max_rad_s * params.max_rad_s - hover).max(0.0);
    let tilt = 4.0 * b * room;
    [tilt * params.right_m / inertia.x, tilt * params.forward_m / inertia.y, 4.0 * d * room / inertia.z]
}

impl Tuned {
    /// These gains in `control`.
    pub fn put_into(&self, control: &mut ControlParams) {
        let three = |of: fn(&Loop) -> f64| {
            let (tilt, yaw) = (of(&self.tilt) as f32, of(&self.yaw) as f32);
            vec3(tilt, tilt, yaw)
        };
        control.rate_p = three(|gains| gains.p);
        control.rate_i = three(|gains| gains.i);
        control.rate_d = three(|gains| gains.d);
        control.tilt_p = self.tilt.k as f32;
        control.heading_p = self.yaw.k as f32;
        let [x, y, z] = self.max_integral_rad_s2.map(|most| most as f32);
        control.max_integral_rad_s2 = vec3(x, y, z);
    }
}

/// The margin that gains are proposed for, degrees: a step overshoots by some percent.
pub const MARGIN_DEG: f64 = 60.0;
