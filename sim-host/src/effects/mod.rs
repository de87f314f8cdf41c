//! What a scene can add to the perfect world: errors of sensors, and forces, lags and failures of vehicles.
//!
//! **An effect that a scene does not name is not built**: no random draw, no branch in the loop, no memory.
//! The lists below hold only what was named. An effect lives in one file with its formula, its source, its
//! parameters as a scene writes them (units in the keys), and a test against a closed form.
//!
//! # Order
//! Effects apply in the order in which `scene/effects.rs` lists them; the order follows the signal. Faults
//! (`scene/faults.rs`) are in the chip: they come before what delays and loses its samples.
//!
//! ```text
//!  stick ─► link ─► flight code ─► pulse ─► command ─► rotor speed ─► thrust ─► force and torque ─► motion
//!                       ▲                   (ESC, battery, failure)   (ground effect)  (drag, wind, …)   │
//!                       └── delivery ◄── converter ◄── reading effects ◄── truth ◄───────────────────────┘
//!                           (latency, loss, faults)    (bias, noise, …)
//! ```
//!
//! # Randomness
//! Each effect draws from its own streams, one an axis, seeded by (scene seed, effect, axis): see
//! [`random`]. Switching one effect on or off never moves another's draws.

pub mod delivery;
pub mod sensor;
pub mod vehicle;

use flight_core::geometry::Vec3;

/// Whether this build has optional effects at all. The feature `bare` compiles every place that looks for them
/// out, to measure what looking costs a scene that names none: `sim-host/benches/cost-of-nothing`.
pub(crate) const OPTIONAL: bool = !cfg!(feature = "bare");

use crate::state::State;
use ::vehicle::VehicleParams;
use input::InputError;

/// What an effect may know when it is built.
#[derive(Clone, Copy, Debug)]
pub struct Build<'a> {
    /// Full name, `gyro.white_noise`: the key of its random streams.
    pub name: &'a str,
    /// Seed of the scene.
    pub seed: u64,
    /// How often the effect applies, Hz.
    pub rate_hz: f64,
    /// Length of the scene, s.
    pub duration_s: f64,
    /// The vehicle.
    pub vehicle: &'a VehicleParams,
}

impl Build<'_> {
    /// Time between two applications, s.
    pub fn interval_s(&self) -> f64 {
        1.0 / self.rate_hz
    }
}

/// The parameters of an effect as a scene names them.
pub trait Recipe {
    /// What is built from them.
    type Effect;
    /// Checks the ranges; `key` is the table's name, for the error.
    ///
    /// # Errors
    /// A value outside its range.
    fn validate(&self, key: &str) -> Result<(), InputError>;
    /// Builds the effect.
    fn build(&self, with: &Build) -> Self::Effect;
}

/// The truth at the time of a sample.
#[derive(Clone, Copy, Debug)]
pub struct Snapshot<'a> {
    /// Time, s.
    pub time_s: f64,
    /// Position, velocity, attitude, rates.
    pub state: &'a State,
    /// At the centre of gravity, m/s², body axes.
    pub specific_force: Vec3<f64>,
    /// rad/s², body axes.
    pub angular_acceleration: Vec3<f64>,
    /// Rotor speeds, rad/s.
    pub rotors: [f64; 4],
}

/// An error of a three-axis sensor: takes a reading in the sensor's SI unit (magnetometer: µT), body axes,
/// and makes of it what the sensor does.
pub trait SensorEffect: Send {
    /// Applies the error to one sample. In place: the chain of effects copies no reading.
    fn apply_to(&mut self, reading: &mut Vec3<f64>, at: &Snapshot);

    /// The same by value.
    fn apply(&mut self, mut reading: Vec3<f64>, at: &Snapshot) -> Vec3<f64> {
        self.apply_to(&mut reading, at);
        reading
    }
}

/// A boxed [`SensorEffect`].
pub type BoxedSensorEffect = Box<dyn SensorEffect>;
