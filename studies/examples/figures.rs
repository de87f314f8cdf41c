//! Makes the figures of the documentation again, from flights:
//!
//! ```text
//! cargo run --release -p studies --example figures [DIRECTORY]
//! ```
//!
//! They are written to `docs/img`, or to the given directory. The same program writes the same bytes. The comparison of
//! estimators needs recordings (environment variable `KESTREL_DATA`); without them its file is not changed.

use std::error::Error;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use sim_host::chart::{Chart, Line, Mark, Panel, Stroke, colour};
use sim_host::flight::{Flight, Outcome};
use sim_host::output_file::OutputFile;
use sim_host::report::figures::{ESTIMATE, TARGET, TRUTH, line, marks};
use sim_host::report::{Channel, Recorder};
use sim_host::scene::{BUILT_IN, Scene};
use studies::cost::{self, Axis, Options};

/// Width of a chart, px; it fits a README.
const WIDTH: f64 = 900.0;

fn main() -> Result<(), Box<dyn Error>> {
    let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/img");
    let directory = std::env::args_os().nth(1).map_or(docs, PathBuf::from);
    std::fs::create_dir_all(&directory)?;
    let directory = directory.canonicalize()?;
    for (name, chart) in [("hover", hover()?), ("paper-cannot-fly", paper_cannot_fly()?)] {
        let path = directory.join(name).with_extension("svg");
        let mut file = OutputFile::create(&path)?;
        file.write_all(chart.to_svg_file().as_bytes())?;
        file.finish()?;
        println!("{}", path.display());
    }
    for (name, chart) in costs()? {
        let path = directory.join(name).with_extension("svg");
        let mut file = OutputFile::create(&path)?;
        file.write_all(chart.to_svg_file().as_bytes())?;
        file.finish()?;
        println!("{}", path.display());
    }
    Ok(())
}

/// Returns the plots of `docs/accuracy.md`, against costs that are the same on every machine.
fn costs() -> Result<Vec<(&'static str, Chart)>, Box<dyn Error>> {
    let recordings = std::env::var_os("KESTREL_DATA").map(PathBuf::from);
    let options = Options { quick: false, timed: false, recordings };
    let mut pictures = vec![
        (
            "cost-integrator",
            "integrator",
            (Axis::Also("evaluations"), "evaluations of the accelerations per simulated second"),
            Some("flight of the scene steps"),
            (
                "Integrating the vehicle's motion",
                "Worst error of the attitude over 16 s of a flight, step by step",
            ),
        ),
        (
            "cost-prefilter",
            "prefilter",
            (Axis::Also("group_delay_ms"), "group delay at low frequency, ms"),
            Some("vibration of the blades, 72 Hz"),
            (
                "The prefilter of the sensors",
                "What is left of a vibration, against the delay of the motion itself",
            ),
        ),
    ];
    if options.recordings.is_some() {
        pictures.push((
            "cost-estimator",
            "estimator",
            (Axis::M4, "instructions per update on the Cortex-M4F"),
            None,
            (
                "Estimators of attitude",
                "Error of the whole attitude in simulated flights and over real recordings",
            ),
        ));
    } else {
        println!("no recordings (KESTREL_DATA): cost-estimator.svg is not changed");
    }
    let mut charts = Vec::new();
    for (file, study, axis, problem, (title, note)) in pictures {
        let studies = cost::run(&[study.into()], &options, &|_, _| ())?;
        let mut chart = cost::plot(&studies[0], axis, |one| problem.is_none_or(|wanted| wanted == one));
        chart.heading = Some((title.into(), note.into()));
        charts.push((file, chart));
    }
    Ok(charts)
}

fn fly(scene: &Scene) -> (Outcome, Recorder) {
    let mut recorder = Recorder::new();
    let outcome = Flight::new(scene, scene.seed).run(&mut recorder);
    (outcome, recorder)
}

/// Returns the README's figure: take-off, hover and landing, in three panels.
fn hover() -> Result<Chart, Box<dyn Error>> {
    let scene = Scene::load("hover")?;
    let (outcome, recorder) = fly(&scene);
    let height = vec![
        line(&recorder, Channel::Height, "truth", TRUTH),
        line(&recorder, Channel::HeightTarget, "pilot's target", TARGET),
    ];
    let error = vec![
        line(&recorder, Channel::HeadingError, "heading", Stroke::solid(colour::BLUE, 1.4)),
        line(&recorder, Channel::InclinationError, "inclination", Stroke::solid(colour::VERMILLION, 1.4)),
    ];
    // Each line is narrower than the one below it, because in a hover the four are nearly equal.
    let strokes = [(colour::SKY, 5.8), (colour::ORANGE, 4.0), (colour::BLUE, 2.2), (colour::BLACK, 0.8)];
    let motors = strokes.into_iter().enumerate().map(|(k, (colour, width))| {
        line(&recorder, Channel::Pulse(k), &format!("rotor {}", k + 1), Stroke::solid(colour, width))
    });
    Ok(Chart {
        heading: Some((
            "A flight: take off, hold 2 m, land".into(),
            format!(
                "1 kHz control on simulated sensor counts · estimate within {:.2}° RMS of the true attitude · \
                 vehicle within {:.2} m of the pilot's target",
                outcome.attitude_rmse_deg, outcome.position_error_max_m
            ),
        )),
        marks: marks(&outcome, &recorder),
        ..Chart::over_time(
            WIDTH,
            "Height, error of the estimated attitude and ESC pulses during the hover scene",
            (0.0, scene.duration_s),
            vec![
                Panel::new("Height", "m", 90.0, height),
                Panel { includes: vec![0.0, 1.0], ..Panel::new("Attitude error", "°", 42.0, error) },
                Panel {
                    includes: vec![1000.0, 2000.0],
                    ..Panel::new("ESC pulses", "µs", 54.0, motors.collect())
                },
            ],
        )
    })
}

/// Returns the figure that shows why a filter for the bench cannot fly: true and estimated tilt in the scene `steps`,
/// with the estimator `flight` and with `paper`.
fn paper_cannot_fly() -> Result<Chart, Box<dyn Error>> {
    let steps = BUILT_IN.iter().find(|scene| scene.name == "steps").ok_or("no scene named steps")?;
    let flown = |estimator: &str| {
        let text = steps.text.replace("[flight]\n", &format!("[flight]\nestimator = \"{estimator}\"\n"));
        Scene::parse(steps.name, &text).map(|scene| fly(&scene))
    };
    let (_, good) = flown("flight")?;
    let (outcome, bad) = flown("paper")?;
    let (crash, crash_s) = outcome.crash.ok_or("the vehicle did not crash with the estimator paper")?;
    let strip = |title: &str, recorder: &Recorder, [truth, estimate]: [&str; 2]| {
        let lines: Vec<Line> = vec![
            line(recorder, Channel::TiltTruth, truth, TRUTH),
            line(recorder, Channel::TiltEstimate, estimate, ESTIMATE),
        ];
        Panel { includes: vec![0.0, 90.0], ..Panel::new(title, "°", 116.0, lines) }
    };
    let mark = |time_s: f64, label: &str, colour| Mark { time_s, label: label.into(), colour };
    Ok(Chart {
        heading: Some((
            "In free flight the accelerometer hardly shows tilt".into(),
            format!(
                "30° doublets. A filter that leans on it loses the tilt within half a second, and the vehicle \
                 swings until it crashes: {}.",
                crash.text()
            ),
        )),
        marks: vec![
            mark(14.0, "roll doublet", colour::GREY),
            mark(19.0, "pitch doublet", colour::GREY),
            mark(crash_s, "crash with paper", colour::VERMILLION),
        ],
        ..Chart::over_time(
            WIDTH,
            "True and estimated tilt during doublets of 30°: with the estimator flight they agree; with the estimator \
             paper they part, and the vehicle tips over",
            (13.0, 25.0),
            vec![
                strip("Tilt with the estimator flight, τ = 10 s", &good, ["truth", "estimate"]),
                strip("Tilt with the estimator paper, τ = 0.323 s", &bad, ["", ""]),
            ],
        )
    })
}
