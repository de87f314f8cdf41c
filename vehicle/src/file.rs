//! The tables and keys of a vehicle file. Each key names its unit.

mod rotors;

use flight_core::Params;
use flight_core::control::ControlParams;
use flight_core::estimator::EstimatorParams;
use flight_core::geometry::{Vec3, vec3};
use flight_core::mixer::Spin;
use flight_core::prefilter::MAX_RATE_PER_CUTOFF;
use flight_core::rc::{ArmBy, ChannelMap};
use input::InputError;
use input::axes::Axes;
use input::check::{in_open_range, in_range, one_line, unknown, whole_number};
use serde::Deserialize;

use crate::tune::{self, MARGIN_DEG};
use crate::{Derived, EscProtocol, Plant, Vehicle, VehicleParams};

/// Default voltage of a cell below which the vehicle does not arm, V.
const ARM_V: f64 = 3.5;
/// Default voltage of a cell below which a flight must end, V.
const CRITICAL_V: f64 = 3.0;
/// Default drag over mass, 1/s: rotor drag of multirotors is 0.2 to 0.5 (OS4's figure: 0.38).
const DRAG_PER_MASS: f64 = 0.35;
/// Throttle of the descent without a pilot, as a share of hover throttle: a net force of a twentieth of the weight pulls
/// the vehicle down.
const DESCENT_SHARE: f64 = 0.95;
/// Throttle at which control begins, as a share of hover throttle.
const BEGIN_SHARE: f64 = 0.2;
/// Default idle speed of armed rotors, as a share of their speed in hover: 2 % of the thrust (0.142² = 0.020).
const IDLE_SHARE: f64 = 0.142;
/// Maximum idle speed of armed rotors, as a share of their speed in hover: half of the thrust of hover, so that the vehicle
/// descends at idle.
const MAX_IDLE_SHARE: f64 = std::f64::consts::FRAC_1_SQRT_2;
/// Unit of the idle speed in errors.
const IDLE_UNIT: &str = "rad/s, 0.7 of hover";

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct File {
    #[serde(default)]
    description: String,
    mass_g: f64,
    #[serde(deserialize_with = "whole_number::<_, _, 1, 24>")]
    cells: u8,
    #[serde(default)]
    feet_mm: Option<f64>,
    inertia: Inertia,
    rotors: Rotors,
    drag: Option<Drag>,
    #[serde(default)]
    esc: Esc,
    gains: Option<Gains>,
    #[serde(default)]
    rates: Rates,
    #[serde(default)]
    filters: Filters,
    #[serde(default)]
    battery: Battery,
    #[serde(default)]
    rc: RcChannels,
    #[serde(default)]
    mounting: Mounting,
}

/// `[inertia]`: measured, or estimated from the masses of the hub and of the rest.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Inertia {
    kg_m2: Option<[f64; 3]>,
    hub_g: Option<f64>,
    hub_mm: Option<[f64; 3]>,
}

/// `[rotors]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Rotors {
    arm_mm: Option<f64>,
    forward_mm: Option<f64>,
    right_mm: Option<f64>,
    #[serde(default)]
    spin: SpinName,
    thrust_n_s2: Option<f64>,
    full_thrust_g: Option<f64>,
    torque_n_m_s2: Option<f64>,
    propeller_mm: Option<f64>,
    max_rad_s: Option<f64>,
    max_rpm: Option<f64>,
    kv_rpm_per_v: Option<f64>,
    idle_rad_s: Option<f64>,
    inertia_kg_m2: Option<f64>,
    propeller_g: Option<f64>,
    lag_ms: f64,
}

#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum SpinName {
    #[default]
    PropsIn,
    PropsOut,
}

/// `[drag]`
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Drag {
    kg_per_s: [f64; 3],
}

/// `[esc]`
#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct Esc {
    #[serde(default)]
    protocol: EscProtocol,
}

/// `[gains]`: if the table is present, it must have all keys.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Gains {
    tilt_p: f64,
    heading_p: f64,
    rate_p: [f64; 3],
    rate_i: [f64; 3],
    rate_d: [f64; 3],
    max_integral_rad_s2: [f64; 3],
}

/// `[rates]`: tilt and rates at full stick.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Rates {
    max_tilt_deg: f64,
    max_deg_s: f64,
    max_yaw_deg_s: f64,
    max_tilt_deg_s: f64,
}

impl Default for Rates {
    fn default() -> Self {
        Self {
            max_tilt_deg: 45.0,
            max_deg_s: 180.0,
            max_yaw_deg_s: 90.0,
            max_tilt_deg_s: 4.5_f64.to_degrees(),
        }
    }
}

/// A prefilter's cutoff: `prefilter_hz = 30.0`, or `"none"`.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(try_from = "toml::Value")]
pub enum Cutoff {
    /// Hz.
    Hz(f64),
    /// No prefilter.
    None,
}

impl Cutoff {
    /// Hz; `None` for no prefilter.
    pub fn hz(self) -> Option<f64> {
        match self {
            // The flight controller uses single precision: the check is of that value.
            Self::Hz(hz) => Some(f64::from(hz as f32)),
            Self::None => None,
        }
    }
}

impl TryFrom<toml::Value> for Cutoff {
    type Error = &'static str;
    fn try_from(value: toml::Value) -> Result<Self, Self::Error> {
        match value {
            toml::Value::Float(hz) => Ok(Self::Hz(hz)),
            toml::Value::Integer(hz) => Ok(Self::Hz(hz as f64)),
            toml::Value::String(name) if name == "none" => Ok(Self::None),
            _ => Err("must be a number of Hz or \"none\""),
        }
    }
}

/// `[filters]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Filters {
    prefilter_hz: Cutoff,
    estimator: String,
}

impl Default for Filters {
    fn default() -> Self {
        Self { prefilter_hz: Cutoff::Hz(30.0), estimator: "flight".into() }
    }
}

/// `[battery]`
#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Battery {
    arm_v_per_cell: Option<f64>,
    critical_v_per_cell: Option<f64>,
}

/// `[rc]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct RcChannels {
    /// Order of aileron (roll), elevator (pitch), throttle and rudder (yaw) on the first four channels.
    order: String,
    /// Counted from 1; 1 to 4 are the sticks.
    #[serde(deserialize_with = "whole_number::<_, _, 5, 16>")]
    arm_channel: u8,
    #[serde(deserialize_with = "whole_number::<_, _, 5, 16>")]
    mode_channel: u8,
    arm_by: ArmByName,
}

impl Default for RcChannels {
    fn default() -> Self {
        Self { order: "AETR".into(), arm_channel: 5, mode_channel: 6, arm_by: ArmByName::Sticks }
    }
}

/// `[mounting]`: directions in the vehicle of the board's forward, right and down, and of the magnetometer's x, y and z.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Mounting {
    board: [String; 3],
    magnetometer: [String; 3],
}

impl Default for Mounting {
    fn default() -> Self {
        let along = ["forward", "right", "down"].map(String::from);
        Self { board: along.clone(), magnetometer: along }
    }
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum ArmByName {
    Sticks,
    Switch,
}

/// Returns the number of cells with its noun.
fn in_words(cells: u8) -> String {
    format!("{cells} cell{}", if cells == 1 { "" } else { "s" })
}

/// Checks that exactly one of several alternative keys is given.
fn exactly_one(table: &str, keys: &[(&str, bool)]) -> Result<(), InputError> {
    let given: Vec<&str> = keys.iter().filter(|(_, given)| *given).map(|(key, _)| *key).collect();
    let all: Vec<&str> = keys.iter().map(|(key, _)| *key).collect();
    match given.len() {
        1 => Ok(()),
        0 => Err(InputError::new(format!("needs one of {}", all.join(", "))).field(table)),
        _ => Err(InputError::new(format!("has {}: give only one of them", given.join(" and "))).field(table)),
    }
}

/// Checks each of three values with [`in_range`].
fn all_in_range(
    field: &str,
    values: [f64; 3],
    minimum: f64,
    maximum: f64,
    unit: &str,
) -> Result<(), InputError> {
    values.into_iter().try_for_each(|value| in_range(field, value, minimum, maximum, unit))
}

/// Checks an optional value with [`in_range`], and returns it.
fn optional_in_range(
    field: &str,
    value: Option<f64>,
    minimum: f64,
    maximum: f64,
    unit: &str,
) -> Result<Option<f64>, InputError> {
    value.map(|value| in_range(field, value, minimum, maximum, unit).map(|()| value)).transpose()
}

/// The figures that are derived while a vehicle is built.
#[derive(Default)]
struct Notes(Vec<Derived>);

impl Notes {
    fn add(&mut self, what: &'static str, value: impl ToString, how: impl Into<String>, estimate: bool) {
        self.0.push(Derived { what, value: value.to_string(), how: how.into(), estimate });
    }
}

impl File {
    pub fn build(self, name: &str) -> Result<Vehicle, InputError> {
        let mut notes = Notes::default();
        in_range("mass_g", self.mass_g, 10.0, 1.0e5, "g")?;
        one_line("description", &self.description)?;
        let mass_kg = self.mass_g / 1e3;
        let params = self.params(mass_kg, &mut notes)?;

        let hover = params.hover_throttle();
        if hover > 0.85 {
            return Err(InputError::new(format!(
                "is too heavy for rotors that lift {:.0} g at full speed: hover takes {:.0} % of their thrust, and must \
                 take at most 85 % so that thrust is left for control",
                params.max_thrust_n() / crate::GRAVITY * 1e3,
                hover * 100.0
            ))
            .field("mass_g")
            .value(self.mass_g));
        }
        notes.add(
            "hover throttle",
            format!("{:.1} %", hover * 100.0),
            "weight over thrust at full speed",
            false,
        );
        notes.add(
            "thrust to weight",
            format!("{:.2}", 1.0 / hover),
            "thrust at full speed over weight",
            false,
        );
        notes.add(
            "descent throttle",
            format!("{:.1} %", DESCENT_SHARE * hover * 100.0),
            "95 % of hover",
            false,
        );
        notes.add(
            "throttle at which control begins",
            format!("{:.1} %", BEGIN_SHARE * hover * 100.0),
            "a fifth of hover",
            false,
        );

        let prefilter_hz = self.filters.prefilter_hz.hz();
        if let Some(cutoff_hz) = prefilter_hz {
            let (min_hz, max_hz) = prefilter_range_hz();
            in_open_range("filters.prefilter_hz", cutoff_hz, min_hz, max_hz, PREFILTER_UNIT)?;
        }
        let estimator = estimator("filters.estimator", &self.filters.estimator)?;
        let control = self.control(&params, hover, prefilter_hz, &mut notes)?;
        let volts = |key: &str, value: Option<f64>, default: f64| {
            let cell_v = optional_in_range(key, value, 2.0, 4.35, "V a cell")?.unwrap_or(default);
            Ok::<_, InputError>(f64::from(self.cells) * cell_v)
        };
        let min_arm_voltage_v = volts("battery.arm_v_per_cell", self.battery.arm_v_per_cell, ARM_V)?;
        let critical_voltage_v =
            volts("battery.critical_v_per_cell", self.battery.critical_v_per_cell, CRITICAL_V)?;
        for (what, voltage) in
            [("minimum voltage to arm", min_arm_voltage_v), ("critical voltage", critical_voltage_v)]
        {
            let how = format!("{:.2} V a cell, {}", voltage / f64::from(self.cells), in_words(self.cells));
            notes.add(what, format!("{voltage:.1} V"), how, false);
        }
        if critical_voltage_v >= min_arm_voltage_v {
            let a_cell = |voltage: f64| voltage / f64::from(self.cells);
            return Err(InputError::new(format!(
                "critical_v_per_cell ({:.2} V) must be below arm_v_per_cell ({:.2} V); the defaults are \
                 {CRITICAL_V:.1} V and {ARM_V:.1} V",
                a_cell(critical_voltage_v),
                a_cell(min_arm_voltage_v)
            ))
            .field("battery"));
        }
        let channels = self.rc.channels()?;
        Ok(Vehicle {
            name: name.into(),
            description: self.description,
            params,
            cells: self.cells,
            esc: self.esc.protocol,
            control,
            estimator,
            prefilter_hz,
            min_arm_voltage_v,
            critical_voltage_v,
            descent_throttle: DESCENT_SHARE * hover,
            channels,
            arm_by: match self.rc.arm_by {
                ArmByName::Sticks => ArmBy::Sticks,
                ArmByName::Switch => ArmBy::Switch,
            },
            board_axes: Axes::parse("mounting.board", &self.mounting.board)?,
            magnetometer_axes: Axes::parse("mounting.magnetometer", &self.mounting.magnetometer)?,
            derived: notes.0,
        })
    }

    fn params(&self, mass_kg: f64, notes: &mut Notes) -> Result<VehicleParams, InputError> {
        let rotors = &self.rotors;
        let (forward_m, right_m) = rotors.positions()?;
        let arm_m = libm::hypot(forward_m, right_m);
        let max_rad_s = rotors.max_rad_s(self.cells, notes)?;
        let thrust_coefficient = rotors.thrust_coefficient(max_rad_s, notes)?;
        let torque_coefficient = rotors.torque_coefficient(thrust_coefficient, notes)?;
        let rotor_inertia_kg_m2 = rotors.rotor_inertia(notes)?;
        in_range("rotors.lag_ms", rotors.lag_ms, 1.0, 500.0, "ms")?;
        let inertia_kg_m2 = self.inertia.build(mass_kg, forward_m, right_m, notes)?;
        let feet_m = match optional_in_range("feet_mm", self.feet_mm, 5.0, 1e3, "mm")? {
            Some(feet_mm) => feet_mm / 1e3,
            None => {
                // The bottom of the body is assumed a fifth of the arm below the centre of gravity, at least 10 mm.
                let feet_m = (0.2 * arm_m).max(0.01);
                notes.add("feet", format!("{:.0} mm", feet_m * 1e3), "a fifth of the arm", true);
                feet_m
            }
        };
        let drag_kg_per_s = match self.drag {
            Some(Drag { kg_per_s }) => {
                all_in_range("drag.kg_per_s", kg_per_s, 0.0, 100.0, "kg/s")?;
                Vec3::from(kg_per_s)
            }
            None => {
                let drag = DRAG_PER_MASS * mass_kg;
                let how = "0.35 /s of the mass, a third of g at 9 m/s";
                notes.add("drag", format!("{drag:.3} kg/s"), how, true);
                vec3(drag, drag, drag)
            }
        };
        let mut params = VehicleParams {
            mass_kg,
            inertia_kg_m2,
            rotor_inertia_kg_m2,
            forward_m,
            right_m,
            spin: match rotors.spin {
                SpinName::PropsIn => Spin::PropsIn,
                SpinName::PropsOut => Spin::PropsOut,
            },
            thrust_coefficient,
            torque_coefficient,
            idle_rad_s: 0.0,
            max_rad_s,
            lag_s: rotors.lag_ms / 1e3,
            feet_m,
            drag_kg_per_s,
        };
        params.idle_rad_s = match optional_in_range(
            "rotors.idle_rad_s",
            rotors.idle_rad_s,
            0.0,
            MAX_IDLE_SHARE * params.hover_rad_s(),
            IDLE_UNIT,
        )? {
            Some(idle) => idle,
            None => {
                let idle = IDLE_SHARE * params.hover_rad_s();
                notes.add("idle speed", format!("{idle:.0} rad/s"), "2 % of the thrust of hover", false);
                idle
            }
        };
        Ok(params)
    }

    fn control(
        &self,
        params: &VehicleParams,
        hover: f64,
        prefilter_hz: Option<f64>,
        notes: &mut Notes,
    ) -> Result<ControlParams, InputError> {
        let Rates { max_tilt_deg, max_deg_s, max_yaw_deg_s, max_tilt_deg_s } = self.rates;
        in_range("rates.max_tilt_deg", max_tilt_deg, 1.0, 80.0, "deg")?;
        in_range("rates.max_deg_s", max_deg_s, 1.0, 2_000.0, "deg/s")?;
        in_range("rates.max_yaw_deg_s", max_yaw_deg_s, 1.0, 2_000.0, "deg/s")?;
        in_range("rates.max_tilt_deg_s", max_tilt_deg_s, 1.0, 2_000.0, "deg/s")?;
        let mut control = ControlParams {
            max_tilt_rad: max_tilt_deg.to_radians() as f32,
            max_stick_rate_rad_s: max_deg_s.to_radians() as f32,
            max_yaw_rate_rad_s: max_yaw_deg_s.to_radians() as f32,
            max_tilt_rate_rad_s: max_tilt_deg_s.to_radians() as f32,
            begin_throttle: (BEGIN_SHARE * hover) as f32,
            ..ControlParams::OS4
        };
        let Some(gains) = self.gains else {
            let plant = Plant::new(params, prefilter_hz, self.esc.protocol);
            let tuned = tune::tune(params, &plant, MARGIN_DEG);
            tuned.apply_to(&mut control);
            let how = format!("a phase margin of {MARGIN_DEG:.0}° (docs/tuning.md)");
            let value = format!("P {:.1} and {:.1} /s", tuned.tilt.p, tuned.yaw.p);
            notes.add("gains of the rate loops, tilt and yaw", value, how, false);
            return Ok(control);
        };
        in_range("gains.tilt_p", gains.tilt_p, 0.0, 100.0, "1/s")?;
        in_range("gains.heading_p", gains.heading_p, 0.0, 100.0, "1/s")?;
        all_in_range("gains.rate_p", gains.rate_p, 0.0, 1e3, "1/s")?;
        all_in_range("gains.rate_i", gains.rate_i, 0.0, 1e4, "1/s²")?;
        all_in_range("gains.rate_d", gains.rate_d, 0.0, 10.0, "")?;
        all_in_range("gains.max_integral_rad_s2", gains.max_integral_rad_s2, 0.0, 1e3, "rad/s²")?;
        let single = |[x, y, z]: [f64; 3]| vec3(x as f32, y as f32, z as f32);
        control.tilt_p = gains.tilt_p as f32;
        control.heading_p = gains.heading_p as f32;
        control.rate_p = single(gains.rate_p);
        control.rate_i = single(gains.rate_i);
        control.rate_d = single(gains.rate_d);
        control.max_integral_rad_s2 = single(gains.max_integral_rad_s2);
        Ok(control)
    }
}

/// Unit of the prefilter's cutoff in errors, with the reason for its maximum: the magnetometer is the slowest of the
/// filtered sensors.
pub const PREFILTER_UNIT: &str = "Hz, just below half the magnetometer's rate";

/// Returns the limits of a prefilter's cutoff, Hz: the minimum for the fastest sensor, the maximum for the slowest sensor.
pub fn prefilter_range_hz() -> (f64, f64) {
    let Params { imu_rate_hz, mag_rate_hz, .. } = Params::default();
    let min_hz = |rate_hz: f32| f64::from(rate_hz) / f64::from(MAX_RATE_PER_CUTOFF);
    (min_hz(imu_rate_hz), f64::from(mag_rate_hz) / 2.0 - min_hz(mag_rate_hz))
}

/// Returns the parameters of the estimator called `name`. Errors name `field`.
///
/// # Errors
/// The name is unknown: the error suggests the nearest one.
pub fn estimator(field: &str, name: &str) -> Result<EstimatorParams, InputError> {
    let found = EstimatorParams::PRESETS.into_iter().find(|(preset, _)| *preset == name);
    found
        .map(|(_, estimator)| estimator)
        .ok_or_else(|| unknown(field, name, EstimatorParams::PRESETS.map(|preset| preset.0)))
}

impl RcChannels {
    fn channels(&self) -> Result<ChannelMap, InputError> {
        let place = |letter: char| self.order.chars().position(|c| c == letter).map(|n| n as u8);
        let sticks = ['T', 'A', 'E', 'R'].map(place);
        let (4, [Some(t), Some(a), Some(e), Some(r)]) = (self.order.chars().count(), sticks) else {
            return Err(InputError::new(
                "must be the capital letters A, E, T and R in channel order, such as AETR or TAER",
            )
            .field("rc.order")
            .value(&self.order));
        };
        if self.arm_channel == self.mode_channel {
            return Err(InputError::new("arm_channel and mode_channel must differ (defaults: 5 and 6)")
                .field("rc")
                .value(self.mode_channel));
        }
        Ok(ChannelMap { sticks: [t, a, e, r], arm: self.arm_channel - 1, mode: self.mode_channel - 1 })
    }
}
