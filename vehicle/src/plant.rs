//! The loops of the cascade, broken at the rotors.
//!
//! ```text
//!  L(s) = (P + I/s + D s + K (P + I/s)/s) F(s) e^(−s T) / ((1 + s τ) s)
//! ```
//! P, I and D are the rate loop's gains and K the angle loop's ([`ControlParams`]), F the prefilter, T the time from a
//! sample to its command at the motor, τ the rotors' lag. The inertia is not in it: the rate loop's gains are in angular
//! acceleration.

use std::f64::consts::{SQRT_2, TAU};

use flight_core::control::ControlParams;
use num_complex::Complex64;

use crate::{EscProtocol, Vehicle, VehicleParams};

/// Samples a second.
const RATE_HZ: f64 = 1_000.0;

/// What the loops act on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plant {
    /// τ, the rotors' lag, s.
    pub lag_s: f64,
    /// Cutoff of the prefilter, a Butterworth of 2nd order, Hz.
    pub prefilter_hz: Option<f64>,
    /// T, s.
    pub delay_s: f64,
}

/// An axis of the cascade.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Axis {
    /// Roll, with the angle loop of tilt.
    Roll,
    /// Pitch, with the angle loop of tilt.
    Pitch,
    /// Yaw, with the angle loop of heading.
    Yaw,
}

/// A loop of one axis: its gains.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Loop {
    /// Rate loop, 1/s.
    pub p: f64,
    /// Rate loop, 1/s².
    pub i: f64,
    /// Rate loop, dimensionless.
    pub d: f64,
    /// Angle loop, 1/s.
    pub k: f64,
}

/// Where a loop's gain passes 1, and what it has left there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Margin {
    /// rad/s.
    pub crossover_rad_s: f64,
    /// Degrees.
    pub phase_deg: f64,
}

impl Plant {
    /// That of a vehicle.
    pub fn of(vehicle: &Vehicle) -> Self {
        Self::new(&vehicle.params, vehicle.prefilter_hz, vehicle.esc)
    }

    /// That of rotors behind this prefilter and this protocol.
    pub fn new(params: &VehicleParams, prefilter_hz: Option<f64>, esc: EscProtocol) -> Self {
        Self { lag_s: params.lag_s, prefilter_hz, delay_s: delay_s(esc) }
    }

    /// How long the prefilter delays low frequencies, s: √2/(2π f), the slope of its phase at zero.
    pub fn prefilter_delay_s(&self) -> f64 {
        self.prefilter_hz.map_or(0.0, |hz| SQRT_2 / (TAU * hz))
    }

    /// The loop's response at ω rad/s.
    pub fn open_loop(&self, gains: &Loop, w: f64) -> Complex64 {
        let s = Complex64::new(0.0, w);
        let Loop { p, i, d, k } = *gains;
        let controller = p + i / s + d * s + k * (p + i / s) / s;
        let prefilter = self.prefilter_hz.map_or(Complex64::new(1.0, 0.0), |hz| {
            let x = s / (TAU * hz);
            1.0 / (x * x + SQRT_2 * x + 1.0)
        });
        controller * prefilter * (-s * self.delay_s).exp() / ((1.0 + s * self.lag_s) * s)
    }

    /// The margin at the highest frequency at which the loop has a gain of 1.
    pub fn margin(&self, gains: &Loop) -> Margin {
        let gain = |w: f64| self.open_loop(gains, w).norm();
        // Down from where it certainly is below 1, then between the two neighbours.
        let (mut low, mut high) = (1.0e4, 1.0e4);
        while gain(low) < 1.0 && low > 1.0e-3 {
            high = low;
            low *= 0.98;
        }
        for _ in 0..50 {
            let middle = (low * high).sqrt();
            if gain(middle) < 1.0 { high = middle } else { low = middle }
        }
        let phase_deg = self.open_loop(gains, low).arg().to_degrees();
        // From −180°: a loop that lags more than that has a negative margin.
        let margin = phase_deg + 180.0;
        Margin { crossover_rad_s: low, phase_deg: if margin > 180.0 { margin - 360.0 } else { margin } }
    }
}

/// From a sample to its command at the motor, s: half a period that a command stands, and what the protocol takes
/// (docs/timing.md).
fn delay_s(esc: EscProtocol) -> f64 {
    let protocol = match esc {
        // Half of the 2.5 ms to the next pulse, and a pulse of 1.5 ms.
        EscProtocol::Pwm => 2.75e-3,
        EscProtocol::OneShot125 => 0.2e-3,
        EscProtocol::DShot300 => 0.06e-3,
        EscProtocol::DShot600 => 0.03e-3,
    };
    0.5 / RATE_HZ + protocol
}

impl Loop {
    /// That of an axis.
    pub fn of(control: &ControlParams, axis: Axis) -> Self {
        let of = |v: flight_core::geometry::Vec3<f32>| {
            f64::from(match axis {
                Axis::Roll => v.x,
                Axis::Pitch => v.y,
                Axis::Yaw => v.z,
            })
        };
        let angle = if axis == Axis::Yaw { control.heading_p } else { control.tilt_p };
        Self { p: of(control.rate_p), i: of(control.rate_i), d: of(control.rate_d), k: f64::from(angle) }
    }
}
