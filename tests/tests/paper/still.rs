//! A vehicle that lies still and level, and effects built apart from a scene.

use flight_core::geometry::{Quaternion, Vec3, vec3};
use sim_host::dynamics::{GRAVITY, State, VehicleParams};
use sim_host::effects::sensor::AccelWhiteNoise;
use sim_host::effects::vehicle::VehicleEffect;
use sim_host::effects::{Build, Recipe, Snapshot};
use sim_host::sensors::{Converter, Sensor};

/// The truth while it lies there.
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

fn with(name: &str, seed: u64, rate_hz: f64) -> Build<'_> {
    Build { name, seed, rate_hz, duration_s: 3600.0, vehicle: &VehicleParams::OS4 }
}

/// A sensor that has white noise of density `n` (unit/√Hz) and no other error.
pub fn white_noise(n: f64, rate_hz: f64, seed: u64, name: &'static str) -> Sensor {
    let recipe = AccelWhiteNoise { n_m_s2_per_sqrt_hz: [n; 3] };
    let noise = recipe.build(&with(name, seed, rate_hz));
    Sensor::new(vec![(name, noise)], Converter::new(1.0))
}

/// An effect on OS4, for steps of 1 ms.
pub fn on_os4(recipe: &impl Recipe<Effect = VehicleEffect>) -> (&'static str, VehicleEffect) {
    let name = "paper";
    recipe.validate(name).unwrap_or_else(|error| panic!("{error}"));
    (name, recipe.build(&with(name, 1, 1000.0)))
}
