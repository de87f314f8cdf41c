//! The figures of a report: the plots of a recorded flight.

use flight_core::arming::{Cause, Event};

use super::recorder::{Channel, Recorder};
use crate::chart::{Chart, Line, Mark, Panel, RightAxis, Stroke, colour};
use crate::flight::Outcome;
use crate::scene::Scene;

/// Width of a report's charts, px.
const WIDTH: f64 = 920.0;

/// Line of the truth: wide and light, so that the estimate is visible on top of it.
pub const TRUTH: Stroke = Stroke::solid(colour::SKY, 3.5);
/// Line of an estimate.
pub const ESTIMATE: Stroke = Stroke::solid(colour::VERMILLION, 1.3);
/// Line of noisy measurements, below the truth.
const MEASURED: Stroke = Stroke::solid(colour::ORANGE, 2.0);
/// Line of the truth on top of noisy measurements.
const TRUTH_ON_MEASURED: Stroke = Stroke::solid(colour::BLACK, 1.1);
/// Line of a target.
pub const TARGET: Stroke = Stroke::dashed(colour::BLACK, 1.3);

/// A chart with a title and an explanation.
pub(super) struct Figure {
    pub title: &'static str,
    pub caption: String,
    pub chart: Chart,
}

/// Returns all figures for which this flight has data.
pub(super) fn all(scene: &Scene, outcome: &Outcome, recorder: &Recorder) -> Vec<Figure> {
    let mut list = vec![attitude(recorder), estimate_error(recorder), rates(recorder)];
    if scene.pilot.is_some() {
        list.push(motors(scene, recorder));
        if !scene.ball_joint {
            list.push(place(recorder));
        }
    }
    for figure in &mut list {
        figure.chart.x_range = Some((0.0, outcome.flown_s()));
        figure.chart.marks = marks(outcome, recorder);
    }
    list
}

/// Returns the marks of the events of a flight and of its crash.
pub fn marks(outcome: &Outcome, recorder: &Recorder) -> Vec<Mark> {
    let event = |&(time_s, event): &(f64, Event)| {
        let (label, colour) = if event.is_refusal() {
            (format!("arming refused: {}", event.cause.text()), colour::VERMILLION)
        } else {
            let label = event.to.name().to_lowercase();
            match event.cause {
                Cause::Pilot | Cause::Checked => (label, colour::GREEN),
                cause => (format!("{label}: {}", cause.text()), colour::VERMILLION),
            }
        };
        Mark { time_s, label, colour }
    };
    let mut list: Vec<Mark> = recorder.events().iter().map(event).collect();
    if let Some((_, time_s)) = outcome.crash {
        list.push(Mark { time_s, label: "crash".into(), colour: colour::VERMILLION });
    }
    list
}

/// Returns the line of a channel.
pub fn line(recorder: &Recorder, channel: Channel, label: &str, stroke: Stroke) -> Line {
    Line::new(label, stroke, recorder.points(channel))
}

fn chart(description: &str, panels: Vec<Panel>) -> Chart {
    Chart::over_time(WIDTH, description, (0.0, 0.0), panels)
}

fn attitude(recorder: &Recorder) -> Figure {
    let axis = |(k, title): (usize, &str)| {
        // Only the first of the three panels has a legend.
        let label = |text| if k == 0 { text } else { "" };
        let lines = vec![
            line(recorder, Channel::AttitudeTruth(k), label("truth"), TRUTH),
            line(recorder, Channel::AttitudeEstimate(k), label("estimate"), ESTIMATE),
        ];
        Panel { min_span: 1.0, ..Panel::new(title, "°", 110.0, lines) }
    };
    let panels = [(0, "Roll"), (1, "Pitch"), (2, "Yaw")].map(axis);
    Figure {
        title: "Attitude",
        caption:
            "The attitude estimated by the flight code, on top of the true attitude. Positive angles: right side \
                  down, nose up, clockwise from north."
                .into(),
        chart: chart("Roll, pitch and yaw over time: truth and estimate", panels.into()),
    }
}

fn estimate_error(recorder: &Recorder) -> Figure {
    let error = |title: &str, channel, colour| {
        let lines = vec![line(recorder, channel, "", Stroke::solid(colour, 1.4))];
        Panel { includes: vec![0.0], min_span: 0.05, ..Panel::new(title, "°", 90.0, lines) }
    };
    Figure {
        title: "Attitude error",
        caption:
            "The rotation from the true to the estimated attitude, split into a rotation about the vertical \
                  (heading, from the magnetometer) and a rotation about a horizontal axis (inclination, from the \
                  accelerometer)."
                .into(),
        chart: chart(
            "Heading and inclination error of the estimate over time",
            vec![
                error("Heading error", Channel::HeadingError, colour::BLUE),
                error("Inclination error", Channel::InclinationError, colour::VERMILLION),
            ],
        ),
    }
}

fn rates(recorder: &Recorder) -> Figure {
    let axis = |(k, title): (usize, &str)| {
        let label = |text| if k == 0 { text } else { "" };
        let lines = vec![
            line(recorder, Channel::RateFiltered(k), label("filtered"), MEASURED),
            line(recorder, Channel::RateTruth(k), label("truth"), TRUTH_ON_MEASURED),
        ];
        Panel { min_span: 1.0, ..Panel::new(title, "°/s", 100.0, lines) }
    };
    let panels = [(0, "Roll rate"), (1, "Pitch rate"), (2, "Yaw rate")].map(axis);
    Figure {
        title: "Body rates",
        caption:
            "The true body rates, and the input of the rate controller: gyroscope samples after calibration, \
                  prefilter and gyro zero."
                .into(),
        chart: chart("Body rates over time: truth and filtered", panels.into()),
    }
}

fn motors(scene: &Scene, recorder: &Recorder) -> Figure {
    // The plot shows the true speed as the pulse that would hold it, by the ESC's linear map.
    let esc = scene.config.params.esc;
    let (stop_us, full_us) = (f64::from(esc.stop_us), f64::from(esc.full_us));
    let us_per_rad_s = (full_us - stop_us) / scene.vehicle.max_rad_s;
    let rotor = |(k, title): (usize, &str)| {
        let label = |text| if k == 0 { text } else { "" };
        let mut speed =
            line(recorder, Channel::Rotor(k), label("rotor speed"), Stroke::solid(colour::BLACK, 1.3));
        for (_, value) in &mut speed.points {
            *value = stop_us + us_per_rad_s * *value;
        }
        let pulse = line(recorder, Channel::Pulse(k), label("ESC pulse"), Stroke::solid(colour::ORANGE, 1.0));
        let right = RightAxis { unit: "rad/s", zero: -stop_us / us_per_rad_s, per_unit: 1.0 / us_per_rad_s };
        Panel {
            includes: vec![stop_us, full_us],
            right: Some(right),
            ..Panel::new(title, "µs", 84.0, vec![pulse, speed])
        }
    };
    let names = ["Rotor 1, front left", "Rotor 2, front right", "Rotor 3, rear right", "Rotor 4, rear left"];
    let panels = names.into_iter().enumerate().map(rotor).collect();
    Figure {
        title: "Motors",
        caption: "The pulse that the flight code sends to each ESC (left axis), and the true speed of the \
                  rotor (right axis)."
            .into(),
        chart: chart("ESC pulse and speed of the four rotors over time", panels),
    }
}

fn place(recorder: &Recorder) -> Figure {
    let height = vec![
        line(recorder, Channel::Height, "truth", TRUTH),
        line(recorder, Channel::HeightTarget, "pilot's target", TARGET),
    ];
    let place = vec![
        line(recorder, Channel::North, "north", Stroke::solid(colour::BLUE, 1.6)),
        line(recorder, Channel::East, "east", Stroke::solid(colour::ORANGE, 1.6)),
    ];
    Figure {
        title: "Height and position",
        caption:
            "The true position and the pilot's target. The pilot sees the vehicle with a delay of 0.2 s."
                .into(),
        chart: chart(
            "Height, and distance north and east of the pilot's target, over time",
            vec![
                Panel::new("Height above the start", "m", 150.0, height),
                Panel {
                    includes: vec![0.0],
                    min_span: 0.1,
                    ..Panel::new("Distance from the target", "m", 110.0, place)
                },
            ],
        ),
    }
}
