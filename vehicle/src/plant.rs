//! The open loops of the control cascade, broken at the rotors' command.
//!
//! ```text
//!  L(s) = (P + I/s + D s + K (P + I/s)/s) F(s) e^(−s T) / ((1 + s τ) s)
//! ```
//! P, I and D are the gains of the rate loop and K is the gain of the angle loop ([`ControlParams`]). F is the prefilter,
//! T the time from a sample to its command at the motor, and τ the rotors' lag. The inertia does not appear, because the
//! rate loop's output is an angular acceleration.

use std::f64::consts::{SQRT_2, TAU};

use flight_core::control::ControlParams;
use num_complex::Complex64;

use crate::{EscProtocol, Vehicle, VehicleParams};

/// Sample rate of the control loop, Hz.
const RATE_HZ: f64 = 1_000.0;

/// The controlled system: rotors, prefilter and delay.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plant {
    /// Time constant of the rotors τ, s.
    pub lag_s: f64,
    /// Cutoff of the prefilter (a second-order Butterworth low-pass), Hz; `None` for no prefilter.
    pub prefilter_hz: Option<f64>,
    /// Time T from a sample to its command at the motor, s.
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

/// The gains of one axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Loop {
    /// Proportional gain of the rate loop, 1/s.
    pub p: f64,
    /// Integral gain of the rate loop, 1/s².
    pub i: f64,
    /// Derivative gain of the rate loop, dimensionless.
    pub d: f64,
    /// Proportional gain of the angle loop, 1/s.
    pub k: f64,
}

/// The crossover of a loop (the frequency at which its gain is 1) and the phase margin there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Margin {
    /// Crossover, rad/s.
    pub crossover_rad_s: f64,
    /// Phase margin, degrees.
    pub phase_deg: f64,
}

impl Plant {
    /// Returns the plant of a vehicle.
    pub fn of(vehicle: &Vehicle) -> Self {
        Self::new(&vehicle.params, vehicle.prefilter_hz, vehicle.esc)
    }

    /// Returns the plant of these rotors with this prefilter and this ESC protocol.
    pub fn new(params: &VehicleParams, prefilter_hz: Option<f64>, esc: EscProtocol) -> Self {
        Self { lag_s: params.lag_s, prefilter_hz, delay_s: delay_s(esc) }
    }

    /// Returns the prefilter's delay of low frequencies, s: √2/(2π f), the slope of its phase at zero frequency.
    pub fn prefilter_delay_s(&self) -> f64 {
        self.prefilter_hz.map_or(0.0, |hz| SQRT_2 / (TAU * hz))
    }

    /// Returns the open loop's complex response at ω = `w` rad/s.
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

    /// Returns the margin at the highest frequency at which the loop's gain is 1.
    pub fn margin(&self, gains: &Loop) -> Margin {
        let gain = |w: f64| self.open_loop(gains, w).norm();
        // The search starts at 10⁴ rad/s, where the gain is below 1, and goes down in steps of 2 % until the gain is at
        // least 1. Bisection then refines the crossover.
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
        // The margin counts from −180°: a loop with more lag has a negative margin.
        let margin = phase_deg + 180.0;
        Margin { crossover_rad_s: low, phase_deg: if margin > 180.0 { margin - 360.0 } else { margin } }
    }
}

/// Returns the time from a sample to its command at the motor, s: half of the period during which a command holds, plus
/// the protocol's time (docs/timing.md).
fn delay_s(esc: EscProtocol) -> f64 {
    let protocol = match esc {
        // The delay is half of the 2.5 ms period of the pulses, plus a pulse of 1.5 ms.
        EscProtocol::Pwm => 2.75e-3,
        EscProtocol::OneShot125 => 0.2e-3,
        EscProtocol::DShot300 => 0.06e-3,
        EscProtocol::DShot600 => 0.03e-3,
    };
    0.5 / RATE_HZ + protocol
}

impl Loop {
    /// Returns the gains of an axis.
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
