//! The page of proposed gains: the true response of the vehicle to a step of the stick.

use std::path::Path;

use flight_core::geometry::Vec3;
use input::InputError;
use maud::html;

use super::figures::{TARGET, TRUTH};
use super::page::{document, figure, printable};
use crate::chart::{Chart, Line, Panel, Stroke, colour};
use crate::flight::{Observer, StepView};
use crate::output_file;

/// Start and end of the roll step in the scene `steps`, s.
const STEP_S: (f64, f64) = (14.0, 14.7);
/// Size of the roll step in the scene `steps`, as a share of full stick.
pub const STEP_STICK_SHARE: f64 = 0.6667;
/// Time shown before the step, s.
const BEFORE_S: f64 = 0.1;
/// The response has settled when it stays within this share of the commanded step.
const SETTLED: f64 = 0.05;
/// Number of steps of the flight per point of the plot.
const STEPS_PER_POINT: u64 = 2;

/// An observer that records the step response: time after the step (s), true roll (rad), true roll rate (rad/s), rotor
/// speeds (rad/s).
#[derive(Clone, Debug, Default)]
pub struct StepResponse {
    points: Vec<(f64, f64, f64, [f64; 4])>,
    max_tilt_rad: f64,
}

impl Observer for StepResponse {
    fn step(&mut self, view: &StepView) {
        let truth = view.truth;
        self.max_tilt_rad = self.max_tilt_rad.max(libm::acos(truth.cos_tilt().clamp(-1.0, 1.0)));
        let after_s = view.time_us as f64 * 1e-6 - STEP_S.0;
        if after_s >= -BEFORE_S && after_s <= STEP_S.1 - STEP_S.0 {
            let Vec3 { y, z, .. } = truth.attitude.down();
            self.points.push((after_s, libm::atan2(y, z), truth.rates.x, view.rotors_rad_s));
        }
    }
}

/// Metrics of a step response.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepMetrics {
    /// Rise time from 10 % to 90 % of the commanded step, s; `None` if it was not reached.
    pub rise_s: Option<f64>,
    /// Overshoot, as a share of the commanded step.
    pub overshoot: f64,
    /// Settling time to within 5 %, s; `None` if it was not reached before the stick moved back.
    pub settled_s: Option<f64>,
}

impl StepResponse {
    /// Returns the largest tilt of the whole flight, rad.
    pub fn max_tilt_rad(&self) -> f64 {
        self.max_tilt_rad
    }

    /// Returns the metrics of the response to a step to `step_rad`.
    pub fn metrics(&self, step_rad: f64) -> StepMetrics {
        let share = |roll_rad: f64| roll_rad / step_rad;
        let first =
            |level: f64| self.points.iter().find(|point| share(point.1) >= level).map(|point| point.0);
        let largest = self.points.iter().map(|point| share(point.1)).fold(0.0, f64::max);
        let outside = self.points.iter().rposition(|point| (share(point.1) - 1.0).abs() > SETTLED);
        let after = outside.map_or(0, |last| last + 1);
        StepMetrics {
            rise_s: first(0.9).zip(first(0.1)).map(|(high_s, low_s)| high_s - low_s),
            overshoot: (largest - 1.0).max(0.0),
            settled_s: self.points.get(after).map(|point| point.0),
        }
    }

    fn chart(&self, step_rad: f64, rotor_limits_rad_s: (f64, f64)) -> Chart {
        let sampled = || self.points.iter().step_by(STEPS_PER_POINT as usize);
        let end_s = STEP_S.1 - STEP_S.0;
        let commanded_deg = step_rad.to_degrees();
        let commanded = vec![(-BEFORE_S, 0.0), (0.0, 0.0), (0.0, commanded_deg), (end_s, commanded_deg)];
        let roll = sampled().map(|point| (point.0, point.1.to_degrees())).collect();
        let rate = sampled().map(|point| (point.0, point.2.to_degrees())).collect();
        let colours = [colour::SKY, colour::VERMILLION, colour::GREEN, colour::ORANGE];
        let places = ["front left", "front right", "rear right", "rear left"];
        let mut rotors: Vec<Line> = (0..4)
            .map(|n| {
                let speed = sampled().map(|point| (point.0, point.3[n])).collect();
                Line::new(places[n], Stroke::solid(colours[n], 1.5), speed)
            })
            .collect();
        let (slowest, fastest) = rotor_limits_rad_s;
        for limit in [slowest, fastest] {
            rotors.push(Line::new("", TARGET, vec![(-BEFORE_S, limit), (end_s, limit)]));
        }
        let roll = vec![Line::new("truth", TRUTH, roll), Line::new("stick", TARGET, commanded)];
        let rate = vec![Line::new("truth", TRUTH, rate)];
        Chart::over_time(
            920.0,
            "Roll, roll rate and rotor speeds after a step of the roll stick",
            (-BEFORE_S, end_s),
            vec![
                Panel::new("Roll", "°", 240.0, roll),
                Panel::new("Roll rate", "°/s", 160.0, rate),
                Panel::new("Rotor speeds and their limits", "rad/s", 180.0, rotors),
            ],
        )
    }
}

/// The content of the page.
#[derive(Clone, Debug)]
pub struct Proposal<'a> {
    /// The vehicle's name.
    pub vehicle: &'a str,
    /// The commanded step, rad.
    pub step_rad: f64,
    /// Slowest and fastest speed of a rotor, rad/s.
    pub rotor_limits_rad_s: (f64, f64),
    /// The gains, in the format of the vehicle's file.
    pub gains: &'a str,
    /// Name, crossover (Hz) and phase margin (°) of each loop.
    pub loops: &'a [(String, f64, f64)],
}

/// Returns the page.
pub fn page(proposal: &Proposal<'_>, response: &StepResponse) -> String {
    let vehicle = printable(proposal.vehicle);
    let StepMetrics { rise_s, overshoot, settled_s } = response.metrics(proposal.step_rad);
    let time =
        |time_s: Option<f64>| time_s.map_or("not reached".into(), |time_s| format!("{:.0} ms", time_s * 1e3));
    let step = format!("A step of {:.0}°", proposal.step_rad.to_degrees());
    let caption = html! {
        "Rise time (10 % to 90 %): " (time(rise_s)) "; overshoot: " (format!("{:.0}", overshoot * 100.0))
        " %; settling time (5 %): " (time(settled_s)) "."
    };
    let content = html! {
        header {
            p.kind { "Kestrel · proposed gains" }
            h1 { (vehicle) }
            p.about {
                "A step of the roll stick in free flight, with the sensor noise, the motor lag and the drag of the \
                 scene " code { "steps" } ". The plots show the truth."
            }
        }
        (figure(&step, &caption, &response.chart(proposal.step_rad, proposal.rotor_limits_rad_s)))
        section {
            h2 { "Control loops" }
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
            h2 { "Gains for the vehicle's file" }
            pre { (proposal.gains) }
        }
    };
    document(&format!("Gains for {vehicle}"), "", &content)
}

/// Writes the page. The file is complete or does not exist.
///
/// # Errors
/// The file cannot be written.
pub fn write(path: &Path, proposal: &Proposal<'_>, response: &StepResponse) -> Result<(), InputError> {
    output_file::write(path, &page(proposal, response))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The closed form of a second-order system: for ζ = 0.5 the overshoot is exp(−π ζ/√(1 − ζ²)) = 16.3 %.
    #[test]
    fn metrics_of_a_second_order_step() {
        let (zeta, natural) = (0.5_f64, 40.0_f64);
        let damped = natural * libm::sqrt(1.0 - zeta * zeta);
        let roll = |t: f64| {
            let (sine, cosine) = (libm::sin(damped * t), libm::cos(damped * t));
            1.0 - libm::exp(-zeta * natural * t) * (cosine + zeta / libm::sqrt(1.0 - zeta * zeta) * sine)
        };
        let points =
            (0..700).map(|ms| (f64::from(ms) * 1e-3, 0.5 * roll(f64::from(ms) * 1e-3), 0.0, [0.0; 4]));
        let response = StepResponse { points: points.collect(), max_tilt_rad: 0.0 };
        let metrics = response.metrics(0.5);
        assert!((metrics.overshoot - 0.163).abs() < 1e-3, "{metrics:?}");
        // For ζ = 0.5 the rise time (10 % to 90 %) is 1.64/ω, and the settling time to 5 % is 5.29/ω.
        assert!((metrics.rise_s.unwrap() - 1.64 / natural).abs() < 2e-3, "{metrics:?}");
        assert!((metrics.settled_s.unwrap() - 5.29 / natural).abs() < 3e-3, "{metrics:?}");
        let never = StepResponse { points: vec![(0.0, 0.0, 0.0, [0.0; 4])], max_tilt_rad: 0.0 }.metrics(0.5);
        assert_eq!((never.rise_s, never.settled_s), (None, None));
    }
}
