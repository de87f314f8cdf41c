//! The command `allan`: identifies the errors of a sensor from a recording at rest.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::time::Instant;

use allan::statistic::estimate_s;
use allan::{Coefficient, Found, Phase, Point, Statistic, Taus};
use clap::ValueEnum;
use input::InputError;
use serde_json::{Map, Value, json};
use sim_host::identify::model::{self, Analysed, Provenance, Role};
use sim_host::identify::plot;
use sim_host::identify::recording::{Column, Layout, Recording};
use sim_host::output_file::{OutputFile, check_outputs, finish_all};

use super::{Answer, number, progress};

/// Longest estimated work without `--force`, s.
const MAX_WORK_S: f64 = 600.0;

#[derive(clap::Args)]
pub struct AllanArguments {
    /// Recording of a sensor at rest: columns of numbers, separated by commas, semicolons or tabs
    log: PathBuf,
    /// Column to analyse, by name or by number from 1; may be repeated. ROLE=COLUMN says what a column is, for
    /// example gyro_x_deg_s=wx [default: the sensor columns of a log, or the only column]
    #[arg(long, value_name = "C", num_args = 1)]
    column: Vec<String>,
    /// Rows per second [default: from the times in the column time_s]
    #[arg(long, value_name = "R", allow_negative_numbers = true, value_parser = number)]
    rate_hz: Option<f64>,
    /// Averaging times, in samples. octave: 1, 2, 4, 8 ...; decade: 1, 2, 4, 10, 20 ...; log: 20 in each decade; all
    #[arg(long, value_enum, default_value_t = TausName::Octave)]
    taus: TausName,
    /// Deviation to list and plot; the coefficients are always fitted to the overlapping deviation
    #[arg(long, value_enum, default_value_t = StatisticName::Overlapping)]
    statistic: StatisticName,
    /// The columns contain integrals (angles, velocities, phases) of the quantity to analyse
    #[arg(long)]
    phase: bool,
    /// Write a plot of the deviations with their confidence intervals, slopes and coefficients
    #[arg(long, value_name = "F.svg")]
    plot: Option<PathBuf>,
    /// Write an IMU preset, for `imu = "F.toml"` in a scene
    #[arg(long, value_name = "F.toml")]
    imu: Option<PathBuf>,
    /// Write an imu.yaml for Kalibr, VINS or OpenVINS
    #[arg(long, value_name = "F.yaml")]
    kalibr: Option<PathBuf>,
    /// Run even if the estimated time is above 10 minutes
    #[arg(long)]
    force: bool,
    /// Separator of the columns [default: detected]
    #[arg(long, value_enum)]
    separator: Option<SeparatorName>,
    /// Whether the first row is a header [default: detected]
    #[arg(long, value_enum)]
    header: Option<YesNo>,
}

#[derive(Clone, Copy, ValueEnum)]
enum TausName {
    Octave,
    Decade,
    Log,
    All,
}

#[derive(Clone, Copy, ValueEnum)]
enum StatisticName {
    Overlapping,
    Standard,
    Modified,
    Hadamard,
    Total,
}

#[derive(Clone, Copy, ValueEnum)]
enum SeparatorName {
    Comma,
    Semicolon,
    Tab,
}

#[derive(Clone, Copy, ValueEnum)]
enum YesNo {
    Yes,
    No,
}

impl AllanArguments {
    fn layout(&self) -> Layout {
        let separator = self.separator.map(|separator| match separator {
            SeparatorName::Comma => b',',
            SeparatorName::Semicolon => b';',
            SeparatorName::Tab => b'\t',
        });
        Layout { separator, header: self.header.map(|header| matches!(header, YesNo::Yes)) }
    }

    fn taus(&self) -> Taus {
        match self.taus {
            TausName::Octave => Taus::Octave,
            TausName::Decade => Taus::Decade,
            TausName::Log => Taus::Log,
            TausName::All => Taus::All,
        }
    }

    fn statistic(&self) -> Statistic {
        match self.statistic {
            StatisticName::Overlapping => Statistic::Overlapping,
            StatisticName::Standard => Statistic::Standard,
            StatisticName::Modified => Statistic::Modified,
            StatisticName::Hadamard => Statistic::Hadamard,
            StatisticName::Total => Statistic::Total,
        }
    }
}

/// Result of the analysis of one column.
struct Analysis {
    analysed: Analysed,
    points: Vec<Point>,
    unit: String,
}

pub fn run(arguments: &AllanArguments) -> Result<Answer, InputError> {
    let start = Instant::now();
    if let Some(rate_hz) = arguments.rate_hz
        && !(rate_hz > 1e-9 && rate_hz < 1e9)
    {
        return Err(InputError::new("must be above 1e-9 and below 1e9 Hz").field("--rate-hz").value(rate_hz));
    }
    let outputs = [
        ("--plot", arguments.plot.as_deref()),
        ("--imu", arguments.imu.as_deref()),
        ("--kalibr", arguments.kalibr.as_deref()),
    ];
    check_outputs(&[&arguments.log], &outputs)?;
    let recording = Recording::open(&arguments.log, arguments.layout())?;
    let selected = selected(&recording, arguments)?;
    let time = match arguments.rate_hz {
        Some(_) => None,
        None => Some(recording.names().iter().position(|name| name == "time_s").ok_or_else(|| {
            recording.error("is missing: the file has no column time_s").field("--rate-hz")
        })?),
    };
    let temperature =
        recording.names().iter().position(|name| recording.has_header() && is_temperature(name));

    let mut results = Vec::new();
    let mut rate_hz = arguments.rate_hz;
    let mut range = None;
    let at_once = recording.columns_at_once();
    for (pass, columns) in selected.chunks(at_once).enumerate() {
        let bar = progress::bar(recording.bytes(), &format!("read {}", arguments.log.display()));
        // Times and temperature are the same for all columns.
        let first = pass == 0;
        let contents =
            recording.read(columns, time.filter(|_| first), temperature.filter(|_| first), &|bytes| {
                bar.set_position(bytes)
            })?;
        bar.finish_and_clear();
        if let Some(stamps) = contents.stamps {
            rate_hz = Some(1.0 / stamps.interval_s);
        }
        range = range.or(contents.temperature);
        let Some(rate_hz) = rate_hz else {
            return Err(recording.error("is missing").field("--rate-hz"));
        };
        for column in contents.columns {
            results.push(analyse(column, rate_hz, arguments).map_err(|error| error.file(&arguments.log))?);
        }
    }
    let rate_hz = rate_hz.unwrap_or_default();
    let provenance = Provenance {
        file: arguments.log.display().to_string(),
        temperature: range
            .zip(temperature)
            .map(|((low, high), at)| (recording.names()[at].clone(), low, high)),
    };
    write_files(arguments, &results, &provenance)?;
    let wall_s = start.elapsed().as_secs_f64();
    Ok(Answer {
        json: to_json(&results, rate_hz, wall_s, &provenance),
        text: describe(&results, arguments, rate_hz, wall_s),
        failed: false,
    })
}

fn is_temperature(name: &str) -> bool {
    let name = name.to_lowercase();
    name.starts_with("temp")
}

/// Returns the columns to analyse: the index in the file and the name of each.
fn selected(recording: &Recording, arguments: &AllanArguments) -> Result<Vec<(usize, String)>, InputError> {
    let names = recording.names();
    if arguments.column.is_empty() {
        let sensor_columns: Vec<(usize, String)> =
            names.iter().cloned().enumerate().filter(|(_, name)| Role::of(name).is_some()).collect();
        if !sensor_columns.is_empty() {
            return Ok(sensor_columns);
        }
        let data = |name: &&String| *name != "time_s" && !is_temperature(name);
        return match names.iter().filter(data).collect::<Vec<_>>().as_slice() {
            [only] => Ok(vec![(recording.find(only)?, (*only).clone())]),
            _ => Err(recording
                .error(format!("must name a column: the file has {}", names.join(", ")))
                .field("--column")),
        };
    }
    let mut selected: Vec<(usize, String)> = Vec::new();
    for column in &arguments.column {
        let (index, name) = match column.split_once('=') {
            Some((role, from)) if !names.contains(column) => {
                if Role::of(role).is_none() {
                    return Err(InputError::new(
                        "the part before = must be gyro_{x,y,z}_{rad_s,deg_s}, accel_{x,y,z}_{m_s2,g} or \
                         mag_{x,y,z}_ut",
                    )
                    .field("--column")
                    .value(column));
                }
                (recording.find(from)?, role.to_owned())
            }
            _ => {
                let index = recording.find(column)?;
                (index, names[index].clone())
            }
        };
        if selected.iter().any(|(_, other)| *other == name) {
            return Err(InputError::new("names a column a second time").field("--column").value(column));
        }
        selected.push((index, name));
    }
    Ok(selected)
}

fn analyse(column: Column, row_rate_hz: f64, arguments: &AllanArguments) -> Result<Analysis, InputError> {
    let Column { name, samples, rows_per_value, mean, step } = column;
    let rate_hz = row_rate_hz / rows_per_value as f64;
    let unit = Role::of(&name).map_or("unit", |role| role.unit);
    let unit = if arguments.phase { format!("{unit}/s") } else { unit.into() };
    let phase = if arguments.phase {
        Phase::of_angle(samples, 1.0 / rate_hz)
    } else {
        Phase::of_rate(samples, 1.0 / rate_hz)
    };
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let statistic = arguments.statistic();
    let factors = arguments.taus().factors(statistic.largest_factor(phase.samples()));
    let expected_s = estimate_s(statistic, phase.samples(), &factors, threads);
    if expected_s > MAX_WORK_S && !arguments.force {
        return Err(InputError::new(format!(
            "{} averaging times of {} samples would take about {:.0} minutes: --force allows it, --taus log or octave \
             takes less",
            factors.len(),
            phase.samples(),
            expected_s / 60.0
        ))
        .field("--taus"));
    }
    let deviations = |statistic: Statistic, factors: &[usize]| {
        let bar = progress::bar(0, &name);
        let points = allan::deviations(&phase, statistic, factors, threads, &|done, of| {
            bar.set_length(of as u64);
            bar.set_position(done as u64);
        });
        bar.finish_and_clear();
        points
    };
    let points = deviations(statistic, &factors);
    let octaves = Taus::Octave.factors(Statistic::Overlapping.largest_factor(phase.samples()));
    let fit = if statistic == Statistic::Overlapping && factors == octaves {
        allan::fitted(&points, phase.length_s(), step)
    } else {
        allan::fitted(&deviations(Statistic::Overlapping, &octaves), phase.length_s(), step)
    };
    let analysed = Analysed {
        rate_hz,
        samples: phase.samples(),
        mean,
        // The quantization step of an angle says nothing about that of its rate.
        step: step.filter(|_| !arguments.phase),
        rises: phase.rises(),
        fit,
        name,
    };
    Ok(Analysis { analysed, points, unit })
}

fn write_files(
    arguments: &AllanArguments,
    results: &[Analysis],
    provenance: &Provenance,
) -> Result<(), InputError> {
    let columns: Vec<Analysed> = results.iter().map(|r| r.analysed.clone()).collect();
    // All files are completed together, so that an error leaves none behind.
    let mut files: Vec<(&Path, String)> = Vec::new();
    if let Some(path) = &arguments.imu {
        files.push((path, model::preset(&columns, provenance)?));
    }
    if let Some(path) = &arguments.kalibr {
        files.push((path, model::kalibr(&columns, provenance)?));
    }
    if let Some(path) = &arguments.plot {
        let fitted = arguments.statistic() != Statistic::Modified;
        let panels = results
            .iter()
            .map(|r| plot::panel(&r.analysed.name, &r.unit, &r.points, fitted.then_some(&r.analysed.fit)));
        let longest =
            results.iter().map(|r| r.analysed.samples as f64 / r.analysed.rate_hz).fold(0.0, f64::max);
        let heading = (
            deviation_name(arguments.statistic()).to_owned(),
            format!("{}, {longest:.0} s; slopes of the fitted errors dashed", provenance.file),
        );
        files.push((path, plot::chart(heading, panels.collect()).to_svg_file()));
    }
    let write = |(path, text): (&Path, String)| {
        let mut file = OutputFile::create(path)?;
        file.write_text(&text).map(|()| file)
    };
    finish_all(files.into_iter().map(write).collect::<Result<Vec<_>, _>>()?)
}

fn deviation_name(statistic: Statistic) -> &'static str {
    match statistic {
        Statistic::Overlapping => "Overlapping Allan deviation",
        Statistic::Standard => "Standard Allan deviation",
        Statistic::Modified => "Modified Allan deviation",
        Statistic::Hadamard => "Overlapping Hadamard deviation",
        Statistic::Total => "Total Allan deviation",
    }
}

fn to_json(results: &[Analysis], rate_hz: f64, wall_s: f64, provenance: &Provenance) -> Value {
    let mut columns = Map::new();
    for result in results {
        let Analysed { name, rate_hz, samples, mean, step, fit, .. } = &result.analysed;
        let list = |value: fn(&Point) -> Value| result.points.iter().map(value).collect::<Vec<_>>();
        let mut object = json!({
            "unit": result.unit,
            "rate_hz": rate_hz,
            "samples": samples,
            "mean": mean,
            "step": step,
            "tau_s": list(|p| json!(p.tau_s)),
            "deviation": list(|p| json!(p.deviation)),
            "lower": list(|p| json!(p.lower)),
            "upper": list(|p| json!(p.upper)),
            "pairs": list(|p| json!(p.pairs)),
            "edf": list(|p| json!(p.edf)),
            "alpha": list(|p| json!(p.alpha)),
            "fitted_s": fit.range_s.map(|(from, to)| [from, to]),
            "note": fit.note,
        });
        let (mut uncertainty, mut reason, mut at_most) = (Map::new(), Map::new(), Map::new());
        for (coefficient, found) in Coefficient::ALL.into_iter().zip(&fit.found) {
            let name = coefficient.name();
            object[name] = json!(found.value());
            match found {
                Found::Value { uncertainty: u, .. } => uncertainty.insert(name.into(), json!(u)),
                Found::Hidden { reason: r, at_most: max } => {
                    at_most.insert(name.into(), json!(max));
                    reason.insert(name.into(), json!(r))
                }
            };
        }
        object["uncertainty"] = uncertainty.into();
        object["reason"] = reason.into();
        object["at_most"] = at_most.into();
        columns.insert(name.clone(), object);
    }
    let temperature = provenance.temperature.as_ref().map(|(_, low, high)| [low, high]);
    json!({ "rate_hz": rate_hz, "wall_s": wall_s, "temperature": temperature, "columns": columns })
}

fn describe(results: &[Analysis], arguments: &AllanArguments, rate_hz: f64, wall_s: f64) -> String {
    let mut text =
        format!("{}: {rate_hz:.6} rows per second, analysed in {wall_s:.2} s\n", arguments.log.display());
    for Analysis { analysed, points, unit } in results {
        let length_s = analysed.samples as f64 / analysed.rate_hz;
        let _ = write!(
            text,
            "\n{} ({unit}): {} samples, {length_s:.1} s, mean {:.6}\n",
            analysed.name, analysed.samples, analysed.mean
        );
        for (coefficient, found) in Coefficient::ALL.into_iter().zip(&analysed.fit.found) {
            let _ = writeln!(
                text,
                "  {} {:<17} {}",
                coefficient.letter(),
                coefficient.name().replace('_', " "),
                plot::describe(coefficient, found, unit)
            );
        }
        if let Some(note) = &analysed.fit.note {
            let _ = writeln!(text, "  note: {note}");
        }
        // More lines than this are not useful in a terminal; --json and --plot have all τ.
        if points.len() <= 60 {
            let _ = writeln!(
                text,
                "  {:>12} {:>13} {:>13} {:>13} {:>11}",
                "τ, s", "deviation", "lower", "upper", "pairs"
            );
            for p in points {
                let _ = writeln!(
                    text,
                    "  {:>12.6} {:>13.6e} {:>13.6e} {:>13.6e} {:>11}",
                    p.tau_s, p.deviation, p.lower, p.upper, p.pairs
                );
            }
        }
    }
    text
}
