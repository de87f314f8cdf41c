//! What the tests of all sensor effects need: a place to be at rest in, and a build.

use flight_core::geometry::{Quaternion, Vec3, vec3};

use crate::effects::{BoxedSensorEffect, Build, Recipe, Snapshot};
use crate::state::State;
use ::vehicle::{GRAVITY, VehicleParams};

/// Builds an effect from its recipe, for samples at this rate.
pub fn build(recipe: &impl Recipe<Effect = BoxedSensorEffect>, rate_hz: f64) -> BoxedSensorEffect {
    build_seeded(recipe, rate_hz, 1)
}

/// The same with a seed.
pub fn build_seeded(
    recipe: &impl Recipe<Effect = BoxedSensorEffect>,
    rate_hz: f64,
    seed: u64,
) -> BoxedSensorEffect {
    build_with(recipe, "test", rate_hz, seed)
}

/// The same for an effect of any kind, with a name.
pub fn build_with<R: Recipe>(recipe: &R, name: &str, rate_hz: f64, seed: u64) -> R::Effect {
    recipe.validate(name).expect("a valid recipe");
    recipe.build(&Build { name, seed, rate_hz, duration_s: 3600.0, vehicle: &VehicleParams::OS4 })
}

/// Level, at rest, at time zero.
pub const STATE: State =
    State { position: Vec3::ZERO, velocity: Vec3::ZERO, attitude: Quaternion::IDENTITY, rates: Vec3::ZERO };

/// Calls with the moment of a vehicle at rest.
pub fn at_rest<T>(f: impl FnOnce(&Snapshot) -> T) -> T {
    f(&moment(&STATE, 0.0))
}

/// A moment at time `time_s` in this state, unaccelerated, with the rotors standing.
pub fn moment(state: &State, time_s: f64) -> Snapshot<'_> {
    Snapshot {
        time_s,
        state,
        specific_force: state.attitude.conjugate().rotate(vec3(0.0, 0.0, -GRAVITY)),
        angular_acceleration: Vec3::ZERO,
        rotors: [0.0; 4],
    }
}
