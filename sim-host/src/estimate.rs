//! The command `estimate`: runs the flight code's estimators over a log and compares them with its reference attitude.
//!
//! The estimators get the same input as in flight: f32, time in whole microseconds, the magnetometer only in rows with
//! a new sample. The prefilter is off unless the request has a cutoff. The first sample sets the attitude, and the
//! declination is 0. For the estimator `flight` the gyroscope is zeroed, as before arming: from the start of the log to
//! the first motion. The other estimators use the gyroscope uncorrected, as the paper does.
//!
//! The errors are computed in f64 ([`AttitudeError`]) over the moving rows that have a reference.

use std::collections::BTreeMap;
use std::fmt;
use std::hint::black_box;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use flight_core::STANDARD_GRAVITY;
use flight_core::estimator::{Estimator, EstimatorParams, GyroZero};
use flight_core::geometry::{Quaternion, Vec3};
use flight_core::prefilter::{Biquad, Prefilter};
use serde::Serialize;

use crate::attitude_error::{AttitudeError, AttitudeRmse};
use crate::log::{Axes, Log};
use crate::output_file::{OutputFile, check_outputs};
use input::InputError;

/// Arguments of [`run`].
#[derive(Clone, Debug, Default)]
pub struct Request {
    /// The log.
    pub log: PathBuf,
    /// Conventions of its axes.
    pub axes: Axes,
    /// Names of presets ([`EstimatorParams::PRESETS`]); empty means all of them.
    pub estimators: Vec<String>,
    /// Cutoff of the Butterworth prefilter on every axis of every sensor, Hz; `None` for no prefilter.
    pub prefilter_hz: Option<f64>,
    /// File for the estimated attitude and its error of each row.
    pub out: Option<PathBuf>,
}

/// Result of [`run`], and the JSON object of `estimate --json`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Report {
    /// The score of each estimator, by its name.
    pub estimators: BTreeMap<&'static str, Score>,
    /// What makes the errors doubtful.
    pub warnings: Vec<String>,
    /// Rows of the log.
    #[serde(skip)]
    pub rows: usize,
    /// Number of rows that count in the errors: those with motion and with a reference.
    #[serde(skip)]
    pub scored_rows: u64,
}

/// Errors and time of one estimator. The errors are `None` (JSON: null) if no row counts.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Score {
    /// RMSE of the attitude, degrees.
    pub total_rmse_deg: Option<f64>,
    /// RMSE of the heading (rotation about the vertical), degrees.
    pub heading_rmse_deg: Option<f64>,
    /// RMSE of the inclination (rotation about a horizontal axis), degrees.
    pub inclination_rmse_deg: Option<f64>,
    /// Time of one update on this machine, ns: the shortest of several passes over the log.
    pub ns_per_update: f64,
}

/// Runs the estimators over the log.
///
/// # Errors
/// An estimator is unknown, the cutoff is not below half the rate of every sensor, the log has an error, or the output
/// cannot be written.
pub fn run(request: &Request) -> Result<Report, InputError> {
    let presets = presets(&request.estimators)?;
    check_outputs(&[&request.log], &[("--out", request.out.as_deref())])?;
    let log = Log::read(&request.log, request.axes)?;
    let samples = samples(&log, request)?;
    let still = GyroAtRest::learn(&samples);

    let warnings = gravity_warning(&log).into_iter().collect();
    let mut report = Report { estimators: BTreeMap::new(), warnings, rows: log.rows.len(), scored_rows: 0 };
    let mut columns = Vec::new();
    for (name, params) in presets {
        let zeroed = (params == EstimatorParams::FLIGHT).then(|| still.zero(&samples));
        let samples = zeroed.as_deref().unwrap_or(&samples);
        let attitudes = attitudes(&params, samples)?;
        let errors = errors(&log, &attitudes);
        let mut rmse = AttitudeRmse::default();
        for (error, row) in errors.iter().zip(&log.rows) {
            if let (Some(error), true) = (error, row.moving) {
                rmse.add(*error);
            }
        }
        report.scored_rows = rmse.count();
        let root = rmse.root();
        let degrees = |part: fn(AttitudeError) -> f64| root.map(|error| part(error).to_degrees());
        report.estimators.insert(
            name,
            Score {
                total_rmse_deg: degrees(|error| error.total_rad),
                heading_rmse_deg: degrees(|error| error.heading_rad),
                inclination_rmse_deg: degrees(|error| error.inclination_rad),
                ns_per_update: ns_per_update(&params, samples)?,
            },
        );
        columns.push(Column { name, attitudes, errors });
    }
    if let Some(out) = &request.out {
        write_attitudes(out, &log, &columns)?;
    }
    Ok(report)
}

/// Returns a warning for a log whose specific force does not contain gravity, as phones deliver it. Half of the samples of a
/// vehicle that flies for long have at least about 1 g: its mean acceleration is small.
fn gravity_warning(log: &Log) -> Option<String> {
    let mut sizes: Vec<f64> = log.rows.iter().map(|row| Vec3::from(row.accel_m_s2).norm()).collect();
    sizes.sort_by(f64::total_cmp);
    let median = *sizes.get(sizes.len() / 2)?;
    (median < 0.5 * f64::from(STANDARD_GRAVITY)).then(|| {
        format!(
            "the accelerometer reads {median:.2} m/s² in the median: gravity seems to have been removed from it, so that no \
             estimator can find the tilt"
        )
    })
}

/// Returns the presets with these names, or all for no names.
fn presets(names: &[String]) -> Result<Vec<(&'static str, EstimatorParams)>, InputError> {
    let all = EstimatorParams::PRESETS;
    if names.is_empty() {
        return Ok(all.to_vec());
    }
    let mut chosen = Vec::new();
    for name in names {
        let preset = all.iter().find(|(preset, _)| preset == name).ok_or_else(|| {
            let known = all.map(|(name, _)| name).join(", ");
            InputError::new(format!("must be one of {known}")).field("--estimator").value(name)
        })?;
        if !chosen.contains(preset) {
            chosen.push(*preset);
        }
    }
    Ok(chosen)
}

/// One row as input of the flight code: body axes, prefiltered.
#[derive(Clone, Copy, Debug)]
pub struct Sample {
    /// Angular rates, rad/s.
    pub gyro: Vec3<f32>,
    /// Specific force, m/s².
    pub accel: Vec3<f32>,
    /// Magnetic field, µT; `None` in rows without a sample.
    pub mag: Option<Vec3<f32>>,
    /// Time since the previous sample, s.
    pub dt_s: f32,
}

/// Converts the rows of a log into the input of the flight code.
///
/// # Errors
/// The rate of the log does not allow the cutoff of the prefilter.
pub fn samples(log: &Log, request: &Request) -> Result<Vec<Sample>, InputError> {
    let mag_rows = log.rows.iter().filter(|row| row.mag_ut.is_some());
    let mut gyro_filter = prefilter(request, "gyroscope", log.rows.iter().map(|row| row.time_s))?;
    let mut accel_filter = prefilter(request, "accelerometer", log.rows.iter().map(|row| row.time_s))?;
    let mut mag_filter = prefilter(request, "magnetometer", mag_rows.map(|row| row.time_s))?;
    let mut last_us = log.rows.first().map_or(0, |row| row.time_us());
    let single = |v: [f64; 3]| Vec3::from(v.map(|x| x as f32));
    Ok(log
        .rows
        .iter()
        .map(|row| {
            let dt_us = row.time_us() - last_us;
            last_us = row.time_us();
            Sample {
                gyro: gyro_filter.step(single(row.gyro_rad_s)),
                accel: accel_filter.step(single(row.accel_m_s2)),
                mag: row.mag_ut.map(|field| mag_filter.step(single(field))),
                dt_s: dt_us as f32 * 1e-6,
            }
        })
        .collect())
}

/// Returns the prefilter for a sensor that was sampled at these times, s.
fn prefilter(
    request: &Request,
    sensor: &str,
    times: impl Iterator<Item = f64> + Clone,
) -> Result<Prefilter, InputError> {
    let Some(cutoff_hz) = request.prefilter_hz else { return Ok(Prefilter::new(None)) };
    let intervals = times.clone().count().saturating_sub(1);
    let (Some(first), Some(last)) = (times.clone().next(), times.last()) else {
        // The log has no samples of this sensor.
        return Ok(Prefilter::new(None));
    };
    let refused = |allowed: String| InputError::new(allowed).field("--prefilter-hz").value(cutoff_hz);
    if intervals == 0 {
        return Err(refused(format!("needs two samples of the {sensor} in {}", request.log.display())));
    }
    let rate_hz = intervals as f64 / (last - first);
    let section = Biquad::butterworth(cutoff_hz as f32, rate_hz as f32).map_err(|error| {
        refused(format!(
            "must be above {} Hz and below {} Hz, just below half the rate of the {sensor}",
            error.minimum, error.maximum
        ))
    })?;
    Ok(Prefilter::new(Some(section)))
}

/// Gyroscope bias that was learned at rest, before the first motion.
pub struct GyroAtRest {
    /// Estimated bias after each sample up to the first motion, rad/s.
    biases: Vec<Vec3<f32>>,
}

impl GyroAtRest {
    /// Learns the bias from the samples up to the first motion.
    pub fn learn(samples: &[Sample]) -> Self {
        let mut zero = GyroZero::default();
        let mut biases = Vec::new();
        for sample in samples {
            zero.learn(sample.gyro, sample.accel, sample.dt_s);
            if zero.zeroed() && !zero.still() {
                // In motion nothing is learned: a slow steady turn would look like a bias.
                break;
            }
            biases.push(zero.bias());
        }
        Self { biases }
    }

    /// Returns the samples with the bias subtracted that was known at each.
    pub fn zero(&self, samples: &[Sample]) -> Vec<Sample> {
        let last = self.biases.last().copied().unwrap_or(Vec3::ZERO);
        let biases = self.biases.iter().copied().chain(std::iter::repeat(last));
        samples.iter().zip(biases).map(|(s, bias)| Sample { gyro: s.gyro - bias, ..*s }).collect()
    }
}

fn estimator(params: &EstimatorParams) -> Result<Estimator, InputError> {
    Estimator::new(params).map_err(|error| InputError::new(error.to_string()))
}

/// Returns the attitude after each sample.
fn attitudes(params: &EstimatorParams, samples: &[Sample]) -> Result<Vec<Quaternion<f32>>, InputError> {
    let mut estimator = estimator(params)?;
    Ok(samples
        .iter()
        .map(|s| {
            estimator.update(s.gyro, s.accel, s.mag, s.dt_s);
            estimator.attitude()
        })
        .collect())
}

/// Returns the error of each row; `None` in rows without a reference.
fn errors(log: &Log, attitudes: &[Quaternion<f32>]) -> Vec<Option<AttitudeError>> {
    let double = |[w, x, y, z]: [f32; 4]| Quaternion::new(w.into(), x.into(), y.into(), z.into());
    log.rows
        .iter()
        .zip(attitudes)
        .map(|(row, attitude)| {
            let [w, x, y, z] = row.reference?;
            Some(AttitudeError::between(double(attitude.to_array()), Quaternion::new(w, x, y, z)))
        })
        .collect()
}

/// Measures the time of one update, ns. Makes at least three passes over the log and for at least 50 ms, and takes the
/// shortest pass: other work of the machine only makes a pass longer.
fn ns_per_update(params: &EstimatorParams, samples: &[Sample]) -> Result<f64, InputError> {
    let fresh = estimator(params)?;
    let (mut shortest, mut spent, mut passes) = (Duration::MAX, Duration::ZERO, 0);
    while passes < 3 || spent < Duration::from_millis(50) {
        let mut estimator = fresh;
        let start = Instant::now();
        for s in black_box(samples) {
            estimator.update(s.gyro, s.accel, s.mag, s.dt_s);
        }
        black_box(estimator.attitude());
        let took = start.elapsed();
        shortest = shortest.min(took);
        spent += took;
        passes += 1;
    }
    Ok(shortest.as_secs_f64() * 1e9 / samples.len() as f64)
}

/// Attitudes and errors of one estimator, for the output file.
struct Column {
    name: &'static str,
    attitudes: Vec<Quaternion<f32>>,
    errors: Vec<Option<AttitudeError>>,
}

/// Writes the time and, for each estimator, the attitude (body to world, north-east-down) and the three errors in
/// degrees. The errors are empty in rows without a reference.
fn write_attitudes(path: &Path, log: &Log, columns: &[Column]) -> Result<(), InputError> {
    let mut file = OutputFile::create(path)?;
    let written = (|| {
        write!(file, "time_s")?;
        for Column { name, .. } in columns {
            for part in ["qw", "qx", "qy", "qz", "total_deg", "heading_deg", "inclination_deg"] {
                write!(file, ",{name}_{part}")?;
            }
        }
        writeln!(file)?;
        for (i, row) in log.rows.iter().enumerate() {
            write!(file, "{}", row.time_s)?;
            for column in columns {
                for part in column.attitudes[i].to_array() {
                    write!(file, ",{part}")?;
                }
                match column.errors[i] {
                    Some(error) => {
                        for part in [error.total_rad, error.heading_rad, error.inclination_rad] {
                            write!(file, ",{}", part.to_degrees())?;
                        }
                    }
                    None => write!(file, ",,,")?,
                }
            }
            writeln!(file)?;
        }
        Ok(())
    })();
    written.map_err(|error| file.error(&error))?;
    file.finish()
}

/// Formats the errors and times as a table.
impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "RMSE over {} of {} rows, degrees", self.scored_rows, self.rows)?;
        write!(
            f,
            "{:<14}{:>8}{:>10}{:>13}{:>12}",
            "estimator", "total", "heading", "inclination", "ns/update"
        )?;
        let cell = |value: Option<f64>| value.map_or("–".to_owned(), |degrees| format!("{degrees:.2}"));
        for (name, score) in &self.estimators {
            write!(
                f,
                "\n{name:<14}{:>8}{:>10}{:>13}{:>12.0}",
                cell(score.total_rmse_deg),
                cell(score.heading_rmse_deg),
                cell(score.inclination_rmse_deg),
                score.ns_per_update
            )?;
        }
        for warning in &self.warnings {
            write!(f, "\nwarning: {warning}")?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::log::{LogRow, LogWriter};

    /// Gyroscope bias about x in the log of these tests, rad/s.
    const BIAS: f64 = 0.01;

    /// Returns a log of a level vehicle that faces east and turns right at 10°/s from 4 s to 13 s.
    fn rows(rate_hz: i32, seconds: i32) -> Vec<LogRow> {
        let field_north_down = [20.0, 40.0];
        (0..rate_hz * seconds)
            .map(|k| {
                let time_s = f64::from(k) / f64::from(rate_hz);
                let rate = if (4.0..13.0).contains(&time_s) { 10.0_f64.to_radians() } else { 0.0 };
                let yaw = 90.0_f64.to_radians() + 10.0_f64.to_radians() * (time_s - 4.0).clamp(0.0, 9.0);
                let [north, down] = field_north_down;
                LogRow {
                    time_s,
                    gyro_rad_s: [BIAS, 0.0, rate],
                    accel_m_s2: [0.0, 0.0, -9.806_65],
                    // The magnetometer has a value in every fifth row only, because magnetometers are slower.
                    mag_ut: (k % 5 == 0).then(|| [north * libm::cos(yaw), -north * libm::sin(yaw), down]),
                    reference: Some([libm::cos(0.5 * yaw), 0.0, 0.0, libm::sin(0.5 * yaw)]),
                    moving: time_s >= 4.0,
                }
            })
            .collect()
    }

    fn written(rows: &[LogRow]) -> (tempfile::TempDir, Request) {
        let directory = tempfile::tempdir().unwrap();
        let log = directory.path().join("log.csv");
        let mut writer = LogWriter::create(&log).unwrap();
        for row in rows {
            writer.write(row).unwrap();
        }
        writer.finish().unwrap();
        (directory, Request { log, ..Request::default() })
    }

    #[test]
    fn clean_turn_is_tracked_and_only_flight_removes_the_bias() {
        let (_directory, request) = written(&rows(200, 20));
        let report = run(&request).unwrap();
        assert_eq!((report.rows, report.scored_rows), (4000, 3200));
        let mut presets = EstimatorParams::PRESETS.map(|(name, _)| name);
        presets.sort_unstable();
        assert_eq!(report.estimators.keys().copied().collect::<Vec<_>>(), presets);
        for (name, bound) in [("flight", 0.05), ("paper", 0.4), ("paper-literal", 0.2)] {
            let score = report.estimators[name];
            assert!(score.total_rmse_deg.unwrap() < bound, "{name}: {score:?}");
            assert!(score.ns_per_update > 0.0 && score.ns_per_update < 1e6, "{name}: {score:?}");
        }
        // In eq 18 a bias b causes an error τ b, with τ = 0.3233 s.
        let inclination = report.estimators["paper"].inclination_rmse_deg.unwrap();
        let expected = (0.3233 * BIAS).to_degrees();
        assert!((inclination / expected - 1.0).abs() < 0.02, "{inclination} against {expected}");
    }

    /// Without gravity `robust` starts level after a second, and integrates the gyroscope.
    #[test]
    fn log_without_gravity_is_integrated_with_a_warning() {
        let mut rows = rows(200, 20);
        for row in &mut rows {
            row.accel_m_s2 = [0.01, -0.02, 0.03];
            row.gyro_rad_s[0] = 0.0;
        }
        let (_directory, mut request) = written(&rows);
        request.estimators = vec!["robust".into()];
        let report = run(&request).unwrap();
        let [warning] = &report.warnings[..] else { panic!("{:?}", report.warnings) };
        assert!(
            warning.contains("reads 0.04 m/s² in the median: gravity seems to have been removed"),
            "{warning}"
        );
        assert!(report.to_string().ends_with(warning));
        let total = report.estimators["robust"].total_rmse_deg.unwrap();
        assert!(total < 0.1, "{total}");
    }

    #[test]
    fn json_and_table_have_the_documented_form() {
        let report = Report {
            estimators: BTreeMap::from([(
                "paper",
                Score {
                    total_rmse_deg: Some(3.0),
                    heading_rmse_deg: None,
                    inclination_rmse_deg: Some(1.5),
                    ns_per_update: 50.0,
                },
            )]),
            warnings: vec![],
            rows: 2,
            scored_rows: 1,
        };
        assert_eq!(
            serde_json::to_string(&report).unwrap(),
            r#"{"estimators":{"paper":{"total_rmse_deg":3.0,"heading_rmse_deg":null,"inclination_rmse_deg":1.5,"ns_per_update":50.0}},"warnings":[]}"#
        );
        assert_eq!(
            report.to_string(),
            "RMSE over 1 of 2 rows, degrees\n\
             estimator        total   heading  inclination   ns/update\n\
             paper             3.00         –         1.50          50"
        );
    }

    #[test]
    fn log_without_reference_gives_no_rmse() {
        let mut rows = rows(100, 2);
        rows.iter_mut().for_each(|row| row.reference = None);
        let (_directory, request) = written(&rows);
        let report = run(&request).unwrap();
        assert_eq!((report.rows, report.scored_rows), (200, 0));
        assert!(report.estimators.values().all(|score| score.total_rmse_deg.is_none()));
    }

    #[test]
    fn output_has_a_row_for_every_sample() {
        let mut rows = rows(100, 2);
        rows[1].reference = None;
        let (directory, mut request) = written(&rows);
        let out = directory.path().join("out.csv");
        request.estimators = vec!["paper".into(), "flight".into(), "paper".into()];
        request.out = Some(out.clone());
        assert_eq!(run(&request).unwrap().estimators.len(), 2);
        let text = std::fs::read_to_string(&out).unwrap();
        let lines: Vec<_> = text.lines().collect();
        assert_eq!(lines.len(), 201);
        assert_eq!(
            lines[0],
            "time_s,paper_qw,paper_qx,paper_qy,paper_qz,paper_total_deg,paper_heading_deg,paper_inclination_deg,\
             flight_qw,flight_qx,flight_qy,flight_qz,flight_total_deg,flight_heading_deg,flight_inclination_deg"
        );
        assert!(lines[2].starts_with("0.01,0.7071") && lines[2].ends_with(",,,"), "{}", lines[2]);
        assert!(lines.iter().all(|line| line.split(',').count() == 15));
    }

    #[test]
    fn output_does_not_overwrite_the_log() {
        let (_directory, mut request) = written(&rows(100, 1));
        let before = std::fs::read(&request.log).unwrap();
        request.out = Some(request.log.clone());
        let error = run(&request).unwrap_err().to_string();
        assert!(
            error.starts_with("--out = ") && error.ends_with(": must not be a file that is read"),
            "{error}"
        );
        assert_eq!(std::fs::read(&request.log).unwrap(), before);
    }

    #[test]
    fn prefilter_cutoff_is_checked_against_each_sensors_rate() {
        let (_directory, mut request) = written(&rows(200, 2));
        request.prefilter_hz = Some(19.0);
        assert!(run(&request).is_ok());
        for (cutoff, allowed) in [
            (
                30.0,
                "--prefilter-hz = 30: must be above 0.02 Hz and below 19.98 Hz, just below half the rate of the magnetometer",
            ),
            (
                100.0,
                "--prefilter-hz = 100: must be above 0.1 Hz and below 99.9 Hz, just below half the rate of the gyroscope",
            ),
            (
                -1.0,
                "--prefilter-hz = -1: must be above 0.1 Hz and below 99.9 Hz, just below half the rate of the gyroscope",
            ),
        ] {
            request.prefilter_hz = Some(cutoff);
            assert_eq!(run(&request).unwrap_err().to_string(), allowed);
        }
        let (_directory, mut request) = written(&rows(200, 2)[..1]);
        request.prefilter_hz = Some(30.0);
        let error = run(&request).unwrap_err().to_string();
        assert!(error.starts_with("--prefilter-hz = 30: needs two samples of the gyroscope in "), "{error}");
    }

    #[test]
    fn unknown_estimator_error_lists_the_known_ones() {
        let request = Request { estimators: vec!["kalman".into()], ..Request::default() };
        assert_eq!(
            run(&request).unwrap_err().to_string(),
            "--estimator = kalman: must be one of paper, paper-literal, flight, robust"
        );
    }
}
