//! The study `estimator`: attitude from all three sensors.
//!
//! Every estimator gets the same samples: those of a recording, or those of the sensors in a simulated flight,
//! calibrated, and zeroed at rest as before arming. A second error is that without the zero. As in flight, samples pass
//! the scene's prefilter, as far as the estimator takes its inputs after it ([`FilterInput`]).

use std::hint::black_box;
use std::path::Path;
use std::time::Duration;

use flight_core::calibration::{Calibration, SensorFields, SensorModel};
use flight_core::estimator::{Estimator, EstimatorParams, FilterInput, Kinematics, Weight};
use flight_core::geometry::{Quaternion, Vec3, vec3};
use flight_core::prefilter::{Biquad, Prefilter};
use nalgebra::{Quaternion as Parts, UnitQuaternion, Vector3};
use uf_ahrs::{Ahrs, Madgwick, MadgwickParams, Mahony, MahonyParams, Vqf, VqfParams};

use super::timing::shortest_ns;
use super::{Axis, Options, Progress, Setting, Study, m4};
use input::InputError;
use sim_host::attitude_error::{AttitudeError, AttitudeRmse};
use sim_host::estimate::{self, GyroAtRest, Request, Sample};
use sim_host::flight::{Flight, Observer, StepView};
use sim_host::log::{AccelSign, Axes, Frame, Log};
use sim_host::scene::Scene;

/// Recordings of BROAD (Laidig, Caruso, Cereatti, Seel, *Data* 6(7):72, 2021), and their names in the plots.
const RECORDINGS: [(&str, &str); 4] = [
    ("02_undisturbed_slow_rotation_B.csv", "recording 02, slow rotation"),
    ("07_undisturbed_fast_rotation_B.csv", "recording 07, fast rotation"),
    ("11_undisturbed_slow_translation_B.csv", "recording 11, slow translation"),
    ("27_disturbed_phone_vibration_B.csv", "recording 27, phone vibration"),
];
/// Simulated flights.
const SCENES: [(&str, &str); 2] = [("steps", "simulated, steps"), ("shaky-frame", "simulated, shaky-frame")];

/// The samples of a flight or a recording, and the truth where the error counts.
struct Record {
    problem: &'static str,
    samples: Vec<Sample>,
    /// The same samples after the prefilter; `None` without one.
    prefiltered: Option<Vec<Sample>>,
    truth: Vec<Option<Quaternion<f64>>>,
    /// Declination, which turns magnetic into true north, rad.
    declination_rad: f64,
}

/// A running estimator.
enum Filter {
    Ours(Box<Estimator>),
    /// From the crate `uf-ahrs`: body axes forward, left, up; world axes north, west, up.
    Theirs {
        filter: Box<dyn Ahrs>,
        started: bool,
    },
}

/// An estimator that is compared.
#[derive(Clone, Copy)]
enum Entrant {
    Ours(EstimatorParams),
    Mahony,
    Madgwick,
    Vqf,
}

/// Returns all presets of flight-core, the paper's filter on a quaternion, and filters of others with their own
/// defaults.
fn entrants() -> Vec<(&'static str, Entrant)> {
    let mut list: Vec<(&'static str, Entrant)> =
        EstimatorParams::PRESETS.iter().map(|&(name, params)| (name, Entrant::Ours(params))).collect();
    let paper = EstimatorParams::complementary(Kinematics::Quaternion, Weight::PAPER);
    list.push(("paper on a quaternion", Entrant::Ours(paper)));
    list.extend([("Mahony", Entrant::Mahony), ("Madgwick", Entrant::Madgwick), ("VQF", Entrant::Vqf)]);
    list
}

/// Converts between forward-right-down and forward-left-up, and so between north-east-down and north-west-up.
fn with_y_and_z_reversed(v: Vec3<f32>) -> Vector3<f32> {
    Vector3::new(v.x, -v.y, -v.z)
}

impl Entrant {
    /// Which inputs it takes after the prefilter. VQF is a low-pass itself, as `robust` is.
    fn input(self) -> FilterInput {
        match self {
            Self::Ours(params) => {
                Estimator::new(&params).map_or(FilterInput::Prefiltered, |estimator| estimator.input())
            }
            Self::Mahony | Self::Madgwick => FilterInput::Prefiltered,
            Self::Vqf => FilterInput::Calibrated,
        }
    }
}

impl Filter {
    fn new(entrant: Entrant, samples: &[Sample]) -> Result<Self, InputError> {
        // The first sample has no interval before it. The filters of `uf-ahrs` take one rate for all samples.
        let seconds: f64 = samples.iter().map(|s| f64::from(s.dt_s)).sum();
        let count = samples.len().saturating_sub(1).max(1) as f64;
        let fields = samples.iter().filter(|s| s.mag.is_some()).count().saturating_sub(1).max(1) as f64;
        let (period, mag_period) = (
            Duration::from_secs_f64((seconds / count).max(1e-6)),
            Duration::from_secs_f64((seconds / fields).max(1e-6)),
        );
        let theirs = |filter| Self::Theirs { filter, started: false };
        Ok(match entrant {
            Entrant::Ours(params) => {
                let estimator =
                    Estimator::new(&params).map_err(|error| InputError::new(error.to_string()))?;
                Self::Ours(Box::new(estimator))
            }
            Entrant::Mahony => theirs(Box::new(Mahony::new(period, MahonyParams::default()))),
            Entrant::Madgwick => theirs(Box::new(Madgwick::new(period, MadgwickParams::default()))),
            Entrant::Vqf => {
                theirs(Box::new(Vqf::new_with_sensor_rates(period, period, mag_period, VqfParams::default())))
            }
        })
    }

    #[inline]
    fn step(&mut self, s: &Sample) {
        match self {
            Self::Ours(estimator) => estimator.update(s.gyro, s.accel, s.mag, s.dt_s),
            Self::Theirs { filter, started } => {
                if !*started {
                    // The filters start at the attitude that the first sample shows, as Kestrel's do.
                    *started = true;
                    if let Ok(mut first) = Estimator::new(&EstimatorParams::FLIGHT) {
                        first.update(s.gyro, s.accel, s.mag, 0.0);
                        let [w, x, y, z] = first.attitude().to_array();
                        filter.set_orientation(UnitQuaternion::from_quaternion(Parts::new(w, x, -y, -z)));
                    }
                }
                let (gyro, accel) = (with_y_and_z_reversed(s.gyro), with_y_and_z_reversed(s.accel));
                match s.mag {
                    Some(mag) => filter.update(gyro, accel, with_y_and_z_reversed(mag)),
                    None => filter.update_imu(gyro, accel),
                };
            }
        }
    }

    fn attitude(&self) -> Quaternion<f64> {
        match self {
            Self::Ours(estimator) => {
                let [w, x, y, z] = estimator.attitude().to_array().map(f64::from);
                Quaternion::new(w, x, y, z)
            }
            Self::Theirs { filter, .. } => {
                let q = filter.orientation();
                let [w, x, y, z] = [q.w, q.i, q.j, q.k].map(f64::from);
                Quaternion::new(w, x, -y, -z)
            }
        }
    }
}

fn recording(directory: &Path, file: &str, problem: &'static str) -> Result<Record, InputError> {
    let axes = Axes { frame: Frame::Enu, accel_sign: AccelSign::Reaction };
    let request = Request { log: directory.join("broad").join(file), axes, ..Request::default() };
    let log = Log::read(&request.log, request.axes)?;
    let truth = log.rows.iter().map(|row| {
        let [w, x, y, z] = row.reference.filter(|_| row.moving)?;
        Some(Quaternion::new(w, x, y, z))
    });
    Ok(Record {
        problem,
        samples: estimate::samples(&log, &request)?,
        prefiltered: None,
        truth: truth.collect(),
        declination_rad: 0.0,
    })
}

/// Records the samples of a flight's sensors, calibrated and prefiltered.
struct SampleRecorder {
    models: [SensorModel; 3],
    prefilters: [Prefilter; 3],
    last_us: Option<u64>,
    record: Record,
}

impl Observer for SampleRecorder {
    fn step(&mut self, view: &StepView) {
        let Some(imu) = &view.input.imu else { return };
        let [gyro, accel, mag] = &self.models;
        let [gyro_filter, accel_filter, mag_filter] = &mut self.prefilters;
        let dt_us = self.last_us.map_or(0, |last| view.time_us - last);
        self.last_us = Some(view.time_us);
        let sample = Sample {
            gyro: gyro.apply(imu.gyro),
            accel: accel.apply(imu.accel),
            mag: view.input.mag.map(|field| mag.apply(field.counts)),
            dt_s: dt_us as f32 * 1e-6,
        };
        self.record.samples.push(sample);
        self.record.prefiltered.get_or_insert_default().push(Sample {
            gyro: gyro_filter.step(sample.gyro),
            accel: accel_filter.step(sample.accel),
            mag: sample.mag.map(|field| mag_filter.step(field)),
            ..sample
        });
        // The error counts in flight, not at rest before and after it.
        self.record.truth.push(view.output.driven.then_some(view.truth.attitude));
    }
}

fn flown(name: &str, problem: &'static str) -> Result<Record, InputError> {
    let scene = Scene::load(name)?;
    let p = &scene.config.params;
    let calibration = scene.config.calibration.unwrap_or(Calibration::NONE);
    let model = |fields, sensitivity, calibration| {
        SensorModel::new(fields, sensitivity, calibration).map_err(|error| InputError::new(error.to_string()))
    };
    let prefilter = |rate_hz| {
        let design =
            p.prefilter_cutoff_hz.map(|cutoff_hz| Biquad::butterworth(cutoff_hz, rate_hz)).transpose();
        design.map(Prefilter::new).map_err(|error| InputError::new(error.to_string()))
    };
    let mut recorder = SampleRecorder {
        models: [
            model(SensorFields::GYRO, p.gyro, calibration.gyro)?,
            model(SensorFields::ACCEL, p.accel, calibration.accel)?,
            model(SensorFields::MAG, p.mag, calibration.mag)?,
        ],
        prefilters: [prefilter(p.imu_rate_hz)?, prefilter(p.imu_rate_hz)?, prefilter(p.mag_rate_hz)?],
        last_us: None,
        record: Record {
            problem,
            samples: Vec::new(),
            prefiltered: None,
            truth: Vec::new(),
            declination_rad: f64::from(p.estimator.declination_rad),
        },
    };
    Flight::new(&scene, scene.seed).run(&mut recorder);
    Ok(recorder.record)
}

/// Returns the RMSE over the samples whose truth counts, degrees.
fn rmse_deg(entrant: Entrant, record: &Record, samples: &[Sample]) -> Result<Option<f64>, InputError> {
    let (sin, cos) = libm::sincos(0.5 * record.declination_rad);
    let to_true_north = Quaternion { w: cos, v: vec3(0.0, 0.0, sin) };
    let mut filter = Filter::new(entrant, samples)?;
    let mut rmse = AttitudeRmse::default();
    for (sample, truth) in samples.iter().zip(&record.truth) {
        filter.step(sample);
        if let Some(truth) = truth {
            rmse.add(AttitudeError::between(to_true_north * filter.attitude(), *truth));
        }
    }
    Ok(rmse.root().map(|error| error.total_rad.to_degrees()))
}

/// Runs the study.
///
/// # Errors
/// A recording cannot be read.
pub fn study(options: &Options, progress: Progress) -> Result<Study, InputError> {
    let mut records = Vec::new();
    for (name, problem) in SCENES {
        records.push(flown(name, problem)?);
    }
    if let Some(directory) = &options.recordings {
        let wanted = if options.quick { &RECORDINGS[..1] } else { &RECORDINGS[..] };
        for (file, problem) in wanted {
            records.push(recording(directory, file, problem)?);
        }
    }
    let entrants = entrants();
    let default = Scene::load("hover")?.config.params.estimator;
    let mut settings = Vec::new();
    for (n, record) in records.iter().enumerate() {
        let calibrated = &record.samples[..];
        let prefiltered = record.prefiltered.as_deref().unwrap_or(calibrated);
        let zero = GyroAtRest::learn(prefiltered);
        let inputs = |input: FilterInput| match input {
            FilterInput::Prefiltered => prefiltered.to_vec(),
            FilterInput::Calibrated => calibrated.to_vec(),
        };
        for (k, &(name, entrant)) in entrants.iter().enumerate() {
            let not_zeroed = inputs(entrant.input());
            let samples = &zero.zero(&not_zeroed)[..];
            let figure = m4::figure(&format!("estimator {name} 9-axis"));
            // Only the first 2,000 samples are timed; the construction of a filter takes hardly any time beside them.
            let few = &samples[..samples.len().min(2000)];
            let fresh = || Filter::new(entrant, samples);
            let mut failed = None;
            let time = shortest_ns(options, || match fresh() {
                Ok(mut filter) => {
                    black_box(few).iter().for_each(|s| filter.step(s));
                    black_box(filter.attitude());
                }
                Err(error) => failed = Some(error),
            });
            if let Some(error) = failed {
                return Err(error);
            }
            let same = |params: EstimatorParams| {
                EstimatorParams { declination_rad: default.declination_rad, ..params } == default
            };
            settings.push(Setting {
                problem: record.problem,
                series: name.into(),
                setting: name.into(),
                error: rmse_deg(entrant, record, samples)?,
                error_unit: "° RMSE",
                host_ns: time.map(|ns| ns / few.len() as f64),
                m4_instructions: figure.map(|figure| figure.instructions),
                flash_bytes: figure.and_then(|figure| figure.flash_bytes),
                also: rmse_deg(entrant, record, &not_zeroed)?
                    .map(|error| ("not_zeroed_deg", error))
                    .into_iter()
                    .collect(),
                default: matches!(entrant, Entrant::Ours(params) if same(params)),
                ..Setting::default()
            });
            progress((n as f64 + (k + 1) as f64 / entrants.len() as f64) / records.len() as f64);
        }
    }
    let mut remarks = vec![
        "More instructions do not always give less error. In free flight the accelerometer shows tilt only through drag. \
         Estimators that rely on it within seconds (both readings of the paper, Mahony with its defaults) are pulled towards \
         level at any cost in instructions. `robust` integrates it in world axes, where the flight's own accelerations cancel."
            .to_owned(),
        "Bytes of flash of Kestrel's own estimators are those of all presets together: a parameter selects the preset."
            .to_owned(),
        "Instructions are those of an update with all three sensors. The simulated magnetometer is sampled in every tenth \
         update, so that a flight takes fewer."
            .to_owned(),
    ];
    if options.recordings.is_none() {
        remarks.insert(
            0,
            "No recordings were given (KESTREL_DATA): these are simulated flights only. Real sensors have errors that the \
             simulation does not model."
                .to_owned(),
        );
    }
    Ok(Study {
        name: "estimator",
        title: "Estimators of attitude",
        about: "The error is that of the complete attitude, RMSE over all samples in motion. All estimators get the same \
                samples, from a gyroscope zeroed at rest, as before arming; the second error is that without the zero. Samples of \
                simulated flights pass the scene's prefilter of 30 Hz as in flight, except for `robust` and VQF, which are low-passes \
                themselves. \
                Mahony, Madgwick and VQF are those of the crate uf-ahrs with their default parameters."
            .into(),
        reference: "Recordings: optical motion capture (BROAD). Simulated flights: the simulated truth.".into(),
        per: "an update",
        axis: Axis::M4,
        axis_title: "instructions per update on the Cortex-M4F",
        settings,
        remarks,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// At rest with a heading of 30° and a roll of 20°, every estimator, in its own axes, shows that attitude.
    #[test]
    fn all_estimators_agree_on_a_still_attitude() {
        let yaw = 30.0_f64.to_radians();
        let truth = Quaternion { w: (0.5 * yaw).cos(), v: vec3(0.0, 0.0, (0.5 * yaw).sin()) };
        let roll = 20.0_f64.to_radians();
        let truth = truth * Quaternion { w: (0.5 * roll).cos(), v: vec3((0.5 * roll).sin(), 0.0, 0.0) };
        let body = |v: Vec3<f64>| {
            let Vec3 { x, y, z } = truth.conjugate().rotate(v);
            vec3(x as f32, y as f32, z as f32)
        };
        let sample = Sample {
            gyro: Vec3::ZERO,
            accel: body(vec3(0.0, 0.0, -9.80665)),
            mag: Some(body(vec3(25.0, 0.0, 41.0))),
            dt_s: 0.01,
        };
        let samples = vec![sample; 3000];
        for (name, entrant) in entrants() {
            let mut filter = Filter::new(entrant, &samples).unwrap();
            samples.iter().for_each(|s| filter.step(s));
            let error = AttitudeError::between(filter.attitude(), truth).total_rad.to_degrees();
            assert!(error < 0.05, "{name}: {error}°");
        }
    }

    /// Rotated at a known rate, every estimator follows in the right direction.
    #[test]
    fn all_estimators_follow_a_known_rate() {
        let rate = vec3(0.3, -0.2, 0.4);
        let angle = |t: f64| {
            let half = 0.5 * rate.norm() * t;
            Quaternion { w: half.cos(), v: rate * (half.sin() / rate.norm()) }
        };
        let narrow = |Vec3 { x, y, z }: Vec3<f64>| vec3(x as f32, y as f32, z as f32);
        let samples: Vec<Sample> = (0..500)
            .map(|k| {
                let to_body = angle(f64::from(k) * 0.01).conjugate();
                Sample {
                    gyro: narrow(rate),
                    accel: narrow(to_body.rotate(vec3(0.0, 0.0, -9.80665))),
                    mag: Some(narrow(to_body.rotate(vec3(25.0, 0.0, 41.0)))),
                    dt_s: if k == 0 { 0.0 } else { 0.01 },
                }
            })
            .collect();
        for (name, entrant) in entrants() {
            let mut filter = Filter::new(entrant, &samples).unwrap();
            samples.iter().for_each(|s| filter.step(s));
            let error = AttitudeError::between(filter.attitude(), angle(4.99)).total_rad.to_degrees();
            assert!(error < 2.0, "{name}: {error}°");
        }
    }
}
