//! Forces, torques, lags and failures of the vehicle, one file each.
//!
//! | kind | acts on | called |
//! |---|---|---|
//! | [`CommandEffect`] | the speeds that the ESCs ask of the rotors | once a step |
//! | [`WindEffect`] | the velocity of the air | once a step |
//! | [`ThrustEffect`] | the thrust of each rotor | at every stage of the integration |
//! | [`BodyEffect`] | force and torque on the body | at every stage of the integration |
//!
//! Contact with the ground is no effect: without it nothing could take off or land, so it is part of
//! [`crate::dynamics::Mount::Free`], and a vehicle on a ball joint has none.

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

/// A point in time inside a step, while the motion is integrated.
#[derive(Clone, Copy, Debug)]
pub struct Stage<'a> {
    /// The state here.
    pub state: &'a State,
    /// Its attitude as a matrix, body to world.
    pub matrix: &'a Mat3<f64>,
    /// Rotor speeds, rad/s.
    pub rotors: [f64; 4],
    /// Their rates of change, rad/s².
    pub rotor_accelerations: [f64; 4],
    /// Velocity of the vehicle through the air, m/s, north, east, down.
    pub airspeed: Vec3<f64>,
}

/// Force and torque on the body.
#[derive(Clone, Copy, Debug)]
pub struct Load {
    /// N, north, east, down.
    pub force: Vec3<f64>,
    /// N·m, body axes, about the centre of gravity.
    pub torque: Vec3<f64>,
}

/// Changes what the ESCs ask of the rotors.
pub trait CommandEffect: Send {
    /// Changes the wanted speeds, rad/s.
    fn apply(&mut self, wanted: &mut [f64; 4], at: &Snapshot);

    /// Terminal voltage of the battery that this effect is, V.
    fn battery_v(&self) -> Option<f64> {
        None
    }
}

/// Moves the air.
pub trait WindEffect: Send {
    /// Velocity of the air for the coming step, m/s, north, east, down; effects add up.
    fn velocity(&mut self, at: &Snapshot) -> Vec3<f64>;
}

/// Changes the thrust of the rotors.
pub trait ThrustEffect: Send {
    /// Changes the thrusts, N.
    fn apply(&self, thrusts: &mut [f64; 4], at: &Stage);
}

/// Adds force and torque to the body.
pub trait BodyEffect: Send {
    /// Adds to the load. `thrusts` are those of the rotors, N.
    fn apply(&self, load: &mut Load, thrusts: &[f64; 4], at: &Stage);

    /// Whether the load jumps with the command, although rotors with a lag do not.
    fn follows_command_at_once(&self) -> bool {
        false
    }
}

/// Rotors of their own: the share of the vehicle's thrust coefficient that each has. It is drawn, not named:
/// see [`crate::scene`]'s tolerances.
pub struct ThrustShares(pub [f64; 4]);

impl ThrustEffect for ThrustShares {
    fn apply(&self, thrusts: &mut [f64; 4], _: &Stage) {
        thrusts.iter_mut().zip(self.0).for_each(|(thrust, share)| *thrust *= share);
    }
}

/// A vehicle effect of any kind, as built.
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

/// Every [`BodyEffect`]. The effects of a scene are called four times a step, one after the other, each adding
/// to what the one before has left: named here the compiler keeps that in registers, where calls through
/// pointers would pass it through memory.
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
