//! The page of proposed gains: how the vehicle answers a step of the stick, in truth.

use std::path::Path;

use flight_core::geometry::Vec3;
use input::InputError;
use maud::html;

use super::figures::{TARGET, TRUTH};
use super::page::{document, figure, printable};
use crate::chart::{Chart, Line, Panel, Stroke, colour};
use crate::flight::{Observer, StepView};
use crate::output_file;

/// The step of the scene `steps`: when the roll stick moves, when it moves back, s, and how far, as a share of full stick.
const STEP_S: (f64, f64) = (14.0, 14.7);
/// 0.6667 of full stick.
pub const STEP_SHARE: f64 = 0.6667;
/// Shown before the step, s.
const BEFORE_S: f64 = 0.1;
/// A step's answer has settled when it stays within this share of what was asked for.
const SETTLED: f64 = 0.05;
/// Steps of the flight from one point of the plot to the next.
const THINNED: u64 = 2;

/// What is seen of the answer: time after the step (s), true roll (rad) and its rate (rad/s), rotor speeds (rad/s).
#[derive(Clone, Debug, Default)]
pub struct StepResponse {
    points: Vec<(f64, f64, f64, [f64; 4])>,
    largest_tilt_rad: f64,
}

impl Observer for StepResponse {
    fn step(&mut self, view: &StepView) {
        let truth = view.truth;
        self.largest_tilt_rad = self.largest_tilt_rad.max(libm::acos(truth.cos_tilt().clamp(-1.0, 1.0)));
        let after_s = view.time_us as f64 * 1e-6 - STEP_S.0;
        if after_s >= -BEFORE_S && after_s <= STEP_S.1 - STEP_S.0 {
            let Vec3 { y, z, .. } = truth.attitude.down();
            self.points.push((after_s, libm::atan2(y, z), truth.rates.x, view.rotors_rad_s));
        }
    }
}

/// Figures of the answer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Answered {
    /// From a tenth to nine tenths of what was asked for, s; none if it did not get there.
    pub rise_s: Option<f64>,
    /// Beyond what was asked for, as a share of it.
    pub overshoot: f64,
    /// From the step until it stays within 5 %, s; none if it has not when the stick moves back.
    pub settled_s: Option<f64>,
}

impl StepResponse {
    /// The largest tilt of the whole flight, rad.
    pub fn largest_tilt_rad(&self) -> f64 {
        self.largest_tilt_rad
    }

    /// What came of a step to `asked_rad`.
    pub fn answered(&self, asked_rad: f64) -> Answered {
        let share = |roll_rad: f64| roll_rad / asked_rad;
        let first =
            |level: f64| self.points.iter().find(|point| share(point.1) >= level).map(|point| point.0);
        let largest = self.points.iter().map(|point| share(point.1)).fold(0.0, f64::max);
        let outside = self.points.iter().rposition(|point| (share(point.1) - 1.0).abs() > SETTLED);
        let after = outside.map_or(0, |last| last + 1);
        Answered {
            rise_s: first(0.9).zip(first(0.1)).map(|(high_s, low_s)| high_s - low_s),
            overshoot: (largest - 1.0).max(0.0),
            settled_s: self.points.get(after).map(|point| point.0),
        }
    }

    fn chart(&self, asked_rad: f64, rotor_limits_rad_s: (f64, f64)) -> Chart {
        let seen = || self.points.iter().step_by(THINNED as usize);
        let end_s = STEP_S.1 - STEP_S.0;
        let asked_deg = asked_rad.to_degrees();
        let asked = vec![(-BEFORE_S, 0.0), (0.0, 0.0), (0.0, asked_deg), (end_s, asked_deg)];
        let roll = seen().map(|point| (point.0, point.1.to_degrees())).collect();
        let rate = seen().map(|point| (point.0, point.2.to_degrees())).collect();
        let colours = [colour::SKY, colour::VERMILLION, colour::GREEN, colour::ORANGE];
        let places = ["front left", "front right", "rear right", "rear left"];
        let mut rotors: Vec<Line> = (0..4)
            .map(|n| {
                let speed = seen().map(|point| (point.0, point.3[n])).collect();
                Line::new(places[n], Stroke::solid(colours[n], 1.5), speed)
            })
            .collect();
        let (slowest, fastest) = rotor_limits_rad_s;
        for limit in [slowest, fastest] {
            rotors.push(Line::new("", TARGET, vec![(-BEFORE_S, limit), (end_s, limit)]));
        }
        let roll = vec![Line::new("true", TRUTH, roll), Line::new("stick", TARGET, asked)];
        let rate = vec![Line::new("true", TRUTH, rate)];
        Chart::over_time(
            920.0,
            "Roll, its rate and the rotors' speeds after a step of the stick",
            (-BEFORE_S, end_s),
            vec![
                Panel::new("roll", "°", 240.0, roll),
                Panel::new("rate", "°/s", 160.0, rate),
                Panel::new("rotors, and their limits", "rad/s", 180.0, rotors),
            ],
        )
    }
}

/// What the page says of a vehicle.
#[derive(Clone, Debug)]
pub struct Proposal<'a> {
    /// The vehicle's name.
    pub vehicle: &'a str,
    /// The step, rad.
    pub asked_rad: f64,
    /// Slowest and fastest speed of a rotor, rad/s.
    pub rotor_limits_rad_s: (f64, f64),
    /// The gains, as they go into the vehicle's file.
    pub gains: &'a str,
    /// Name, crossover (Hz) and phase margin (°) of each loop.
    pub loops: &'a [(String, f64, f64)],
}

/// The page.
pub fn page(proposal: &Proposal<'_>, response: &StepResponse) -> String {
    let vehicle = printable(proposal.vehicle);
    let Answered { rise_s, overshoot, settled_s } = response.answered(proposal.asked_rad);
    let time =
        |time_s: Option<f64>| time_s.map_or("not reached".into(), |time_s| format!("{:.0} ms", time_s * 1e3));
    let step = format!("A step of {:.0}°", proposal.asked_rad.to_degrees());
    let caption = html! {
        "From a tenth to nine tenths " (time(rise_s)) "; overshoot " (format!("{:.0}", overshoot * 100.0))
        " %; within 5 % after " (time(settled_s)) "."
    };
    let content = html! {
        header {
            p.kind { "Kestrel · proposed gains" }
            h1 { (vehicle) }
            p.about {
                "A step of the roll stick in free flight, with the sensors' noise, the rotors' lag and the drag of the \
                 scene " code { "steps" } ". What is shown is the truth."
            }
        }
        (figure(&step, &caption, &response.chart(proposal.asked_rad, proposal.rotor_limits_rad_s)))
        section {
            h2 { "Loops" }
            table {
                tr { th { "loop" } th { "crossover, Hz" } th { "phase margin" } }
                @for (name, crossover_hz, margin_deg) in proposal.loops {
                    tr {
                        td { (name) }
                        td { (format!("{crossover_hz:.2}")) }
                        td { (format!("{margin_deg:.0}°")) }
                    }
                }
            }
        }
        section {
            h2 { "For the vehicle's file" }
            pre { (proposal.gains) }
        }
    };
    document(&format!("Gains for {vehicle}"), "", &content)
}

/// Writes the page: complete, or not at all.
///
/// # Errors
/// A place that cannot be written.
pub fn write(path: &Path, proposal: &Proposal<'_>, response: &StepResponse) -> Result<(), InputError> {
    output_file::write(path, &page(proposal, response))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A second-order system, whose figures are in every textbook: ζ = 0.5 overshoots by exp(−π ζ/√(1 − ζ²)) = 16.3 %.
    #[test]
    fn figures_of_a_second_order_step() {
        let (zeta, natural) = (0.5_f64, 40.0_f64);
        let damped = natural * libm::sqrt(1.0 - zeta * zeta);
        let roll = |t: f64| {
            let (sine, cosine) = (libm::sin(damped * t), libm::cos(damped * t));
            1.0 - libm::exp(-zeta * natural * t) * (cosine + zeta / libm::sqrt(1.0 - zeta * zeta) * sine)
        };
        let points =
            (0..700).map(|ms| (f64::from(ms) * 1e-3, 0.5 * roll(f64::from(ms) * 1e-3), 0.0, [0.0; 4]));
        let response = StepResponse { points: points.collect(), largest_tilt_rad: 0.0 };
        let answered = response.answered(0.5);
        assert!((answered.overshoot - 0.163).abs() < 1e-3, "{answered:?}");
        // 1.64/ω for ζ = 0.5 (10 to 90 %), and the last time within 5 % at 5.29/ω.
        assert!((answered.rise_s.unwrap() - 1.64 / natural).abs() < 2e-3, "{answered:?}");
        assert!((answered.settled_s.unwrap() - 5.29 / natural).abs() < 3e-3, "{answered:?}");
        let never =
            StepResponse { points: vec![(0.0, 0.0, 0.0, [0.0; 4])], largest_tilt_rad: 0.0 }.answered(0.5);
        assert_eq!((never.rise_s, never.settled_s), (None, None));
    }
}
