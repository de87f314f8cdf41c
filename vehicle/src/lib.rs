//! Vehicle files (`vehicles/NAME.toml`): parsed, checked, and converted to the parameters of the simulator and of the
//! flight controller.
//!
//! ```text
//!  vehicles/five-inch.toml ─► Vehicle ─┬─► VehicleParams: the simulator's vehicle, f64
//!  a scene's [vehicle] on top          └─► Params: the flight controller's configuration, f32
//! ```
//! The file holds only figures that can't be derived, in the units of datasheets (g, mm, rpm). All others are derived here
//! for this vehicle, and each says how ([`Vehicle::derived`]). No figure is taken from another vehicle.
#![forbid(unsafe_code)]
// Tests may use the host's maths library, whose rounding differs between machines.
#![cfg_attr(test, allow(clippy::disallowed_methods))]
#![warn(missing_docs)]

mod file;
mod plant;
mod tune;

use std::path::Path;

use flight_core::config::{ConfigError, DescentParams, Params};
use flight_core::control::ControlParams;
use flight_core::estimator::EstimatorParams;
use flight_core::geometry::{Mat3, Vec3, vec3};
use flight_core::mixer::{Airframe, Spin};
use flight_core::rc::{ArmBy, ChannelMap};
use flight_core::{Config, FlightController};
use input::InputError;
use input::axes::Axes;
use input::layers::{Layers, ReadText, built_in_or_file, read_text};
use toml::de::DeTable;

pub use file::{Cutoff, PREFILTER_UNIT, estimator, prefilter_range_hz};
pub use plant::{Axis, Loop, Margin, Plant};
pub use tune::{MARGIN_DEG, Tuned, authority_rad_s2, tune};

/// Standard gravity, m/s².
pub const GRAVITY: f64 = 9.80665;

macro_rules! vehicles {
    ($($name:literal),+ $(,)?) => {
        &[$(($name, include_str!(concat!("../../vehicles/", $name, ".toml")))),+]
    };
}

/// Names and texts of the built-in vehicles.
pub const BUILT_IN: &[(&str, &str)] = vehicles!["os4", "five-inch", "ten-inch", "hummingbird", "crazyflie"];

/// Name of the vehicle that is used if none is given.
pub const DEFAULT: &str = "os4";

/// Physical parameters of a vehicle (with the symbols of the paper's table 1).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VehicleParams {
    /// Mass m, kg.
    pub mass_kg: f64,
    /// Moments of inertia I_xx, I_yy, I_zz, kg·m².
    pub inertia_kg_m2: Vec3<f64>,
    /// Moment of inertia of a rotor J_r, kg·m².
    pub rotor_inertia_kg_m2: f64,
    /// Distance of the front rotors forward of the centre of gravity, and of the rear rotors behind it, m.
    pub forward_m: f64,
    /// Distance of the right rotors to the right of the centre of gravity, and of the left rotors to its left, m.
    pub right_m: f64,
    /// Directions in which the rotors turn.
    pub spin: Spin,
    /// Thrust coefficient b, N·s².
    pub thrust_coefficient: f64,
    /// Torque coefficient d, N·m·s².
    pub torque_coefficient: f64,
    /// Minimum speed of an armed rotor, rad/s.
    pub idle_rad_s: f64,
    /// Speed of a rotor at full pulse, rad/s.
    pub max_rad_s: f64,
    /// Time constant of the first-order lag from a rotor's command to its speed, s.
    pub lag_s: f64,
    /// Distance of the feet below the centre of gravity, m.
    pub feet_m: f64,
    /// Linear drag, force over airspeed: north, east, down, kg/s.
    pub drag_kg_per_s: Vec3<f64>,
}

impl VehicleParams {
    /// OS4 (Bouabdallah, EPFL thesis 3727, 2007), with the figures of `vehicles/os4.toml`.
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

    /// Returns the arm l, m: the distance from the centre of gravity to a rotor's axis.
    pub fn arm_m(&self) -> f64 {
        libm::hypot(self.forward_m, self.right_m)
    }

    /// Moves the rotors outwards or inwards, so that their distance from the centre of gravity is `arm_m`.
    pub fn set_arm_m(&mut self, arm_m: f64) {
        let scale = arm_m / self.arm_m();
        self.forward_m *= scale;
        self.right_m *= scale;
    }

    /// Returns the thrust of all rotors at full speed, N.
    pub fn max_thrust_n(&self) -> f64 {
        4.0 * self.thrust_coefficient * self.max_rad_s * self.max_rad_s
    }

    /// Returns the throttle at which the thrust equals the weight, 0 to 1. Throttle is a share of the maximum thrust.
    pub fn hover_throttle(&self) -> f64 {
        self.mass_kg * GRAVITY / self.max_thrust_n()
    }

    /// Returns the rotor speed at which the thrust equals the weight, rad/s.
    pub fn hover_rad_s(&self) -> f64 {
        (self.mass_kg * GRAVITY / (4.0 * self.thrust_coefficient)).sqrt()
    }
}

/// A figure that is not in the file, and how it was derived.
#[derive(Clone, Debug, PartialEq)]
pub struct Derived {
    /// Name of the figure.
    pub what: &'static str,
    /// Value with its unit, as text.
    pub value: String,
    /// How the value follows from the file.
    pub how: String,
    /// Whether the value is an estimate, to be replaced by a measurement.
    pub estimate: bool,
}

/// The protocol to the ESCs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum EscProtocol {
    /// PWM: pulses of 1 to 2 ms at 400 Hz.
    Pwm,
    /// OneShot125: pulses of an eighth of that length.
    OneShot125,
    /// DShot300: bits of 3⅓ µs.
    #[default]
    DShot300,
    /// DShot600: bits of 1⅔ µs.
    DShot600,
}

impl EscProtocol {
    /// Returns the name that vehicle files use.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Pwm => "pwm",
            Self::OneShot125 => "oneshot125",
            Self::DShot300 => "dshot300",
            Self::DShot600 => "dshot600",
        }
    }
}

/// A vehicle: the checked content of a vehicle file, and the figures that are derived from it.
#[derive(Clone, Debug, PartialEq)]
pub struct Vehicle {
    /// Name of a built-in vehicle, or path of the file.
    pub name: String,
    /// Description in one line.
    pub description: String,
    /// Physical parameters, as the simulator uses them.
    pub params: VehicleParams,
    /// Number of battery cells in series.
    pub cells: u8,
    /// Protocol to the ESCs.
    pub esc: EscProtocol,
    /// Gains and limits of the control loops.
    pub control: ControlParams,
    /// Estimator of the attitude.
    pub estimator: EstimatorParams,
    /// Cutoff of the prefilter, Hz; `None` for no prefilter.
    pub prefilter_hz: Option<f64>,
    /// Battery voltage below which the vehicle does not arm, V.
    pub min_arm_voltage_v: f64,
    /// Battery voltage below which a flight must end, V.
    pub critical_voltage_v: f64,
    /// Throttle of the descent without a pilot, 0 to 1.
    pub descent_throttle: f64,
    /// Receiver channels of the sticks and switches.
    pub channels: ChannelMap,
    /// How the pilot arms: by the sticks or by a switch.
    pub arm_by: ArmBy,
    /// Directions of the board's forward, right and down in the vehicle.
    pub board_axes: Axes,
    /// Directions of the magnetometer's x, y and z in the vehicle.
    pub magnetometer_axes: Axes,
    /// Figures that are not in the file, and how they were derived.
    pub derived: Vec<Derived>,
}

impl Vehicle {
    /// Loads a built-in vehicle by name, or a vehicle file by path.
    ///
    /// # Errors
    /// The name is neither a built-in vehicle nor a file: the error suggests the nearest built-in name. The file is
    /// invalid.
    pub fn load(name_or_path: &str) -> Result<Self, InputError> {
        let (name, text) = find(name_or_path, Path::new(""), &read_text)
            .map_err(|error| error.field("VEHICLE").value(name_or_path))?;
        Self::parse(&name, &text)
    }

    /// Parses a vehicle from TOML. Errors and results show `name`.
    ///
    /// # Errors
    /// The text is invalid.
    pub fn parse(name: &str, text: &str) -> Result<Self, InputError> {
        if text.trim().is_empty() {
            return Err(InputError::new(
                "is empty: a vehicle needs at least mass_g, cells, [inertia] and [rotors]",
            )
            .file(name));
        }
        let mut layers = Layers::default();
        let table = layers.add(name, text)?;
        Self::from_table(name, &layers, &table)
    }

    /// Builds a vehicle from a table of `layers`: a vehicle file, with the changes that a scene makes to it.
    ///
    /// # Errors
    /// The table is invalid. The error has no file if it is about no key of the table.
    pub fn from_table<'a>(name: &str, layers: &Layers<'a>, table: &DeTable<'a>) -> Result<Self, InputError> {
        let file = layers.read::<file::File>(table)?;
        let vehicle = file.build(name).map_err(|error| layers.locate(error, table))?;
        // The flight controller checks the derived figures, too.
        let config = Config { params: vehicle.flight_params(&Params::default()), calibration: None };
        FlightController::new(&config).map_err(|error| layers.locate(rejected(&error), table))?;
        Ok(vehicle)
    }

    /// Returns the flight controller's parameters for this vehicle, with the sensors of `board`.
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

    /// Returns `params` with this vehicle's mountings of the board and of the magnetometer.
    pub fn with_mounting(&self, mut params: Params) -> Params {
        params.gyro.mounting = matrix(&self.board_axes);
        params.accel.mounting = matrix(&self.board_axes);
        params.mag.mounting = matrix(&self.magnetometer_axes);
        params
    }
}

/// Returns the error for a value that the flight controller rejects. Its field is the table from which the value follows.
fn rejected(error: &ConfigError) -> InputError {
    let (table, advice) = match error.field.split_once('.') {
        Some(("airframe", name)) if name.starts_with("inertia") => ("inertia", "check it"),
        Some(("airframe", "idle_rad_s")) => ("rotors.idle_rad_s", "check it"),
        Some(("airframe", _)) => ("rotors", "check them"),
        Some(("control", name)) if name.starts_with("max_") && !name.starts_with("max_integral") => {
            ("rates", "check them")
        }
        // A value of [gains] has been checked, so this one is derived.
        Some(("control", _)) => ("inertia", "check inertia, rotors and mass_g, or give [gains]"),
        Some(("estimator" | "prefilter", _)) => ("filters", "check them"),
        _ if error.field.contains("voltage") => ("battery", "check it"),
        _ => return InputError::new(format!("the flight controller rejects {error}")),
    };
    InputError::new(format!("gives {error} for the flight controller: {advice}")).field(table)
}

/// Converts a mounting to the rotation from the chip's axes to the body's.
pub fn matrix(axes: &Axes) -> Mat3<f32> {
    Mat3 { rows: axes.rows().map(|row| Vec3::from(row.map(f32::from))) }
}

/// Returns whether a built-in vehicle has this name.
pub fn is_built_in(name: &str) -> bool {
    BUILT_IN.iter().any(|(built_in, _)| *built_in == name)
}

/// Returns name and text of a built-in vehicle, or of a vehicle file in the directory of `from`.
///
/// # Errors
/// The file cannot be read. If `name` is neither a built-in name nor a file, the error suggests the nearest built-in
/// name.
pub fn find(name: &str, from: &Path, read: ReadText) -> Result<(String, String), InputError> {
    built_in_or_file("vehicle", BUILT_IN, name, from, read)
        .map_err(|(path, error)| InputError::new(format!("{} cannot be read: {error}", path.display())))?
        .ok_or_else(|| {
            input::check::unknown("vehicle", name, BUILT_IN.iter().map(|vehicle| vehicle.0))
                .also("; or the path of a vehicle file, which ends in .toml")
        })
}

#[cfg(test)]
mod tests;
