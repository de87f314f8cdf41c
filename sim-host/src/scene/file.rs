//! Tables and keys of a scene file. The names of the keys contain the units.

use flight_core::rc::FlightMode;
use serde::Deserialize;

use super::effects::Effects;
use super::faults::Fault;
use super::tolerances::Tolerances;
use crate::earth_field::Place;
use crate::pilot::{Base, Move, PilotScript, Plan};
use input::InputError;
use input::check::in_range;

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SceneFile {
    /// The scene that this one changes. The two are merged before this text is parsed.
    #[serde(default, rename = "include")]
    _include: Option<String>,
    pub scene: SceneTable,
    /// Changes to the vehicle file. They are removed before this is parsed.
    #[serde(default, rename = "vehicle")]
    _vehicle: Option<toml::Table>,
    #[serde(default)]
    pub flight: Flight,
    pub pilot: Option<Pilot>,
    #[serde(default)]
    pub effects: Effects,
    #[serde(default, rename = "fault")]
    pub faults: Vec<Fault>,
    #[serde(default)]
    pub tolerances: Tolerances,
}

/// `[scene]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SceneTable {
    #[serde(default)]
    pub description: String,
    pub duration_s: f64,
    pub seed: u64,
    /// The vehicle. It is loaded before this text is parsed.
    #[serde(rename = "vehicle")]
    _vehicle: String,
    /// The IMU preset. It is loaded before this text is parsed, and its values complete the effects.
    #[serde(rename = "imu")]
    _imu: String,
    #[serde(default)]
    pub mount: MountName,
    #[serde(default)]
    pub aerobatic: bool,
    /// Place and date of the Earth's magnetic field; `None` for Ankara.
    pub place: Option<PlaceTable>,
}

/// `[scene.place]`: place and date of the Earth's magnetic field.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct PlaceTable {
    latitude_deg: f64,
    longitude_deg: f64,
    #[serde(default)]
    altitude_m: f64,
    year: Option<f64>,
}

impl PlaceTable {
    pub fn build(self) -> Place {
        let Self { latitude_deg, longitude_deg, altitude_m, year } = self;
        Place { latitude_deg, longitude_deg, altitude_m, year: year.unwrap_or(Place::ANKARA.year) }
    }
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum MountName {
    #[default]
    Free,
    BallJoint,
}

/// `[flight]`: configuration of the flight controller.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Flight {
    /// Name of the estimator; `None` for the vehicle's.
    pub estimator: Option<String>,
    /// Cutoff of the prefilter; `None` for the vehicle's.
    pub prefilter_hz: Option<vehicle::Cutoff>,
    /// Declination, added to the magnetic heading, positive east.
    #[serde(default)]
    pub declination_deg: Declination,
    pub calibration: Option<CalibrationTable>,
}

/// Value of `declination_deg`: a number of degrees, or `"model"` for the declination at the scene's place.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(try_from = "toml::Value")]
pub(super) enum Declination {
    Given(f64),
    Model,
}

impl Default for Declination {
    fn default() -> Self {
        Self::Given(0.0)
    }
}

impl TryFrom<toml::Value> for Declination {
    type Error = &'static str;
    fn try_from(value: toml::Value) -> Result<Self, Self::Error> {
        match value {
            toml::Value::Float(degrees) => Ok(Self::Given(degrees)),
            toml::Value::Integer(degrees) => Ok(Self::Given(degrees as f64)),
            toml::Value::String(name) if name == "model" => Ok(Self::Model),
            _ => Err("must be a number of degrees or \"model\""),
        }
    }
}

/// `[flight.calibration]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CalibrationTable {
    pub gyro_rad_s: Option<SensorCalibrationTable>,
    pub accel_m_s2: Option<SensorCalibrationTable>,
    pub mag_ut: Option<SensorCalibrationTable>,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SensorCalibrationTable {
    pub bias: [f64; 3],
    pub matrix: Option<[[f64; 3]; 3]>,
}

/// `[pilot]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Pilot {
    kind: PilotKind,
    arm_at_s: f64,
    take_off_at_s: f64,
    height_m: Option<f64>,
    land_before_end_s: Option<f64>,
    /// Source of the stick positions that no `[[pilot.move]]` sets.
    base: Option<BaseName>,
    /// Position of the throttle stick with `base = "centred"`, 0 to 1.
    throttle: Option<f64>,
    #[serde(default, rename = "move")]
    moves: Vec<MoveTable>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
enum PilotKind {
    Hold,
    Script,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
enum BaseName {
    Hold,
    Centred,
}

/// `[[pilot.move]]`: stick positions over time.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct MoveTable {
    at_s: f64,
    for_s: f64,
    throttle: Option<f64>,
    roll: Option<f64>,
    pitch: Option<f64>,
    yaw: Option<f64>,
    #[serde(default)]
    mode: Mode,
}

/// Position of the mode switch.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Mode {
    #[default]
    Angle,
    Rate,
}

impl Pilot {
    pub fn build(&self, ball_joint: bool) -> Result<PilotScript, InputError> {
        in_range("pilot.arm_at_s", self.arm_at_s, 0.0, 1e6, "s")?;
        // The pilot holds the arming gesture for 1.2 s; the motors turn 1.5 s after its start.
        in_range("pilot.take_off_at_s", self.take_off_at_s, self.arm_at_s + 1.6, 1e6, "s")?;
        if let Some(before_end_s) = self.land_before_end_s {
            in_range("pilot.land_before_end_s", before_end_s, 0.0, 1e6, "s")?;
        }
        if self.kind == PilotKind::Hold && !self.moves.is_empty() {
            return Err(InputError::new("is only for a pilot of kind \"script\"").field("pilot.move"));
        }
        if self.throttle.is_some() && self.base != Some(BaseName::Centred) {
            return Err(
                InputError::new("is only for a pilot with base = \"centred\"").field("pilot.throttle")
            );
        }
        let base = match (self.kind, self.base) {
            (PilotKind::Hold, None) | (PilotKind::Script, Some(BaseName::Hold)) => Base::Hold,
            (PilotKind::Script, Some(BaseName::Centred)) => {
                let throttle =
                    self.throttle.ok_or_else(|| missing("pilot.throttle", "base = \"centred\""))?;
                in_range("pilot.throttle", throttle, 0.0, 1.0, "of full throttle")?;
                Base::Centred { throttle }
            }
            (PilotKind::Hold, Some(_)) => {
                return Err(InputError::new("is only for a pilot of kind \"script\"").field("pilot.base"));
            }
            (PilotKind::Script, None) => return Err(missing("pilot.base", "kind = \"script\"")),
        };
        if base == Base::Hold && ball_joint {
            return Err(InputError::new(
                "must have base = \"centred\" on a ball joint, because the vehicle has no position to hold",
            )
            .field("pilot"));
        }
        let height_m = match (base, self.height_m) {
            (Base::Hold, None) => return Err(missing("pilot.height_m", "a pilot that holds a position")),
            (_, height_m) => height_m.unwrap_or(0.0),
        };
        in_range("pilot.height_m", height_m, 0.0, 1000.0, "m")?;
        let mut script = Vec::new();
        for (n, m) in self.moves.iter().enumerate() {
            let key = |key: &str| format!("pilot.move[{n}].{key}");
            in_range(&key("at_s"), m.at_s, self.take_off_at_s, 1e6, "s")?;
            in_range(&key("for_s"), m.for_s, 0.02, 1e6, "s")?;
            for (name, stick, low) in [
                ("throttle", m.throttle, 0.0),
                ("roll", m.roll, -1.0),
                ("pitch", m.pitch, -1.0),
                ("yaw", m.yaw, -1.0),
            ] {
                if let Some(stick) = stick {
                    in_range(&key(name), stick, low, 1.0, "of full stick")?;
                }
            }
            let MoveTable { at_s, for_s, throttle, roll, pitch, yaw, mode } = *m;
            let mode = match mode {
                Mode::Angle => FlightMode::Angle,
                Mode::Rate => FlightMode::Rate,
            };
            script.push(Move { at_s, for_s, throttle, roll, pitch, yaw, mode });
        }
        let Self { arm_at_s, take_off_at_s, land_before_end_s, .. } = *self;
        Ok(PilotScript { plan: Plan { arm_at_s, take_off_at_s, height_m, land_before_end_s }, base, script })
    }
}

fn missing(field: &str, with: &str) -> InputError {
    InputError::missing().field(field).also(&format!(": {with} needs it"))
}
