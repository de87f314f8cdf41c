//! Reads a scene, which is a TOML file, checks it, and builds the parts of a flight from it.
//!
//! A scene names the vehicle, the sensors, the pilot and the effects. **An effect that the scene does not name is not
//! built.** `file.rs`, `effects.rs`, `faults.rs` and `tolerances.rs` define all keys; an unknown key is an error that
//! names the nearest known one.

mod built_in;
mod effects;
mod faults;
mod file;
mod imu;
mod stiffness;
mod tolerances;

use std::borrow::Cow;
use std::cell::RefCell;
use std::path::{Path, PathBuf};

use flight_core::FlightController;
use flight_core::calibration::{Calibration, Sensitivity, SensorCalibration};
use flight_core::config::{Config, ConfigError, Params};
use flight_core::control::ControlParams;
use flight_core::estimator::EstimatorParams;
use flight_core::geometry::{Mat3, Vec3, vec3};
use flight_core::sample::RcFrame;

use crate::dynamics::{Ground, Mount, VehicleParams};
use crate::earth_field::{Place, declination_rad};
use crate::effects::BuildContext;
use crate::effects::delivery::{BoxedDelivery, ImuEffect, MagEffect};
use crate::effects::vehicle::{ThrustShares, VehicleEffect};
use crate::pilot::{Knowledge, PilotScript};
use crate::sensors::{Converter, Sensor, Sensors};
use input::layers::{Layers, complete, merge};
use input::{InputError, check, layers};

use imu::ImuPreset;

use toml::Spanned;
use toml::de::{DeTable, DeValue};
use vehicle::Vehicle;

pub use built_in::{BUILT_IN, BuiltIn};
pub use input::layers::ReadText;
pub use tolerances::Drawn;

/// Rate of the simulation steps and of the IMU, Hz.
pub const DEFAULT_RATE_HZ: u32 = 1000;

/// Rate of the magnetometer, Hz.
pub const MAG_RATE_HZ: u32 = 100;

/// The Earth's field at Ankara, north, east, down, µT: WMM2025 at 39.93° N, 32.86° E, 0.9 km, in November
/// 2026 (declination 6.175° east, inclination 58.19°, 48.18 µT). The source is another implementation of the model than
/// the one that scenes use.
pub const FIELD_ANKARA_UT: Vec3<f64> = vec3(25.248, 2.732, 40.940);

/// A scene that a scene includes, directly or through another.
struct Included {
    name: String,
    text: String,
}

/// Longest chain of included scenes. A longer one is taken for a cycle whose path changes with each turn.
const MAX_INCLUDED: usize = 16;

impl Included {
    /// Returns all scenes that a scene includes, the nearest first.
    fn all(name: &str, text: &str, read: ReadText) -> Result<Vec<Self>, InputError> {
        let mut list: Vec<Self> = Vec::new();
        let (mut name, mut text) = (name.to_owned(), text.to_owned());
        while let Some(next) = layers::text_at(&name, &text, "include")? {
            let found = if let Some(scene) = BUILT_IN.iter().find(|scene| scene.name == next) {
                Self { name: next, text: scene.text.into() }
            } else if next.is_empty() {
                let allowed = "must be the name of a built-in scene, or the path of a scene file";
                let error = InputError::new(allowed).field("include").value("");
                return Err(layers::located(&name, &text, error));
            } else {
                // The path is relative to the file that includes it.
                let path = Path::new(&name).with_file_name(&next);
                let text = read(&path).map_err(|error| {
                    let allowed =
                        format!("is not a built-in scene, and {} cannot be read: {error}", path.display());
                    let error = InputError::new(allowed).field("include").value(&next);
                    layers::located(&name, &text, error)
                })?;
                Self { name: path.display().to_string(), text }
            };
            if list.len() == MAX_INCLUDED || list.iter().any(|included| included.name == found.name) {
                let allowed =
                    format!("must not be part of a cycle, or of a chain of more than {MAX_INCLUDED} scenes");
                let error = InputError::new(allowed).field("include").value(&found.name);
                return Err(layers::located(&name, &text, error));
            }
            (name, text) = (found.name.clone(), found.text.clone());
            list.push(found);
        }
        Ok(list)
    }
}

/// An effect with its name.
pub type Named<T> = (&'static str, T);

/// A checked scene.
#[derive(Clone, Debug)]
pub struct Scene {
    /// Name of the built-in scene, or path of the file.
    pub name: String,
    /// Description of the scene, one line.
    pub description: String,
    /// Length, s.
    pub duration_s: f64,
    /// Seed of every random stream.
    pub seed: u64,
    /// The vehicle that flies: `design` with the deviations that tolerances have drawn.
    pub vehicle: VehicleParams,
    /// The vehicle of the vehicle file, with the changes of the scene.
    pub design: Vehicle,
    /// Name of the built-in vehicle, or path of the vehicle file, of `design`.
    pub vehicle_place: String,
    /// All files that the scene was read from, and its own name.
    pub files: Vec<PathBuf>,
    /// Whether the vehicle stands on a ball joint.
    pub ball_joint: bool,
    /// Whether a tilt above 90° is intended and so is not a crash.
    pub aerobatic: bool,
    /// The pilot; `None` if the vehicle lies on the bench and does not fly.
    pub pilot: Option<PilotScript>,
    /// Configuration of the flight controller.
    pub config: Config,
    controller: FlightController,
    /// Converters of the sensors: gyro (rad/s), accel (m/s²), mag (µT).
    pub converters: [Converter; 3],
    /// The Earth's field at the scene's place and date, north, east, down, µT.
    pub field_ut: Vec3<f64>,
    /// Hash of the texts of all files that the scene was read from.
    pub text_hash: u64,
    effects: effects::Effects,
    faults: Vec<faults::Fault>,
    tolerances: tolerances::Tolerances,
    /// Thrust coefficient of each rotor divided by the vehicle's; only in the scene of a run.
    thrust_shares: Option<[f64; 4]>,
}

impl Scene {
    /// Loads a built-in scene by name, or a scene file by path.
    ///
    /// # Errors
    /// The name is neither, or the scene has an error. The error names the nearest built-in scene.
    pub fn load(name_or_path: &str) -> Result<Self, InputError> {
        if let Some(scene) = BUILT_IN.iter().find(|scene| scene.name == name_or_path) {
            return Self::parse(scene.name, scene.text);
        }
        let path = Path::new(name_or_path);
        if !path.exists() {
            if name_or_path.ends_with(".toml") || path.components().count() > 1 {
                return Err(InputError::new("this file does not exist").field("SCENE").value(name_or_path));
            }
            return Err(check::unknown("SCENE", name_or_path, BUILT_IN.iter().map(|scene| scene.name))
                .also("; or the path of a scene file"));
        }
        let text = layers::read_text(path)
            .map_err(|error| InputError::new(format!("cannot be read: {error}")).file(path))?;
        Self::parse(name_or_path, &text)
    }

    /// Loads a scene as [`Scene::load`], with another vehicle: a built-in one by name, or a vehicle file by path.
    ///
    /// # Errors
    /// As [`Scene::load`], or the vehicle has an error.
    pub fn load_with_vehicle(name_or_path: &str, vehicle: Option<&str>) -> Result<Self, InputError> {
        let scene = Self::load(name_or_path)?;
        let Some(vehicle) = vehicle else { return Ok(scene) };
        // Absolute, because paths in a scene are relative to the scene file.
        let absolute = |path: &str, built_in: bool| match std::path::absolute(path) {
            Ok(absolute) if !built_in => absolute.display().to_string(),
            _ => path.to_owned(),
        };
        let include = absolute(name_or_path, BUILT_IN.iter().any(|scene| scene.name == name_or_path));
        vehicle::find(vehicle, Path::new(""), &layers::read_text)
            .map_err(|error| error.field("--vehicle").value(vehicle))?;
        let mut altered = toml::Table::new();
        let vehicle_path = absolute(vehicle, vehicle::is_built_in(vehicle));
        let names = [(include.clone(), name_or_path), (vehicle_path.clone(), vehicle)];
        altered.insert("include".into(), include.into());
        altered
            .insert("scene".into(), toml::Table::from_iter([("vehicle".into(), vehicle_path.into())]).into());
        // An error shows the paths as they were given.
        Self::parse(&scene.name, &altered.to_string()).map_err(|error| {
            let given = names.iter().find(|(absolute, _)| error.file_name() == Some(absolute));
            given.map_or(error.clone(), |(_, given)| error.file(given))
        })
    }

    /// Returns the files that the scene was read from, which no output may overwrite.
    pub fn inputs(&self) -> Vec<&Path> {
        self.files.iter().map(PathBuf::as_path).collect()
    }

    /// Parses a scene from TOML; `name` names it in errors and results.
    ///
    /// # Errors
    /// The text, an included scene, the vehicle or the IMU preset has an error.
    pub fn parse(name: &str, text: &str) -> Result<Self, InputError> {
        Self::parse_with(name, text, &layers::read_text)
    }

    /// Parses a scene as [`Scene::parse`]; `read` reads the files that the scene names.
    ///
    /// # Errors
    /// As [`Scene::parse`].
    pub fn parse_with(name: &str, text: &str, read: ReadText) -> Result<Self, InputError> {
        let files = RefCell::new(vec![PathBuf::from(name)]);
        let read: ReadText = &|path| {
            files.borrow_mut().push(path.into());
            read(path)
        };
        let scene = Self::from_layers(name, text, read)?;
        Ok(Self { files: files.into_inner(), ..scene })
    }

    fn from_layers(name: &str, text: &str, read: ReadText) -> Result<Self, InputError> {
        if text.trim().is_empty() {
            return Err(InputError::new("is empty; a scene needs a [scene] table").file(name));
        }
        let below = Included::all(name, text, read)?;
        // Declared before `layers`, which borrows them.
        let (preset_name, preset_text);
        let mut layers = Layers::default();
        let mut table = layers.add(name, text)?;
        for included in &below {
            let under = layers.add(&included.name, &included.text)?;
            table = merge(table, under);
        }
        let vehicle_name = string_in(&layers, &table, "vehicle", "vehicle")
            .map_err(|error| located(&layers, error, &table, name))?;
        let (vehicle_layer, vehicle_text, values_text);
        (vehicle_layer, vehicle_text) =
            vehicle::find(&vehicle_name, Path::new(name), read).map_err(|error| {
                located(&layers, error.field("scene.vehicle").value(&vehicle_name), &table, name)
            })?;
        let mut vehicle_table = layers.add(&vehicle_layer, &vehicle_text)?;
        if table.get("vehicle").is_some_and(|altered| !altered.get_ref().is_table()) {
            let error = InputError::new("must be a table; the name of the vehicle is scene.vehicle");
            return Err(located(&layers, error.field("vehicle"), &table, name));
        }
        let altered = match table.remove("vehicle").map(Spanned::into_inner) {
            Some(DeValue::Table(altered)) => altered,
            _ => DeTable::new(),
        };
        vehicle_table = merge(altered, vehicle_table);
        let of_vehicle = |error: InputError| match (error.file_name(), error.field_name()) {
            (None, _) => error.file(&vehicle_layer),
            (Some(file), _) if file == vehicle_layer => error,
            // The key is in the table `[vehicle]` of a scene.
            (_, key) => {
                let key = format!("vehicle.{}", key.unwrap_or_default());
                error.field(key.trim_end_matches('.'))
            }
        };
        let locate = |error| of_vehicle(layers.locate(error, &vehicle_table));
        let design = Vehicle::from_table(&vehicle_name, &layers, &vehicle_table).map_err(of_vehicle)?;
        stiffness::check_legs(&design.params).map_err(locate)?;
        values_text = vehicle_values_toml(&design);
        let vehicle_values = layers.add(&format!("values of {vehicle_layer}"), &values_text)?;
        let imu = string_in(&layers, &table, "imu", "IMU preset")
            .map_err(|error| located(&layers, error, &table, name))?;
        (preset_name, preset_text) =
            imu::find(&imu, Path::new(name), read).map_err(|error| located(&layers, error, &table, name))?;
        let imu_at = match table.get("scene").map(Spanned::get_ref) {
            Some(DeValue::Table(scene)) => scene.get("imu").map_or(0, |imu| imu.span().start),
            _ => 0,
        };
        let (preset, preset_values) = ImuPreset::read(&mut layers, &preset_name, &preset_text)?;
        if let Some(DeValue::Table(effects)) = table.get_mut("effects").map(Spanned::get_mut) {
            // The preset that a scene names has priority over the values of the scenes that it includes.
            complete(effects, &preset_values, |at| layers.is_after(at, imu_at));
            complete(effects, &vehicle_values, |_| false);
        }
        let text_hash = layers.hash();
        let file: file::SceneFile =
            layers.read(&table).map_err(|error| located(&layers, with_hint(error), &table, name))?;
        let vehicle_place = if vehicle::is_built_in(&vehicle_name) { vehicle_name } else { vehicle_layer };
        let scene = Self::build(name, file, design, &preset, text_hash)
            .map_err(|error| located(&layers, error, &table, name))?;
        Ok(Self { vehicle_place, ..scene })
    }

    fn build(
        name: &str,
        file: file::SceneFile,
        design: Vehicle,
        preset: &ImuPreset,
        text_hash: u64,
    ) -> Result<Self, InputError> {
        let file::SceneFile { scene, flight, pilot, effects, faults, tolerances, .. } = file;
        let vehicle = design.params;
        check::one_line("scene.description", &scene.description)?;
        effects.validate()?;
        stiffness::check_drag(&effects.vehicle, &vehicle)?;
        for (n, fault) in faults.iter().enumerate() {
            fault.validate(&format!("fault[{n}]"))?;
        }
        let field_ut = scene.place.map_or(Place::ANKARA, file::PlaceTable::build).field_ut()?;
        let ball_joint = scene.mount == file::MountName::BallJoint;
        let pilot = pilot.map(|p| p.build(ball_joint)).transpose()?;
        let mut config = flight.build(&design, preset, field_ut)?;
        let converters = preset.converters();
        config.params.stuck_check = effects.stuck_check(&converters);
        let controller = FlightController::new(&config).map_err(|error| refused(&error))?;
        let built = Self {
            name: name.into(),
            description: scene.description,
            duration_s: scene.duration_s,
            seed: scene.seed,
            vehicle,
            design,
            vehicle_place: String::new(),
            files: Vec::new(),
            ball_joint,
            aerobatic: scene.aerobatic,
            pilot,
            config,
            controller,
            converters,
            field_ut,
            text_hash,
            effects,
            faults,
            tolerances,
            thrust_shares: None,
        };
        built.check_landing(scene.duration_s)?;
        // A scene that includes a longer one may cut off moves.
        if let Some((key, at_s)) = built.cut_off(false).into_iter().next() {
            let allowed = format!("must be below the length of the scene, {} s", scene.duration_s);
            return Err(InputError::new(allowed).field(key).value(at_s));
        }
        built.tolerances.validate(&built)?;
        Ok(built)
    }

    /// Replaces the gains and limits of the controller.
    ///
    /// # Errors
    /// A value is out of range.
    pub fn set_control(&mut self, control: ControlParams) -> Result<(), InputError> {
        self.config.params.control = control;
        self.design.control = control;
        self.controller = FlightController::new(&self.config).map_err(|error| refused(&error))?;
        Ok(())
    }

    /// Sets the length of the flight. The time from the landing to the end stays the same.
    ///
    /// # Errors
    /// The length is not from 0.01 s to 10⁶ s, or the landing would be before the take-off.
    pub fn set_duration(&mut self, duration_s: f64) -> Result<(), InputError> {
        self.check_landing(duration_s)?;
        self.duration_s = duration_s;
        Ok(())
    }

    /// Checks that the length is in range and leaves time for the landing.
    fn check_landing(&self, duration_s: f64) -> Result<(), InputError> {
        check::in_range("scene.duration_s", duration_s, 0.01, 1.0e6, "s")?;
        if let Some(plan) = self.pilot.as_ref().map(|p| &p.plan)
            && let Some(before_end_s) = plan.land_before_end_s
        {
            let shortest_s = plan.take_off_at_s + before_end_s;
            if duration_s < shortest_s {
                return Err(InputError::new(format!(
                    "must be at least {shortest_s} s: take-off {} s after the start, landing {before_end_s} s before the end",
                    plan.take_off_at_s
                ))
                .field("scene.duration_s")
                .value(duration_s));
            }
        }
        Ok(())
    }

    /// Returns key and time (s) of each event that would begin at or after the end: of effects and faults, of the pilot's
    /// actions and, if `with_moves`, of the moves of the sticks.
    fn cut_off(&self, with_moves: bool) -> Vec<(String, f64)> {
        let mut starts = self.effects.starts();
        let faults = self.faults.iter().enumerate();
        starts.extend(faults.map(|(n, fault)| (format!("fault[{n}].at_s"), fault.at_s())));
        if let Some(PilotScript { plan, script, .. }) = &self.pilot {
            starts.push(("pilot.arm_at_s".into(), plan.arm_at_s));
            starts.push(("pilot.take_off_at_s".into(), plan.take_off_at_s));
            let moves = script.iter().enumerate().filter(|_| with_moves);
            starts.extend(moves.map(|(n, m)| (format!("pilot.move[{n}].at_s"), m.at_s)));
        }
        starts.retain(|(_, at_s)| *at_s >= self.duration_s);
        starts
    }

    /// Returns a warning for each event of the scene that its end cuts off, because its length was set to a shorter one.
    pub fn warnings(&self) -> Vec<String> {
        let cut_off = self.cut_off(true).into_iter();
        cut_off
            .map(|(key, at_s)| {
                format!(
                    "{} = {at_s}: has no effect, the scene ends at {} s",
                    layers::without_counts(&key),
                    self.duration_s
                )
            })
            .collect()
    }

    /// Returns the names of the effects that the scene names, in the order in which they are applied.
    pub fn effects(&self) -> Vec<&'static str> {
        self.named().filter_map(|(name, named)| named.then_some(name)).collect()
    }

    /// Returns the scene without one of its effects, or without all faults of a kind; `None` if it has none.
    pub fn without(&self, effect: &str) -> Option<Self> {
        let mut scene = self.clone();
        if !(scene.effects.remove(effect) | faults::remove(&mut scene.faults, effect)) {
            return None;
        }
        scene.config.params.stuck_check = scene.effects.stuck_check(&scene.converters);
        // This does not fail: only the stuck-sensor check has changed, and each of its values is valid.
        scene.controller = FlightController::new(&scene.config).ok()?;
        Some(scene)
    }

    /// Returns the names of the known effects that the scene does not name.
    pub fn left_out(&self) -> Vec<&'static str> {
        self.named().filter_map(|(name, named)| (!named).then_some(name)).collect()
    }

    fn named(&self) -> impl Iterator<Item = (&'static str, bool)> {
        self.effects.named().into_iter().chain(faults::named(&self.faults))
    }

    /// Returns the scene of the run with this seed, in which the values that its tolerances draw replace those of the
    /// scene, and the drawn values. The flight code and the pilot keep the values of the scene.
    pub fn for_run(&self, seed: u64) -> (Cow<'_, Self>, Drawn) {
        if self.tolerances.is_empty() {
            return (Cow::Borrowed(self), Drawn::new());
        }
        let mut scene = self.clone();
        let drawn = self.tolerances.apply(&mut scene, seed);
        // The tolerances have been applied.
        scene.tolerances = tolerances::Tolerances::default();
        (Cow::Owned(scene), drawn)
    }

    /// Returns the quantities that are drawn for each run, with their distribution.
    pub fn tolerances(&self) -> Vec<(&'static str, String)> {
        self.tolerances.described()
    }

    /// Returns the flight controller's configuration for a board in the vehicle, with the mounting of board and
    /// magnetometer. In the scene itself the axes of the sensors are those of the vehicle.
    pub fn board_config(&self) -> Config {
        Config { params: self.design.with_mounting(self.config.params), ..self.config }
    }

    /// Returns how the vehicle is held: free above the ground, or on a ball joint.
    pub fn mount(&self) -> Mount {
        if self.ball_joint { Mount::BallJoint } else { Mount::Free(Ground::new(&self.vehicle)) }
    }

    fn context(&self, seed: u64, rate_hz: f64) -> BuildContext<'_> {
        BuildContext { name: "", seed, rate_hz, duration_s: self.duration_s, vehicle: &self.vehicle }
    }

    /// Builds the effects on the vehicle, for steps at this rate.
    pub fn vehicle_effects(&self, seed: u64, rate_hz: f64) -> Vec<(&'static str, VehicleEffect)> {
        let with = self.context(seed, rate_hz);
        let mut list = self.effects.wind.build(with);
        if let Some(shares) = self.thrust_shares {
            list.push(("tolerances.thrust", VehicleEffect::Thrust(Box::new(ThrustShares(shares)))));
        }
        list.extend(self.effects.vehicle.build(with));
        list
    }

    /// Builds the gyroscope with its errors, sampled at this rate.
    pub fn gyro(&self, seed: u64, rate_hz: f64) -> Sensor {
        Sensor::new(self.effects.gyro.build(self.context(seed, rate_hz)), self.converters[0])
    }

    /// Builds the accelerometer with its errors, sampled at this rate.
    pub fn accel(&self, seed: u64, rate_hz: f64) -> Sensor {
        Sensor::new(self.effects.accel.build(self.context(seed, rate_hz)), self.converters[1])
    }

    /// Builds the magnetometer with its errors, sampled at this rate.
    pub fn mag(&self, seed: u64, rate_hz: f64) -> Sensor {
        let readings = self.effects.mag.build(self.context(seed, rate_hz)).into_iter();
        let readings = readings.filter_map(|(name, effect)| match effect {
            MagEffect::Reading(effect) => Some((name, effect)),
            MagEffect::Delivery(_) => None,
        });
        Sensor::new(readings.collect(), self.converters[2])
    }

    /// Builds all sensors with their errors and the delivery effects on their samples. The IMU is sampled at `rate_hz`,
    /// the magnetometer at `mag_rate_hz`.
    pub fn sensors(&self, seed: u64, rate_hz: f64, mag_rate_hz: f64) -> Sensors {
        let mut sensors = Sensors {
            gyro: self.gyro(seed, rate_hz),
            accel: self.accel(seed, rate_hz),
            mag: self.mag(seed, mag_rate_hz),
            field_ut: self.field_ut,
            jitter: None,
            imu_delivery: Vec::new(),
            mag_delivery: Vec::new(),
        };
        for (_, effect) in self.imu_effects(seed, rate_hz) {
            match effect {
                ImuEffect::Sampling(jitter) => sensors.jitter = Some(jitter),
                ImuEffect::Delivery(effect) => sensors.imu_delivery.push(effect),
            }
        }
        for (_, effect) in self.mag_effects(seed, mag_rate_hz) {
            if let MagEffect::Delivery(effect) = effect {
                sensors.mag_delivery.push(effect);
            }
        }
        sensors
    }

    /// Builds the delivery effects on the transmitter's frames, for steps at this rate.
    pub fn link(&self, seed: u64, rate_hz: f64) -> Vec<Named<BoxedDelivery<RcFrame>>> {
        self.effects.link.build(self.context(seed, rate_hz))
    }

    /// Builds the effects on the delivery of IMU samples, faults first, for steps at this rate.
    pub fn imu_effects(&self, seed: u64, rate_hz: f64) -> Vec<Named<ImuEffect>> {
        let faults = faults::on_imu(&self.faults, rate_hz).into_iter();
        let effects = self.effects.imu.build(self.context(seed, rate_hz));
        faults.map(|(name, effect)| (name, effect.into())).chain(effects).collect()
    }

    /// Builds the effects on magnetometer samples, faults first, for samples at this rate.
    pub fn mag_effects(&self, seed: u64, rate_hz: f64) -> Vec<Named<MagEffect>> {
        let faults = faults::on_mag(&self.faults, rate_hz).into_iter();
        let effects = self.effects.mag.build(self.context(seed, rate_hz));
        faults.map(|(name, effect)| (name, effect.into())).chain(effects).collect()
    }

    /// Returns the flight controller at the start of its flight, disarmed.
    pub fn controller(&self) -> FlightController {
        self.controller.clone()
    }

    /// Returns the pilot's knowledge of the vehicle.
    pub fn pilot_knowledge(&self) -> Knowledge {
        let control = &self.config.params.control;
        Knowledge {
            hover_throttle: self.vehicle.hover_throttle(),
            max_tilt_rad: f64::from(control.max_tilt_rad),
            max_yaw_rate_rad_s: f64::from(control.max_yaw_rate_rad_s),
            arm_by: self.config.params.arm_by,
        }
    }
}

/// Adds file and line to an error about a key of the merged scene, or at least the file of the scene.
fn located(layers: &Layers, error: InputError, table: &DeTable<'_>, scene: &str) -> InputError {
    let error = layers.locate(error, table);
    if error.has_file() { error } else { error.file(scene) }
}

/// Adds the second place for a missing value of a sensor's effect: the preset.
fn with_hint(error: InputError) -> InputError {
    let of_sensor = error.field_name().is_some_and(|field| {
        ["effects.gyro.", "effects.accel.", "effects.mag.", "effects.imu."]
            .iter()
            .any(|of| field.starts_with(of))
    });
    if error.is_missing() && of_sensor {
        error.also(": give it here, or in the IMU preset (scene.imu)")
    } else {
        error
    }
}

/// Returns the error for a value that the flight controller refuses. Values of a calibration have the keys of the scene.
fn refused(error: &ConfigError) -> InputError {
    let key = error.field.strip_prefix("calibration.").and_then(|rest| {
        let (sensor, rest) = rest.split_once('.')?;
        let (key, property) = rest.split_once(" (").map_or((rest, ""), |(key, more)| (key, more));
        let sensors =
            [("gyro", "gyro_rad_s", "rad/s"), ("accel", "accel_m_s2", "m/s²"), ("mag", "mag_ut", "µT")];
        let (_, table, unit) = sensors.into_iter().find(|(name, ..)| *name == sensor)?;
        Some((format!("flight.calibration.{table}.{key}"), property.trim_end_matches(')'), unit))
    });
    let Some((key, property, unit)) = key else { return InputError::new(error.to_string()).field("flight") };
    let ConfigError { value, minimum, maximum, .. } = error;
    let range = format!("must be from {minimum} to {maximum}");
    match property {
        "" => InputError::new(format!("{range} {unit}")).field(key).value(value),
        property => InputError::new(format!("{property} = {value}: {range}")).field(key),
    }
}

/// Returns the string with this key in the table `[scene]`.
fn string_in(layers: &Layers, table: &DeTable<'_>, key: &str, what: &str) -> Result<String, InputError> {
    let found = match table.get("scene").map(Spanned::get_ref) {
        None => None,
        Some(DeValue::Table(scene)) => {
            layers.string(scene, key).map_err(|error| error.field(format!("scene.{key}")))?
        }
        Some(_) => return Err(InputError::new("must be a table").field("scene")),
    };
    found.ok_or_else(|| {
        let more = format!(": must be the name of a built-in {what}, or of a file");
        InputError::missing().field(format!("scene.{key}")).also(&more)
    })
}

/// Returns the vehicle's values for effects that a scene names without values, as TOML.
fn vehicle_values_toml(design: &Vehicle) -> String {
    let vehicle = &design.params;
    let Vec3 { x, y, z } = vehicle.drag_kg_per_s;
    format!(
        "[vehicle.motor_lag]\ntau_s = {:?}\n[vehicle.linear_drag]\na_kg_per_s = [{x:?}, {y:?}, {z:?}]\n\
         [vehicle.battery_sag]\ncells = {}\n",
        vehicle.lag_s, design.cells
    )
}

impl file::Flight {
    fn build(&self, design: &Vehicle, preset: &ImuPreset, field_ut: Vec3<f64>) -> Result<Config, InputError> {
        let estimator = match &self.estimator {
            None => design.estimator,
            Some(name) => vehicle::estimator("flight.estimator", name)?,
        };
        let prefilter_hz = match self.prefilter_hz {
            None => design.prefilter_hz,
            Some(cutoff) => cutoff.hz(),
        };
        if let Some(cutoff_hz) = prefilter_hz {
            let (min_hz, max_hz) = vehicle::prefilter_range_hz();
            check::in_open_range("flight.prefilter_hz", cutoff_hz, min_hz, max_hz, vehicle::PREFILTER_UNIT)?;
        }
        let declination_rad = match self.declination_deg {
            file::Declination::Model => declination_rad(field_ut),
            file::Declination::Given(degrees) => {
                check::in_range("flight.declination_deg", degrees, -180.0, 180.0, "deg")?;
                degrees.to_radians()
            }
        };
        let along_body =
            |c: Converter| Sensitivity { per_count: c.per_count() as f32, mounting: Mat3::IDENTITY };
        let [gyro, accel, mag] = preset.converters().map(along_body);
        let board = Params {
            imu_rate_hz: DEFAULT_RATE_HZ as f32,
            mag_rate_hz: MAG_RATE_HZ as f32,
            gyro,
            accel,
            mag,
            ..Params::default()
        };
        let params = Params {
            prefilter_cutoff_hz: prefilter_hz.map(|hz| hz as f32),
            estimator: EstimatorParams { declination_rad: declination_rad as f32, ..estimator },
            ..design.flight_params(&board)
        };
        let calibration = self.calibration.as_ref().map(|c| {
            let sensor = |s: &Option<file::SensorCalibrationTable>| {
                s.as_ref().map_or(SensorCalibration::NONE, |s| SensorCalibration {
                    bias: Vec3::from(s.bias.map(|b| b as f32)),
                    matrix: s
                        .matrix
                        .map_or(Mat3::IDENTITY, |m| Mat3::from_rows(m.map(|r| r.map(|x| x as f32)))),
                })
            };
            Calibration { gyro: sensor(&c.gyro_rad_s), accel: sensor(&c.accel_m_s2), mag: sensor(&c.mag_ut) }
        });
        // Without a calibration the sensors have the nominal values of their data sheets.
        Ok(Config { params, calibration: Some(calibration.unwrap_or(Calibration::NONE)) })
    }
}

#[cfg(test)]
mod tests;
