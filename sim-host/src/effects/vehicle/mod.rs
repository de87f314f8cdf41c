//! Forces, torques, lags and failures of the vehicle. One file for each effect.
//!
//! | kind | acts on | called |
//! |---|---|---|
//! | [`CommandEffect`] | the commanded rotor speeds | once per step |
//! | [`WindEffect`] | the velocity of the air | once per step |
//! | [`ThrustEffect`] | the thrust of each rotor | at every stage of the integration |
//! | [`BodyEffect`] | force and torque on the body | at every stage of the integration |
//!
//! Contact with the ground is not an effect: without it a vehicle could not take off or land. It is part of
//! [`crate::dynamics::Mount::Free`]; a vehicle on a ball joint has no ground contact.

mod battery_sag;
mod cg_offset;
mod constant_wind;
mod dryden;
mod esc_delay;
mod esc_quantization;
mod ground_effect;
mod linear_drag;
mod motor_failure;
mod motor_lag;
mod quadratic_drag;
mod rotor_acceleration;
mod rotor_drag;
mod rotor_gyroscopic;
#[cfg(test)]
mod testing;

use flight_core::geometry::{Mat3, Vec3};

pub use battery_sag::BatterySag;
pub use cg_offset::CgOffset;
pub use constant_wind::ConstantWind;
pub use dryden::Dryden;
pub use esc_delay::EscDelay;
pub use esc_quantization::EscQuantization;
pub use ground_effect::GroundEffect;
pub use linear_drag::LinearDrag;
pub use motor_failure::MotorFailure;
pub use motor_lag::{Lag, MotorLag, Point};
pub use quadratic_drag::QuadraticDrag;
pub use rotor_acceleration::RotorAcceleration;
pub use rotor_drag::RotorDrag;
pub use rotor_gyroscopic::RotorGyroscopic;

use super::Snapshot;
use crate::state::State;

/// The state at one stage of the integration of a step.
#[derive(Clone, Copy, Debug)]
pub struct Stage<'a> {
    /// State of the vehicle.
    pub state: &'a State,
    /// Its attitude as a matrix, body to world.
    pub matrix: &'a Mat3<f64>,
    /// Rotor speeds, rad/s.
    pub rotors: [f64; 4],
    /// Rates of change of the rotor speeds, rad/s².
    pub rotor_accelerations: [f64; 4],
    /// Velocity of the vehicle through the air, m/s, north, east, down.
    pub airspeed: Vec3<f64>,
}

/// Force and torque on the body.
#[derive(Clone, Copy, Debug)]
pub struct Load {
    /// Force, N, north, east, down.
    pub force: Vec3<f64>,
    /// Torque, N·m, body axes, about the centre of gravity.
    pub torque: Vec3<f64>,
}

/// An effect on the commanded rotor speeds.
pub trait CommandEffect: Send {
    /// Changes the commanded speeds, rad/s.
    fn apply(&mut self, wanted: &mut [f64; 4], at: &Snapshot);

    /// Returns the terminal voltage, V, if this effect is a battery.
    fn battery_v(&self) -> Option<f64> {
        None
    }
}

/// An effect on the air.
pub trait WindEffect: Send {
    /// Returns the velocity of the air in the next step, m/s, north, east, down. The effects add up.
    fn velocity(&mut self, at: &Snapshot) -> Vec3<f64>;
}

/// An effect on the thrust of the rotors.
pub trait ThrustEffect: Send {
    /// Changes the thrusts, N.
    fn apply(&self, thrusts: &mut [f64; 4], at: &Stage);
}

/// A force and a torque on the body.
pub trait BodyEffect: Send {
    /// Adds the effect's force and torque to the load. `thrusts` are the thrusts of the rotors, N.
    fn apply(&self, load: &mut Load, thrusts: &[f64; 4], at: &Stage);

    /// Returns true if the load jumps with the command, although the speeds of rotors with a lag do not jump.
    fn follows_command_at_once(&self) -> bool {
        false
    }
}

/// The thrust coefficient of each rotor, as a share of the vehicle's. The shares are drawn from a scene's tolerances
/// instead of being named as an effect: see [`crate::scene`].
pub struct ThrustShares(pub [f64; 4]);

impl ThrustEffect for ThrustShares {
    fn apply(&self, thrusts: &mut [f64; 4], _: &Stage) {
        thrusts.iter_mut().zip(self.0).for_each(|(thrust, share)| *thrust *= share);
    }
}

/// A vehicle effect of any kind, after it is built.
pub enum VehicleEffect {
    /// On the command.
    Command(Box<dyn CommandEffect>),
    /// Between command and rotor speed.
    Lag(Lag),
    /// On the air.
    Wind(Box<dyn WindEffect>),
    /// On the rotors' thrust.
    Thrust(Box<dyn ThrustEffect>),
    /// On the body.
    Body(Body),
}

/// Any [`BodyEffect`]. The effects of a scene are called four times per step, one after the other, and each adds to
/// the load. With an enum the compiler keeps the load in registers; calls through pointers would pass it through
/// memory.
#[derive(Debug)]
pub enum Body {
    /// [`LinearDrag`]
    LinearDrag(linear_drag::Drag),
    /// [`QuadraticDrag`]
    QuadraticDrag(quadratic_drag::Drag),
    /// [`RotorDrag`]
    RotorDrag(rotor_drag::HForce),
    /// [`RotorGyroscopic`]
    RotorGyroscopic(rotor_gyroscopic::Gyroscope),
    /// [`RotorAcceleration`]
    RotorAcceleration(rotor_acceleration::Reaction),
    /// [`CgOffset`]
    CgOffset(cg_offset::Offset),
}

impl BodyEffect for Body {
    #[inline(always)]
    fn apply(&self, load: &mut Load, thrusts: &[f64; 4], at: &Stage) {
        match self {
            Self::LinearDrag(effect) => effect.apply(load, thrusts, at),
            Self::QuadraticDrag(effect) => effect.apply(load, thrusts, at),
            Self::RotorDrag(effect) => effect.apply(load, thrusts, at),
            Self::RotorGyroscopic(effect) => effect.apply(load, thrusts, at),
            Self::RotorAcceleration(effect) => effect.apply(load, thrusts, at),
            Self::CgOffset(effect) => effect.apply(load, thrusts, at),
        }
    }

    fn follows_command_at_once(&self) -> bool {
        match self {
            Self::RotorAcceleration(effect) => effect.follows_command_at_once(),
            _ => false,
        }
    }
}
