//! Test support for sensor effects: builds an effect, and makes snapshots of a vehicle at rest.

use flight_core::geometry::{Quaternion, Vec3, vec3};

use crate::effects::{BoxedSensorEffect, BuildContext, EffectParams, Snapshot};
use crate::state::State;
use ::vehicle::{GRAVITY, VehicleParams};

/// Builds an effect from its parameters, for samples at this rate.
pub fn build(params: &impl EffectParams<Effect = BoxedSensorEffect>, rate_hz: f64) -> BoxedSensorEffect {
    build_seeded(params, rate_hz, 1)
}

/// Does the same with a seed.
pub fn build_seeded(
    params: &impl EffectParams<Effect = BoxedSensorEffect>,
    rate_hz: f64,
    seed: u64,
) -> BoxedSensorEffect {
    build_with(params, "test", rate_hz, seed)
}

/// Does the same for an effect of any kind, with a name.
pub fn build_with<R: EffectParams>(params: &R, name: &str, rate_hz: f64, seed: u64) -> R::Effect {
    params.validate(name).expect("valid parameters");
    params.build(&BuildContext { name, seed, rate_hz, duration_s: 3600.0, vehicle: &VehicleParams::OS4 })
}

/// State of a level vehicle at rest.
pub const STATE: State =
    State { position: Vec3::ZERO, velocity: Vec3::ZERO, attitude: Quaternion::IDENTITY, rates: Vec3::ZERO };

/// Calls `f` with the snapshot of a vehicle at rest.
pub fn at_rest<T>(f: impl FnOnce(&Snapshot) -> T) -> T {
    f(&snapshot(&STATE, 0.0))
}

/// Returns a snapshot of this state at `time_s`, without acceleration and with the rotors at rest.
pub fn snapshot(state: &State, time_s: f64) -> Snapshot<'_> {
    Snapshot {
        time_s,
        state,
        specific_force: state.attitude.conjugate().rotate(vec3(0.0, 0.0, -GRAVITY)),
        angular_acceleration: Vec3::ZERO,
        rotors: [0.0; 4],
    }
}
