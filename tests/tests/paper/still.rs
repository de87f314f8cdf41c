//! A level vehicle at rest, and effects built without a scene.

use flight_core::geometry::{Quaternion, Vec3, vec3};
use sim_host::dynamics::{GRAVITY, State, VehicleParams};
use sim_host::effects::sensor::AccelWhiteNoise;
use sim_host::effects::vehicle::VehicleEffect;
use sim_host::effects::{BuildContext, EffectParams, Snapshot};
use sim_host::sensors::{Converter, Sensor};

/// The truth of the vehicle at rest.
pub const STILL: Snapshot<'static> = Snapshot {
    time_s: 0.0,
    state: &State {
        position: Vec3::ZERO,
        velocity: Vec3::ZERO,
        attitude: Quaternion::IDENTITY,
        rates: Vec3::ZERO,
    },
    specific_force: vec3(0.0, 0.0, -GRAVITY),
    angular_acceleration: Vec3::ZERO,
    rotors: [0.0; 4],
};

fn context(name: &str, seed: u64, rate_hz: f64) -> BuildContext<'_> {
    BuildContext { name, seed, rate_hz, duration_s: 3600.0, vehicle: &VehicleParams::OS4 }
}

/// Returns a sensor with white noise of density `n` (unit/√Hz) and no other error.
pub fn white_noise(n: f64, rate_hz: f64, seed: u64, name: &'static str) -> Sensor {
    let params = AccelWhiteNoise { n_m_s2_per_sqrt_hz: [n; 3] };
    let noise = params.build(&context(name, seed, rate_hz));
    Sensor::new(vec![(name, noise)], Converter::new(1.0))
}

/// Returns an effect on OS4, for steps of 1 ms.
pub fn on_os4(params: &impl EffectParams<Effect = VehicleEffect>) -> (&'static str, VehicleEffect) {
    let name = "paper";
    params.validate(name).unwrap_or_else(|error| panic!("{error}"));
    (name, params.build(&context(name, 1, 1000.0)))
}
