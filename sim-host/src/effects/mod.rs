//! The effects that a scene can name: errors of sensors, and forces, lags and failures of the vehicle.
//!
//! **An effect that a scene does not name is not built**: it costs no random draw, no branch in the loop and no
//! memory. The simulation's lists hold only the effects that the scene names. Each effect has one file with its
//! formula, its source, its parameters as a scene writes them (units in the keys), and a test against a closed
//! form.
//!
//! # Order
//! Effects apply in the order in which `scene/effects.rs` lists them; the order follows the signal. Faults
//! (`scene/faults.rs`) are inside the chip: they apply before the effects that delay or lose its samples.
//!
//! ```text
//!  stick ─► link ─► flight code ─► pulse ─► command ─► rotor speed ─► thrust ─► force and torque ─► motion
//!                       ▲                   (ESC, battery, failure)   (ground effect)  (drag, wind, …)   │
//!                       └── delivery ◄── converter ◄── reading effects ◄── truth ◄───────────────────────┘
//!                           (latency, loss, faults)    (bias, noise, …)
//! ```
//!
//! # Randomness
//! Each effect draws from its own streams, one for each axis, seeded by (scene seed, effect, axis): see
//! [`random`]. Switching one effect on or off never changes the draws of another.

pub mod delivery;
pub mod sensor;
pub mod vehicle;

use flight_core::geometry::Vec3;

/// True if this build supports optional effects. The feature `bare` removes every check for them at compile time,
/// to measure what the checks cost a scene without effects: `sim-host/benches/cost-of-nothing`.
pub(crate) const OPTIONAL_EFFECTS: bool = !cfg!(feature = "bare");

use crate::state::State;
use ::vehicle::VehicleParams;
use input::InputError;

/// The data from which an effect is built, besides its own parameters.
#[derive(Clone, Copy, Debug)]
pub struct BuildContext<'a> {
    /// Full name of the effect, such as `gyro.white_noise`. It is also the key of its random streams.
    pub name: &'a str,
    /// Seed of the scene.
    pub seed: u64,
    /// Rate at which the effect applies, Hz.
    pub rate_hz: f64,
    /// Length of the scene, s.
    pub duration_s: f64,
    /// The vehicle.
    pub vehicle: &'a VehicleParams,
}

impl BuildContext<'_> {
    /// Returns the time between two applications, s.
    pub fn interval_s(&self) -> f64 {
        1.0 / self.rate_hz
    }
}

/// The parameters of an effect, as a scene gives them.
pub trait EffectParams {
    /// The effect that is built from them.
    type Effect;
    /// Checks the ranges. `key` is the name of the table, for the error message.
    ///
    /// # Errors
    /// A value is outside its range.
    fn validate(&self, key: &str) -> Result<(), InputError>;
    /// Returns the time at which the effect begins, s, if its parameters have the key `at_s`.
    fn at_s(&self) -> Option<f64> {
        None
    }
    /// Builds the effect.
    fn build(&self, context: &BuildContext) -> Self::Effect;
}

/// The truth at the time of a sample.
#[derive(Clone, Copy, Debug)]
pub struct Snapshot<'a> {
    /// Time, s.
    pub time_s: f64,
    /// Position, velocity, attitude, rates.
    pub state: &'a State,
    /// Specific force at the centre of gravity, m/s², body axes.
    pub specific_force: Vec3<f64>,
    /// Angular acceleration, rad/s², body axes.
    pub angular_acceleration: Vec3<f64>,
    /// Rotor speeds, rad/s.
    pub rotors: [f64; 4],
}

/// An error of a three-axis sensor. Readings are in the sensor's SI unit (magnetometer: µT), in body axes.
pub trait SensorEffect: Send {
    /// Applies the error to one reading, in place, so that a chain of effects copies no reading.
    fn apply_to(&mut self, reading: &mut Vec3<f64>, at: &Snapshot);

    /// Applies the error to a copy of the reading.
    fn apply(&mut self, mut reading: Vec3<f64>, at: &Snapshot) -> Vec3<f64> {
        self.apply_to(&mut reading, at);
        reading
    }
}

/// A boxed [`SensorEffect`].
pub type BoxedSensorEffect = Box<dyn SensorEffect>;
