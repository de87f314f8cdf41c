//! What a scene says: a TOML file, read, checked, and turned into the parts of a flight.
//!
//! A scene names the vehicle, the sensors, the pilot and the effects. **An effect that it does not name is
//! not built.** Every key that exists is in `file.rs`, `effects.rs` and `tolerances.rs`; anything else is an error
//! that names the nearest one.

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
use flight_core::config::{Config, Params};
use flight_core::control::ControlParams;
use flight_core::estimator::EstimatorParams;
use flight_core::geometry::{Mat3, Vec3, vec3};
use flight_core::sample::RcFrame;

use crate::dynamics::{Ground, Mount, VehicleParams};
use crate::earth_field::{Place, declination_rad};
use crate::effects::Build;
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

/// Steps of the simulation, and samples of gyroscope and accelerometer, per second.
pub const DEFAULT_RATE_HZ: u32 = 1000;

/// Samples of the magnetometer per second.
pub const MAG_RATE_HZ: u32 = 100;

/// The Earth's field at Ankara, north, east, down, µT: WMM2025 at 39.93° N, 32.86° E, 0.9 km, in November
/// 2026 (declination 6.175° east, inclination 58.19°, 48.18 µT), from another implementation than the one
/// that scenes use.
pub const FIELD_ANKARA_UT: Vec3<f64> = vec3(25.248, 2.732, 40.940);

/// The scenes that a scene includes, directly or through another, the nearest first.
struct Included {
    name: String,
    text: String,
}

/// Scenes that include each other in a row; more of them are a circle that goes by ever other names.
const MAX_INCLUDED: usize = 16;

impl Included {
    fn of(name: &str, text: &str, read: ReadText) -> Result<Vec<Self>, InputError> {
        let mut list: Vec<Self> = Vec::new();
        let (mut name, mut text) = (name.to_owned(), text.to_owned());
        while let Some(next) = layers::text_at(&name, &text, "include")? {
            let found = if let Some(scene) = BUILT_IN.iter().find(|scene| scene.name == next) {
                Self { name: next, text: scene.text.into() }
            } else {
                // Beside the file that includes it.
                let path = Path::new(&name).with_file_name(&next);
                let text = read(&path).map_err(|error| {
                    InputError::new(format!(
                        "is no built-in scene, and {} cannot be read: {error}",
                        path.display()
                    ))
                    .file(&name)
                    .field("include")
                    .value(&next)
                })?;
                Self { name: path.display().to_string(), text }
            };
            if list.len() == MAX_INCLUDED || list.iter().any(|included| included.name == found.name) {
                return Err(InputError::new("a scene includes itself")
                    .file(&name)
                    .field("include")
                    .value(&found.name));
            }
            (name, text) = (found.name.clone(), found.text.clone());
            list.push(found);
        }
        Ok(list)
    }
}

/// An effect and its name.
pub type Named<T> = (&'static str, T);

/// A checked scene.
#[derive(Clone, Debug)]
pub struct Scene {
    /// Name of a built-in scene, or the file's.
    pub name: String,
    /// What the scene is for, in a line.
    pub description: String,
    /// Length, s.
    pub duration_s: f64,
    /// Seed of every random stream.
    pub seed: u64,
    /// The vehicle that flies: `design`'s, but for what tolerances have drawn.
    pub vehicle: VehicleParams,
    /// The vehicle of the file, with what the scene alters.
    pub design: Vehicle,
    /// Where `design` is from: the name of a built-in vehicle, or the path of a file.
    pub vehicle_place: String,
    /// The files that it was put together from, and its own name.
    pub files: Vec<PathBuf>,
    /// Whether it stands on a ball joint.
    pub ball_joint: bool,
    /// Whether a tilt above 90° is meant.
    pub aerobatic: bool,
    /// `None`: nobody flies, the vehicle lies on the bench.
    pub pilot: Option<PilotScript>,
    /// What flight-core is configured with.
    pub config: Config,
    controller: FlightController,
    /// The sensors' converters: gyro (rad/s), accel (m/s²), mag (µT).
    pub converters: [Converter; 3],
    /// The Earth's field at the scene's place and date, north, east, down, µT.
    pub field_ut: Vec3<f64>,
    /// Hash of the texts that the scene was put together from.
    pub text_hash: u64,
    effects: effects::Effects,
    faults: Vec<faults::Fault>,
    tolerances: tolerances::Tolerances,
    /// Thrust of each rotor beside the vehicle's coefficient; only in the scene of a run.
    thrust_shares: Option<[f64; 4]>,
}

impl Scene {
    /// A built-in scene by name, or a scene file by path.
    ///
    /// # Errors
    /// A name that is neither, with the nearest built-in one; anything wrong in the file.
    pub fn load(name_or_path: &str) -> Result<Self, InputError> {
        if let Some(scene) = BUILT_IN.iter().find(|scene| scene.name == name_or_path) {
            return Self::parse(scene.name, scene.text);
        }
        let path = Path::new(name_or_path);
        if !path.exists() {
            let names = BUILT_IN.iter().map(|scene| scene.name);
            let near = check::nearest(name_or_path, names.clone());
            let list = names.collect::<Vec<_>>().join(", ");
            return Err(InputError::new(format!(
                "no such file and no built-in scene{near} (there are: {list})"
            ))
            .field("SCENE")
            .value(name_or_path));
        }
        let text = layers::text_of(path)
            .map_err(|error| InputError::new(format!("cannot be read: {error}")).file(path))?;
        Self::parse(name_or_path, &text)
    }

    /// [`Scene::load`], flown by another vehicle: a built-in one by name, or a vehicle file by path.
    ///
    /// # Errors
    /// As there, and anything wrong with the vehicle.
    pub fn load_with_vehicle(name_or_path: &str, vehicle: Option<&str>) -> Result<Self, InputError> {
        let scene = Self::load(name_or_path)?;
        let Some(vehicle) = vehicle else { return Ok(scene) };
        // As paths from here, wherever the scene is.
        let absolute = |path: &str, built_in: bool| match std::path::absolute(path) {
            Ok(absolute) if !built_in => absolute.display().to_string(),
            _ => path.to_owned(),
        };
        let include = absolute(name_or_path, BUILT_IN.iter().any(|scene| scene.name == name_or_path));
        vehicle::find(vehicle, Path::new(""), &layers::text_of)
            .map_err(|error| error.field("--vehicle").value(vehicle))?;
        let mut altered = toml::Table::new();
        altered.insert("include".into(), include.into());
        let vehicle = absolute(vehicle, vehicle::is_built_in(vehicle));
        altered.insert("scene".into(), toml::Table::from_iter([("vehicle".into(), vehicle.into())]).into());
        Self::parse(&scene.name, &altered.to_string())
    }

    /// The files that no output may take the place of.
    pub fn inputs(&self) -> Vec<&Path> {
        self.files.iter().map(PathBuf::as_path).collect()
    }

    /// Reads a scene from TOML; `name` is what errors and results call it.
    ///
    /// # Errors
    /// Anything wrong in the text, in the scene it includes or in its sensors' preset.
    pub fn parse(name: &str, text: &str) -> Result<Self, InputError> {
        Self::parse_with(name, text, &layers::text_of)
    }

    /// [`Scene::parse`], with the files that the scene names read by `read`.
    ///
    /// # Errors
    /// As there.
    pub fn parse_with(name: &str, text: &str, read: ReadText) -> Result<Self, InputError> {
        let files = RefCell::new(vec![PathBuf::from(name)]);
        let read: ReadText = &|path| {
            files.borrow_mut().push(path.into());
            read(path)
        };
        let scene = Self::of_layers(name, text, read)?;
        Ok(Self { files: files.into_inner(), ..scene })
    }

    fn of_layers(name: &str, text: &str, read: ReadText) -> Result<Self, InputError> {
        if text.trim().is_empty() {
            return Err(InputError::new("is empty; a scene needs a [scene] table").file(name));
        }
        let below = Included::of(name, text, read)?;
        // Declared before the layers that borrow them.
        let (preset_name, preset_text);
        let mut layers = Layers::default();
        let mut table = layers.add(name, text)?;
        for included in &below {
            let under = layers.add(&included.name, &included.text)?;
            table = merge(table, under);
        }
        let vehicle_name = string_in(&table, "vehicle", "vehicle").map_err(|error| error.file(name))?;
        let (vehicle_layer, vehicle_text, figures_text);
        (vehicle_layer, vehicle_text) = vehicle::find(&vehicle_name, Path::new(name), read)
            .map_err(|error| error.file(name).field("scene.vehicle").value(&vehicle_name))?;
        let mut vehicle_table = layers.add(&vehicle_layer, &vehicle_text)?;
        let altered = match table.remove("vehicle").map(Spanned::into_inner) {
            None => DeTable::new(),
            Some(DeValue::Table(altered)) => altered,
            Some(_) => {
                return Err(InputError::new("must be a table; the vehicle's name stands in [scene]")
                    .file(name)
                    .field("vehicle"));
            }
        };
        vehicle_table = merge(altered.clone(), vehicle_table);
        let design = Vehicle::of_table(&vehicle_name, &layers, vehicle_table).map_err(|error| {
            let here = error.field_name().is_some_and(|field| layers::has(&altered, field));
            match error.has_file() {
                true => error,
                false => error.file(if here { name } else { &vehicle_layer }),
            }
        })?;
        figures_text = figures(&design);
        let own_figures = layers.add(&format!("figures of {vehicle_layer}"), &figures_text)?;
        let imu = string_in(&table, "imu", "sensor preset").map_err(|error| error.file(name))?;
        (preset_name, preset_text) = imu::find(&imu, Path::new(name), read)?;
        let (preset, figures) = ImuPreset::read(&mut layers, &preset_name, &preset_text)?;
        if let Some(DeValue::Table(effects)) = table.get_mut("effects").map(Spanned::get_mut) {
            complete(effects, &figures);
            complete(effects, &own_figures);
        }
        let text_hash = layers.hash();
        let file: file::SceneFile =
            layers.read(table).map_err(|error| if error.has_file() { error } else { error.file(name) })?;
        let vehicle_place = if vehicle::is_built_in(&vehicle_name) { vehicle_name } else { vehicle_layer };
        let scene = Self::build(name, file, design, &preset, text_hash).map_err(|error| error.file(name))?;
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
        stiffness::check_legs(&vehicle)?;
        effects.validate()?;
        stiffness::check_drag(&effects.vehicle, &vehicle)?;
        faults.iter().try_for_each(faults::Fault::validate)?;
        let field_ut = scene.place.map_or(Place::ANKARA, file::PlaceTable::build).field_ut()?;
        let ball_joint = scene.mount == file::MountName::BallJoint;
        let pilot = pilot.map(|p| p.build(ball_joint)).transpose()?;
        let mut config = flight.build(&design, preset, field_ut)?;
        let converters = preset.converters();
        config.params.stuck_check = effects.stuck_check(&converters);
        let controller =
            FlightController::new(&config).map_err(|e| InputError::new(e.to_string()).field("flight"))?;
        let mut built = Self {
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
        built.set_duration(scene.duration_s)?;
        built.tolerances.validate(&built)?;
        Ok(built)
    }

    /// Flies with other gains and limits.
    ///
    /// # Errors
    /// One of them is out of range.
    pub fn set_control(&mut self, control: ControlParams) -> Result<(), InputError> {
        self.config.params.control = control;
        self.design.control = control;
        self.controller = FlightController::new(&self.config)
            .map_err(|error| InputError::new(error.to_string()).field("flight"))?;
        Ok(())
    }

    /// Makes the flight longer or shorter; a landing keeps its distance from the end.
    ///
    /// # Errors
    /// A length outside 0.01 s to 10⁶ s, or one that would land before it takes off.
    pub fn set_duration(&mut self, duration_s: f64) -> Result<(), InputError> {
        check::in_range("scene.duration_s", duration_s, 0.01, 1.0e6, "s")?;
        if let Some(plan) = self.pilot.as_mut().map(|p| &mut p.plan)
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
        self.duration_s = duration_s;
        Ok(())
    }

    /// The names of the effects that the scene calls for, in the order in which they apply.
    pub fn effects(&self) -> Vec<&'static str> {
        self.named().filter_map(|(name, named)| named.then_some(name)).collect()
    }

    /// The same scene without one of its effects, or without all faults of a kind; `None` if it names none.
    pub fn without(&self, effect: &str) -> Option<Self> {
        let mut scene = self.clone();
        if !(scene.effects.leave_out(effect) | faults::leave_out(&mut scene.faults, effect)) {
            return None;
        }
        scene.config.params.stuck_check = scene.effects.stuck_check(&scene.converters);
        // Only which sensors are checked has changed, and no value of that is out of range.
        scene.controller = FlightController::new(&scene.config).ok()?;
        Some(scene)
    }

    /// The effects that there are and the scene does not name.
    pub fn left_out(&self) -> Vec<&'static str> {
        self.named().filter_map(|(name, named)| (!named).then_some(name)).collect()
    }

    fn named(&self) -> impl Iterator<Item = (&'static str, bool)> {
        self.effects.named().into_iter().chain(faults::named(&self.faults))
    }

    /// The scene as the run with this seed flies it, with what its tolerances have drawn in place of the scene's
    /// figures; and what they have drawn. Flight code and pilot know nothing of it.
    pub fn of_run(&self, seed: u64) -> (Cow<'_, Self>, Drawn) {
        if self.tolerances.is_empty() {
            return (Cow::Borrowed(self), Drawn::new());
        }
        let mut scene = self.clone();
        let drawn = self.tolerances.apply(&mut scene, seed);
        // Drawn once.
        scene.tolerances = tolerances::Tolerances::default();
        (Cow::Owned(scene), drawn)
    }

    /// The quantities that are drawn for each run, and how.
    pub fn tolerances(&self) -> Vec<(&'static str, String)> {
        self.tolerances.described()
    }

    /// The flight controller's configuration for a board that is built into the vehicle: with how the board lies there, and
    /// how the magnetometer does. In the scene itself the sensors lie along the vehicle's axes.
    pub fn board_config(&self) -> Config {
        Config { params: self.design.mounted(self.config.params), ..self.config }
    }

    /// How the vehicle is held.
    pub fn mount(&self) -> Mount {
        if self.ball_joint { Mount::BallJoint } else { Mount::Free(Ground::new(&self.vehicle)) }
    }

    fn build_at(&self, seed: u64, rate_hz: f64) -> Build<'_> {
        Build { name: "", seed, rate_hz, duration_s: self.duration_s, vehicle: &self.vehicle }
    }

    /// The effects on the vehicle, for steps at this rate.
    pub fn vehicle_effects(&self, seed: u64, rate_hz: f64) -> Vec<(&'static str, VehicleEffect)> {
        let with = self.build_at(seed, rate_hz);
        let mut list = self.effects.wind.build(with);
        if let Some(shares) = self.thrust_shares {
            list.push(("tolerances.thrust", VehicleEffect::Thrust(Box::new(ThrustShares(shares)))));
        }
        list.extend(self.effects.vehicle.build(with));
        list
    }

    /// The gyroscope with its errors, sampled at this rate.
    pub fn gyro(&self, seed: u64, rate_hz: f64) -> Sensor {
        Sensor::new(self.effects.gyro.build(self.build_at(seed, rate_hz)), self.converters[0])
    }

    /// The accelerometer with its errors, sampled at this rate.
    pub fn accel(&self, seed: u64, rate_hz: f64) -> Sensor {
        Sensor::new(self.effects.accel.build(self.build_at(seed, rate_hz)), self.converters[1])
    }

    /// The magnetometer with its errors, sampled at this rate.
    pub fn mag(&self, seed: u64, rate_hz: f64) -> Sensor {
        let readings = self.effects.mag.build(self.build_at(seed, rate_hz)).into_iter();
        let readings = readings.filter_map(|(name, effect)| match effect {
            MagEffect::Reading(effect) => Some((name, effect)),
            MagEffect::Delivery(_) => None,
        });
        Sensor::new(readings.collect(), self.converters[2])
    }

    /// All sensors with their errors and what befalls their samples, gyroscope and accelerometer sampled at
    /// `rate_hz`, the magnetometer at `mag_rate_hz`.
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

    /// What befalls the transmitter's frames, at this many steps a second.
    pub fn link(&self, seed: u64, rate_hz: f64) -> Vec<Named<BoxedDelivery<RcFrame>>> {
        self.effects.link.build(self.build_at(seed, rate_hz))
    }

    /// What befalls the inertial samples, faults first, at this many steps a second.
    pub fn imu_effects(&self, seed: u64, rate_hz: f64) -> Vec<Named<ImuEffect>> {
        let faults = faults::on_imu(&self.faults, rate_hz).into_iter();
        let effects = self.effects.imu.build(self.build_at(seed, rate_hz));
        faults.map(|(name, effect)| (name, effect.into())).chain(effects).collect()
    }

    /// What befalls the magnetometer's samples, faults first, at this many of them a second.
    pub fn mag_effects(&self, seed: u64, rate_hz: f64) -> Vec<Named<MagEffect>> {
        let faults = faults::on_mag(&self.faults, rate_hz).into_iter();
        let effects = self.effects.mag.build(self.build_at(seed, rate_hz));
        faults.map(|(name, effect)| (name, effect.into())).chain(effects).collect()
    }

    /// The flight controller, disarmed, at the start of its flight.
    pub fn controller(&self) -> FlightController {
        self.controller.clone()
    }

    /// What the pilot knows of the vehicle.
    pub fn pilot_knowledge(&self) -> Knowledge {
        let control = &self.config.params.control;
        Knowledge {
            hover_throttle: self.vehicle.hover_throttle(),
            max_tilt_rad: f64::from(control.max_tilt_rad),
            max_yaw_rate_rad_s: f64::from(control.max_yaw_rate_rad_s),
        }
    }
}

/// The string under `[scene]` with this key.
fn string_in(table: &DeTable<'_>, key: &str, what: &str) -> Result<String, InputError> {
    let found = match table.get("scene").map(Spanned::get_ref) {
        None => None,
        Some(DeValue::Table(scene)) => {
            layers::string(scene, key).map_err(|error| error.field(format!("scene.{key}")))?
        }
        Some(_) => return Err(InputError::new("must be a table").field("scene")),
    };
    found.ok_or_else(|| {
        InputError::new(format!("is missing: the name of a built-in {what}, or a file's"))
            .field(format!("scene.{key}"))
    })
}

/// Figures of a vehicle for the effects that a scene names without figures.
fn figures(design: &Vehicle) -> String {
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
            let (least_hz, most_hz) = vehicle::prefilter_range_hz();
            check::in_open_range(
                "flight.prefilter_hz",
                cutoff_hz,
                least_hz,
                most_hz,
                vehicle::PREFILTER_ALLOWED,
            )?;
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
        // A scene that names none flies sensors that are as their datasheets say.
        Ok(Config { params, calibration: Some(calibration.unwrap_or(Calibration::NONE)) })
    }
}

#[cfg(test)]
mod tests;
