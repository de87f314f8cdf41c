//! What the tests of all vehicle effects need: a build for OS4 at 1 kHz, and a call of each kind.

use flight_core::geometry::{Quaternion, Vec3, vec3};

use super::{BodyEffect as _, CommandEffect, Load, Stage, VehicleEffect, WindEffect};
use crate::effects::{Build, Recipe, Snapshot};
use crate::state::State;
use ::vehicle::{GRAVITY, VehicleParams};

/// Level, at rest, 100 m up.
pub const STATE: State = State {
    position: vec3(0.0, 0.0, -100.0),
    velocity: Vec3::ZERO,
    attitude: Quaternion::IDENTITY,
    rates: Vec3::ZERO,
};

fn build(recipe: &impl Recipe<Effect = VehicleEffect>, seed: u64) -> VehicleEffect {
    recipe.validate("test").expect("a valid recipe");
    let vehicle = &VehicleParams::OS4;
    recipe.build(&Build { name: "test", seed, rate_hz: 1000.0, duration_s: 60.0, vehicle })
}

/// An effect on the command.
pub fn command(recipe: &impl Recipe<Effect = VehicleEffect>) -> Box<dyn CommandEffect> {
    match build(recipe, 1) {
        VehicleEffect::Command(effect) => effect,
        _ => panic!("no effect on the command"),
    }
}

/// An effect on the air.
pub fn wind(recipe: &impl Recipe<Effect = VehicleEffect>, seed: u64) -> Box<dyn WindEffect> {
    match build(recipe, seed) {
        VehicleEffect::Wind(effect) => effect,
        _ => panic!("no effect on the air"),
    }
}

/// A moment in this state, unaccelerated.
pub fn moment(state: &State, time_s: f64, rotors: [f64; 4]) -> Snapshot<'_> {
    Snapshot {
        time_s,
        state,
        specific_force: state.attitude.conjugate().rotate(vec3(0.0, 0.0, -GRAVITY)),
        angular_acceleration: Vec3::ZERO,
        rotors,
    }
}

/// What the effects of the kinds that act inside a step make of an unloaded body and these thrusts. The
/// airspeed is the state's velocity.
pub fn applied(
    recipe: &impl Recipe<Effect = VehicleEffect>,
    state: &State,
    rotors: [f64; 4],
    rotor_accelerations: [f64; 4],
    mut thrusts: [f64; 4],
) -> (Load, [f64; 4]) {
    let matrix = state.attitude.to_matrix();
    let at = Stage { state, matrix: &matrix, rotors, rotor_accelerations, airspeed: state.velocity };
    let mut load = Load { force: Vec3::ZERO, torque: Vec3::ZERO };
    match build(recipe, 1) {
        VehicleEffect::Thrust(effect) => effect.apply(&mut thrusts, &at),
        VehicleEffect::Body(effect) => effect.apply(&mut load, &thrusts, &at),
        _ => panic!("no effect inside a step"),
    }
    (load, thrusts)
}
