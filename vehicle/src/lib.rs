//! A vehicle as a file (`vehicles/NAME.toml`): read, checked, and turned into what the simulator and the flight
//! controller need.
//!
//! ```text
//!  vehicles/five-inch.toml ─► Vehicle ─┬─► VehicleParams: the simulator's vehicle, f64
//!  a scene's [vehicle] on top          └─► Params: the flight controller's configuration, f32
//! ```
//! The file has its figures in the units that people have, and only those that can't be derived. What can be derived is
//! derived here, for this vehicle, and says how ([`Vehicle::derived`]): nothing is taken from another vehicle.
#![forbid(unsafe_code)]
// Tests may round as their machine does.
#![cfg_attr(test, allow(clippy::disallowed_methods))]
#![warn(missing_docs)]

mod file;
mod plant;
mod tune;

use std::path::Path;

use flight_core::config::{DescentParams, Params};
use flight_core::control::ControlParams;
use flight_core::estimator::EstimatorParams;
use flight_core::geometry::{Mat3, Vec3, vec3};
use flight_core::mixer::{Airframe, Spin};
use flight_core::rc::{ArmBy, ChannelMap};
use flight_core::{Config, FlightController};
use input::InputError;
use input::axes::Axes;
use input::layers::{Layers, ReadText, built_in_or_file, text_of};
use toml::de::DeTable;

pub use file::{Cutoff, PREFILTER_ALLOWED, estimator, prefilter_range_hz};
pub use plant::{Axis, Loop, Margin, Plant};
pub use tune::{MARGIN_DEG, Tuned, authority_rad_s2, tune};

/// Standard gravity, m/s².
pub const GRAVITY: f64 = 9.80665;

macro_rules! vehicles {
    ($($name:literal),+ $(,)?) => {
        &[$(($name, include_str!(concat!("../../vehicles/", $name, ".toml")))),+]
    };
}

/// The built-in vehicles: name and text.
pub const BUILT_IN: &[(&str, &str)] = vehicles!["os4", "five-inch", "ten-inch", "hummingbird", "crazyflie"];

/// The vehicle of whoever names none.
pub const DEFAULT: &str = "os4";

/// What the vehicle is made of (symbols of the paper's table 1).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VehicleParams {
    /// m, kg.
    pub mass_kg: f64,
    /// I_xx, I_yy, I_zz, kg·m².
    pub inertia_kg_m2: Vec3<f64>,
    /// J_r, kg·m².
    pub rotor_inertia_kg_m2: f64,
    /// How far the front rotors are forward of the centre of gravity, and the rear ones behind it, m.
    pub forward_m: f64,
    /// How far the right rotors are to the right of it, and the left ones to the left, m.
    pub right_m: f64,
    /// Which way the rotors turn.
    pub spin: Spin,
    /// b, N·s².
    pub thrust_coefficient: f64,
    /// d, N·m·s².
    pub torque_coefficient: f64,
    /// Slowest speed of an armed rotor, rad/s.
    pub idle_rad_s: f64,
    /// Speed of a rotor at full pulse, rad/s.
    pub max_rad_s: f64,
    /// Time constant of a rotor's speed behind its command, s.
    pub lag_s: f64,
    /// Feet below the centre of gravity, m.
    pub feet_m: f64,
    /// Force of the air per speed, north, east, down, kg/s.
    pub drag_kg_per_s: Vec3<f64>,
}

impl VehicleParams {
    /// OS4 (Bouabdallah, EPFL thesis 3727, 2007), as `vehicles/os4.toml` has it.
    pub const OS4: Self = Self {
        mass_kg: 0.65,
        inertia_kg_m2: vec3(7.5e-3, 7.5e-3, 1.3e-2),
        rotor_inertia_kg_m2: 6.0e-5,
        forward_m: 0.23 * std::f64::consts::FRAC_1_SQRT_2,
        right_m: 0.23 * std::f64::consts::FRAC_1_SQRT_2,
        spin: Spin::PropsOut,
        thrust_coefficient: 3.13e-5,
        torque_coefficient: 7.5e-7,
        idle_rad_s: 32.0,
        max_rad_s: 319.0,
        lag_s: 0.05,
        feet_m: 0.05,
        drag_kg_per_s: vec3(0.25, 0.25, 0.25),
    };

    /// l, m: centre of gravity to rotor axis.
    pub fn arm_m(&self) -> f64 {
        libm::hypot(self.forward_m, self.right_m)
    }

    /// Moves the rotors out or in, so that they are `arm_m` from the centre of gravity.
    pub fn set_arm_m(&mut self, arm_m: f64) {
        let share = arm_m / self.arm_m();
        self.forward_m *= share;
        self.right_m *= share;
    }

    /// Thrust of all rotors at full speed, N.
    pub fn max_thrust_n(&self) -> f64 {
        4.0 * self.thrust_coefficient * self.max_rad_s * self.max_rad_s
    }

    /// Throttle at which the rotors carry the weight, 0 to 1: throttle is a share of the largest thrust.
    pub fn hover_throttle(&self) -> f64 {
        self.mass_kg * GRAVITY / self.max_thrust_n()
    }

    /// Speed of the rotors that carry the weight, rad/s.
    pub fn hover_rad_s(&self) -> f64 {
        (self.mass_kg * GRAVITY / (4.0 * self.thrust_coefficient)).sqrt()
    }
}

/// A figure that the file does not say, and where it is from.
#[derive(Clone, Debug, PartialEq)]
pub struct Derived {
    /// What, with its unit.
    pub what: &'static str,
    /// Its value, for people.
    pub value: String,
    /// How it follows from the file.
    pub how: String,
    /// Whether it is an estimate, to be replaced by a measurement.
    pub estimate: bool,
}

/// The protocol to the ESCs, by the name that the firmware's build takes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum EscProtocol {
    /// Pulses at 400 Hz.
    Pwm,
    /// Pulses of an eighth.
    OneShot125,
    /// Bits of 3⅓ µs.
    #[default]
    DShot300,
    /// Bits of 1⅔ µs.
    DShot600,
}

impl EscProtocol {
    /// As in the file.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Pwm => "pwm",
            Self::OneShot125 => "oneshot125",
            Self::DShot300 => "dshot300",
            Self::DShot600 => "dshot600",
        }
    }
}

/// A vehicle.
#[derive(Clone, Debug, PartialEq)]
pub struct Vehicle {
    /// Name of a built-in vehicle, or the file's.
    pub name: String,
    /// What it is, in a line.
    pub description: String,
    /// The simulator's vehicle.
    pub params: VehicleParams,
    /// Cells of the battery in series.
    pub cells: u8,
    /// Protocol to the ESCs.
    pub esc: EscProtocol,
    /// Gains and limits.
    pub control: ControlParams,
    /// Estimator of the attitude.
    pub estimator: EstimatorParams,
    /// Cutoff of the prefilter, Hz; `None` for none.
    pub prefilter_hz: Option<f64>,
    /// Below this voltage a flight may not start, V.
    pub min_arm_voltage_v: f64,
    /// Below this voltage a flight must end, V.
    pub critical_voltage_v: f64,
    /// Throttle of the descent without a pilot, 0 to 1.
    pub descent_throttle: f64,
    /// The receiver's channels.
    pub channels: ChannelMap,
    /// How the pilot arms.
    pub arm_by: ArmBy,
    /// Where the board's forward, right and down point in the vehicle.
    pub board_axes: Axes,
    /// Where the magnetometer's x, y and z point in the vehicle.
    pub magnetometer_axes: Axes,
    /// What the file does not say, and how it was found.
    pub derived: Vec<Derived>,
}

impl Vehicle {
    /// A built-in vehicle by name, or a vehicle file by path.
    ///
    /// # Errors
    /// A name that is neither, with the nearest built-in one; anything wrong in the file.
    pub fn load(name_or_path: &str) -> Result<Self, InputError> {
        let (name, text) = find(name_or_path, Path::new(""), &text_of)
            .map_err(|error| error.field("VEHICLE").value(name_or_path))?;
        Self::parse(&name, &text)
    }

    /// Reads a vehicle from TOML; `name` is what errors and results call it.
    ///
    /// # Errors
    /// Anything wrong in the text.
    pub fn parse(name: &str, text: &str) -> Result<Self, InputError> {
        if text.trim().is_empty() {
            return Err(
                InputError::new("is empty; a vehicle needs mass_g, cells and [rotors] at least").file(name)
            );
        }
        let mut layers = Layers::default();
        let table = layers.add(name, text)?;
        Self::of_table(name, &layers, table).map_err(|error| error.file(name))
    }

    /// Reads a vehicle from a table of `layers`: what a scene makes of a vehicle's file and its own changes.
    ///
    /// # Errors
    /// Anything wrong in the table. Errors of a value have no file yet: it may be of any of the layers.
    pub fn of_table<'a>(name: &str, layers: &Layers<'a>, table: DeTable<'a>) -> Result<Self, InputError> {
        let vehicle = layers.read::<file::File>(table)?.build(name)?;
        // What is computed from the file's figures must do for the flight controller, too.
        let config = Config { params: vehicle.flight_params(&Params::default()), calibration: None };
        FlightController::new(&config)
            .map_err(|error| InputError::new(format!("makes no flight controller: {error}")))?;
        Ok(vehicle)
    }

    /// The flight controller's configuration of this vehicle, with the sensors of `board`.
    pub fn flight_params(&self, board: &Params) -> Params {
        let v = &self.params;
        let Vec3 { x, y, z } = v.inertia_kg_m2;
        Params {
            prefilter_cutoff_hz: self.prefilter_hz.map(|hz| hz as f32),
            estimator: self.estimator,
            airframe: Airframe {
                thrust_coefficient: v.thrust_coefficient as f32,
                torque_coefficient: v.torque_coefficient as f32,
                forward_m: v.forward_m as f32,
                right_m: v.right_m as f32,
                spin: v.spin,
                inertia_kg_m2: vec3(x as f32, y as f32, z as f32),
                idle_rad_s: v.idle_rad_s as f32,
                max_rad_s: v.max_rad_s as f32,
            },
            control: self.control,
            channels: self.channels,
            arm_by: self.arm_by,
            min_arm_voltage_v: self.min_arm_voltage_v as f32,
            critical_voltage_v: self.critical_voltage_v as f32,
            descent: DescentParams { throttle: self.descent_throttle as f32, ..board.descent },
            ..*board
        }
    }

    /// `params` for a board that is built into this vehicle: with how it lies there, and how the magnetometer does.
    pub fn mounted(&self, mut params: Params) -> Params {
        params.gyro.mounting = matrix(&self.board_axes);
        params.accel.mounting = matrix(&self.board_axes);
        params.mag.mounting = matrix(&self.magnetometer_axes);
        params
    }
}

/// A mounting as the rotation from a chip's axes to the body's.
pub fn matrix(axes: &Axes) -> Mat3<f32> {
    Mat3 { rows: axes.rows().map(|row| Vec3::from(row.map(f32::from))) }
}

/// Whether a built-in vehicle has this name.
pub fn is_built_in(name: &str) -> bool {
    BUILT_IN.iter().any(|(built_in, _)| *built_in == name)
}

/// Name and text of a built-in vehicle, or of a file beside `from`.
///
/// # Errors
/// Neither, with the nearest built-in one.
pub fn find(name: &str, from: &Path, read: ReadText) -> Result<(String, String), InputError> {
    built_in_or_file("vehicle", BUILT_IN, name, from, read)
        .map_err(|(path, error)| InputError::new(format!("{} cannot be read: {error}", path.display())))?
        .ok_or_else(|| input::check::unknown("vehicle", name, BUILT_IN.iter().map(|vehicle| vehicle.0)))
}

#[cfg(test)]
mod tests;
