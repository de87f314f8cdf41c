//! Figures 10 to 15: a real sensor at rest, beside a simulation with the noise identified from it.

use std::path::{Path, PathBuf};

use flight_core::geometry::Vec3;

use super::bench;
use super::spectrum::density;
use super::{Exhibit, numbers, tabulated};
use allan::{Coefficient, Point};
use input::InputError;
use maud::html;
use sim_host::chart::{Chart, Line, Panel, Stroke, colour};
use sim_host::identify::plot;
use sim_host::log::{AccelSign, Axes, Frame, Log, LogRow};

/// Length of the segment at rest, s.
const REST_S: f64 = 20.0;
const DEG: f64 = std::f64::consts::PI / 180.0;

/// Returns the figures from the first recording in the directory, or in `broad` below it, that starts at rest.
pub fn all(directory: &Path) -> Result<Vec<Exhibit>, InputError> {
    let (name, rate_hz, axes) = recording_at_rest(directory)?;
    let mut list = Vec::new();
    for (i, samples) in axes.into_iter().enumerate() {
        list.push(exhibit(&name, 10 + i, samples, rate_hz)?);
    }
    Ok(list)
}

fn recording_at_rest(directory: &Path) -> Result<(String, f64, [Vec<f64>; 6]), InputError> {
    let below = directory.join("broad");
    let place = if below.is_dir() { below } else { directory.to_path_buf() };
    let cannot_read =
        |error: std::io::Error| InputError::new(format!("cannot be read: {error}")).file(&place);
    let mut files: Vec<PathBuf> = std::fs::read_dir(&place)
        .map_err(cannot_read)?
        .filter_map(|entry| entry.ok().map(|entry| entry.path()))
        .filter(|path| path.extension().is_some_and(|extension| extension == "csv"))
        .collect();
    files.sort();
    for path in &files {
        let log = Log::read(path, Axes { frame: Frame::Enu, accel_sign: AccelSign::Reaction })?;
        let Some(interval_s) = log.mean_interval_s() else { continue };
        let still = log.rows.iter().take_while(|row| !row.moving).count();
        if still as f64 * interval_s < REST_S {
            continue;
        }
        let rows = quietest(&log.rows[..still], interval_s);
        let axis = |i: usize| {
            let gyro = |k: usize| rows.iter().map(|row| row.gyro_rad_s[k] / DEG).collect();
            let accel = |k: usize| rows.iter().map(|row| row.accel_m_s2[k]).collect();
            if i < 3 { gyro(i) } else { accel(i - 3) }
        };
        let name = path.file_stem().map_or(String::new(), |name| name.to_string_lossy().into_owned());
        return Ok((name, 1.0 / interval_s, std::array::from_fn(axis)));
    }
    Err(InputError::new(format!("no recording in it begins with {REST_S} s of rest")).file(&place))
}

/// Returns the segment of length [`REST_S`] in which the gyroscope moves least. In other segments someone touches the
/// table, or begins the motion early.
fn quietest(rows: &[LogRow], interval_s: f64) -> &[LogRow] {
    let (length, stride) = ((REST_S / interval_s) as usize, (1.0 / interval_s) as usize);
    let unrest = |from: usize| {
        let axis = |k: usize| {
            let samples: Vec<f64> = rows[from..from + length].iter().map(|row| row.gyro_rad_s[k]).collect();
            mean_and_deviation(&samples).1
        };
        axis(0) + axis(1) + axis(2)
    };
    let starts = (0..=rows.len().saturating_sub(length)).step_by(stride.max(1));
    let from = starts.min_by(|&a, &b| unrest(a).total_cmp(&unrest(b))).unwrap_or(0);
    &rows[from..(from + length).min(rows.len())]
}

fn mean_and_deviation(samples: &[f64]) -> (f64, f64) {
    let n = samples.len() as f64;
    let mean = samples.iter().sum::<f64>() / n;
    (mean, libm::sqrt(samples.iter().map(|y| (y - mean) * (y - mean)).sum::<f64>() / n))
}

fn exhibit(name: &str, number: usize, measured: Vec<f64>, rate_hz: f64) -> Result<Exhibit, InputError> {
    let axis = ["x", "y", "z"][(number - 10) % 3];
    let is_gyro = number < 13;
    let (sensor, unit) = if is_gyro { ("gyroscope", "°/s") } else { ("accelerometer", "m/s²") };
    let (mean, _) = mean_and_deviation(&measured);
    let (points, fit) = bench::analysed(measured.clone(), rate_hz, None);
    let n = Coefficient::WhiteNoise;
    let Some(identified) = fit.found[n as usize].value() else {
        return Err(InputError::new(format!(
            "the rest of {name} shows no white noise on the {axis} axis of its {sensor}"
        )));
    };
    // The identified model: N, with the mean as the true input.
    let per = if is_gyro {
        (60.0, "gyro", "n_deg_per_sqrt_h", "deg_s")
    } else {
        (1.0, "accel", "n_m_s2_per_sqrt_hz", "m_s2")
    };
    let figure = identified * per.0;
    let effects =
        format!("[effects.{}.white_noise]\n{} = [{figure:?}, {figure:?}, {figure:?}]\n", per.1, per.2);
    let scene = bench::scene(measured.len() as f64 / rate_hz, number as u64, &effects)?;
    let to_si = if is_gyro { DEG } else { 1.0 };
    let truth = Vec3 { x: mean * to_si, y: 0.0, z: 0.0 };
    let mut simulated_sensor =
        if is_gyro { scene.gyro(scene.seed, rate_hz) } else { scene.accel(scene.seed, rate_hz) };
    let [simulated, ..] = bench::readings(&scene, &mut simulated_sensor, truth, rate_hz, true);
    let simulated: Vec<f64> = simulated.into_iter().map(|y| y / to_si).collect();

    let both = [("measured", &measured), ("simulated", &simulated)];
    let strokes = [Stroke::solid(colour::ORANGE, 1.2), Stroke::solid(colour::BLUE, 1.2)];
    let seconds = measured.len() as f64 / rate_hz;
    let along = |samples: &[f64]| samples.iter().enumerate().map(|(k, y)| (k as f64 / rate_hz, *y)).collect();
    // The same vertical axis for both.
    let covers = both
        .iter()
        .flat_map(|(_, s)| s.iter().copied())
        .fold([mean, mean], |[a, b], y| [a.min(y), b.max(y)])
        .to_vec();
    let series = both.iter().zip(strokes).map(|((label, samples), stroke)| {
        let lines = vec![Line::new("", stroke, along(samples))];
        let unit = if is_gyro { "°/s" } else { "m/s²" };
        Panel {
            includes: covers.clone(),
            ..Panel::new(format!("{sensor} {axis}, {label}"), unit, 90.0, lines)
        }
    });
    let description = format!("{sensor} {axis} at rest, measured and simulated");
    let series = Chart::over_time(920.0, description, (0.0, seconds), series.collect());
    let (simulated_points, _) = bench::analysed(simulated.clone(), rate_hz, None);
    let spectra = [density(&measured, rate_hz), density(&simulated, rate_hz)];
    let curve = |label: &str, stroke: Stroke, points: Vec<(f64, f64)>, dots: bool| Line {
        dots,
        ..Line::new(label, stroke, points)
    };
    let deviation = |points: &[Point]| points.iter().map(|p| (p.tau_s, p.deviation)).collect::<Vec<_>>();
    let root = |density: &[(f64, f64)]| density.iter().map(|&(f, d)| (f, libm::sqrt(d))).collect::<Vec<_>>();
    let of = |pair: [Vec<(f64, f64)>; 2], dots: bool| {
        let [measured, simulated] = pair;
        vec![curve("measured", strokes[0], measured, dots), curve("simulated", strokes[1], simulated, dots)]
    };
    // Two charts with one panel each, because their horizontal axes have different quantities.
    let log_chart = |x_title: &'static str, title: &str, unit: String, lines: Vec<Line>| {
        let description = format!("{title} of {sensor} {axis}, measured and simulated");
        Chart::logarithmic(455.0, description, x_title, vec![Panel::new(title, unit, 220.0, lines)])
    };
    let spectrum = log_chart(
        "frequency, Hz",
        "Root density",
        format!("{unit}/√Hz"),
        of(spectra.each_ref().map(|s| root(s)), false),
    );
    let allan = log_chart(
        "averaging time τ, s",
        "Allan deviation",
        unit.into(),
        of([deviation(&points), deviation(&simulated_points)], true),
    );

    let row = |label: &str, samples: &[f64], points: &[Point]| {
        let (mean, deviation) = mean_and_deviation(samples);
        let at = |tau_s: f64| {
            points
                .iter()
                .min_by(|a, b| (a.tau_s - tau_s).abs().total_cmp(&(b.tau_s - tau_s).abs()))
                .map_or(f64::NAN, |p| p.deviation)
        };
        vec![
            label.to_owned(),
            format!("{mean:.4}"),
            plot::short(deviation),
            plot::short(at(0.0)),
            plot::short(at(0.1)),
            plot::short(at(1.0)),
        ]
    };
    let header = ["", "mean", "standard deviation", "Allan deviation, one sample", "0.1 s", "1 s"];
    let (table, _) = tabulated(
        &header,
        &[row("measured", &measured, &points), row("simulated", &simulated, &simulated_points)],
    );
    let (deviation_measured, deviation_simulated) =
        (mean_and_deviation(&measured).1, mean_and_deviation(&simulated).1);
    Ok(Exhibit {
        name: format!("figure-{number}"),
        title: format!("Figure {number}: {sensor} {axis} at rest"),
        caption: format!(
            "The paper shows its own recording beside its simulation. Here the recording is the quietest segment of the rest \
             before the trial {name} of BROAD (Laidig, Caruso, Cereatti, Seel 2021, CC BY 4.0), {seconds:.1} s at \
             {rate_hz:.1} Hz, in body axes forward-right-down. The simulation has the N identified from it ({}) and a common \
             converter. Where the measured curves fall off at high frequency and short τ, the real sensor has a filter that \
             the model does not have.",
            plot::describe(n, &fit.found[n as usize], unit)
        ),
        html: html! {
            (table)
            (series)
            div.pair { (spectrum) (allan) }
        },
        csv: numbers(
            "time_s,measured,simulated",
            measured.iter().zip(&simulated).enumerate().map(|(k, (a, b))| vec![k as f64 / rate_hz, *a, *b]),
        ),
        further: vec![
            (
                "-spectrum",
                numbers(
                    &format!(
                        "frequency_hz,measured_{per}_per_sqrt_hz,simulated_{per}_per_sqrt_hz",
                        per = per.3
                    ),
                    spectra[0]
                        .iter()
                        .zip(&spectra[1])
                        .map(|(a, b)| vec![a.0, libm::sqrt(a.1), libm::sqrt(b.1)]),
                ),
            ),
            (
                "-allan",
                numbers(
                    "tau_s,measured,measured_lower_68,measured_upper_68,simulated",
                    points
                        .iter()
                        .zip(&simulated_points)
                        .map(|(a, b)| vec![a.tau_s, a.deviation, a.lower, a.upper, b.deviation]),
                ),
            ),
        ],
        in_short: format!(
            "standard deviation {} measured, {} simulated ({unit})",
            plot::short(deviation_measured),
            plot::short(deviation_simulated)
        ),
    })
}
