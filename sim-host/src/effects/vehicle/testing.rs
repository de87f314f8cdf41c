//! Test support for vehicle effects: builds an effect for OS4 at 1 kHz, and applies an effect of each kind.

use flight_core::geometry::{Quaternion, Vec3, vec3};

use super::{BodyEffect as _, CommandEffect, Load, Stage, VehicleEffect, WindEffect};
use crate::effects::{BuildContext, EffectParams, Snapshot};
use crate::state::State;
use ::vehicle::{GRAVITY, VehicleParams};

/// State of a level vehicle at rest, 100 m above the ground.
pub const STATE: State = State {
    position: vec3(0.0, 0.0, -100.0),
    velocity: Vec3::ZERO,
    attitude: Quaternion::IDENTITY,
    rates: Vec3::ZERO,
};

fn build(params: &impl EffectParams<Effect = VehicleEffect>, seed: u64) -> VehicleEffect {
    params.validate("test").expect("valid parameters");
    let vehicle = &VehicleParams::OS4;
    params.build(&BuildContext { name: "test", seed, rate_hz: 1000.0, duration_s: 60.0, vehicle })
}

/// Builds an effect on the command.
pub fn command(params: &impl EffectParams<Effect = VehicleEffect>) -> Box<dyn CommandEffect> {
    match build(params, 1) {
        VehicleEffect::Command(effect) => effect,
        _ => panic!("no effect on the command"),
    }
}

/// Builds an effect on the air.
pub fn wind(params: &impl EffectParams<Effect = VehicleEffect>, seed: u64) -> Box<dyn WindEffect> {
    match build(params, seed) {
        VehicleEffect::Wind(effect) => effect,
        _ => panic!("no effect on the air"),
    }
}

/// Returns a snapshot of this state, without acceleration.
pub fn snapshot(state: &State, time_s: f64, rotors: [f64; 4]) -> Snapshot<'_> {
    Snapshot {
        time_s,
        state,
        specific_force: state.attitude.conjugate().rotate(vec3(0.0, 0.0, -GRAVITY)),
        angular_acceleration: Vec3::ZERO,
        rotors,
    }
}

/// Applies an effect that acts inside a step to an unloaded body and these thrusts. Returns the load and the thrusts.
/// The airspeed is the state's velocity.
pub fn applied(
    params: &impl EffectParams<Effect = VehicleEffect>,
    state: &State,
    rotors: [f64; 4],
    rotor_accelerations: [f64; 4],
    mut thrusts: [f64; 4],
) -> (Load, [f64; 4]) {
    let matrix = state.attitude.to_matrix();
    let at = Stage { state, matrix: &matrix, rotors, rotor_accelerations, airspeed: state.velocity };
    let mut load = Load { force: Vec3::ZERO, torque: Vec3::ZERO };
    match build(params, 1) {
        VehicleEffect::Thrust(effect) => effect.apply(&mut thrusts, &at),
        VehicleEffect::Body(effect) => effect.apply(&mut load, &thrusts, &at),
        _ => panic!("no effect inside a step"),
    }
    (load, thrusts)
}
