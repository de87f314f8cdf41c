//! The study `rates`: how often to sample, estimate and control.
//!
//! The world goes on in steps of 1/8 ms whatever the rate of the flight code, so that all rates fly through the
//! same one; the flight code steps every so-many-th of them, with filters designed for its rate, and the
//! rotors keep their command in between. Noise is set per √Hz, and does not change with the rate.

use std::time::Instant;

use flight_core::FlightController;
use flight_core::geometry::Quaternion;
use flight_core::sample::{Battery, Health, Input};

use super::{Axis, Options, Progress, Setting, Study, m4};
use crate::attitude_error::{AttitudeError, AttitudeRmse};
use crate::flight::Autopilot;
use crate::input_error::InputError;
use crate::pilot::{FRAME_RATE_HZ, Pilot};
use crate::scene::{DEFAULT_RATE_HZ, MAG_RATE_HZ, Scene};
use crate::vehicle::Vehicle;

/// Steps of the world in a second.
const WORLD_HZ: u32 = 8000;
/// The processor's clock, and cycles that an instruction is taken to need: `docs/timing.md`.
const CLOCK_HZ: f64 = 168e6;
const CYCLES_PER_INSTRUCTION: f64 = 2.0;

/// What a flight came to.
struct Flown {
    /// Estimated attitude against the truth over all steps, degrees; `None` after a crash.
    attitude_rmse_deg: Option<f64>,
}

/// Flies a scene with the flight code at `rate_hz` in a world of `world_hz` steps a second.
fn fly(scene: &Scene, seed: u64, rate_hz: u32, world_hz: u32) -> Result<Flown, InputError> {
    let mut config = scene.config;
    config.params.imu_rate_hz = rate_hz as f32;
    let refused =
        |error: flight_core::config::ConfigError| InputError::new(error.to_string()).file(&scene.name);
    let mut controller = FlightController::new(&config).map_err(refused)?;
    let world_s = 1.0 / f64::from(world_hz);
    let mut vehicle = Vehicle::at_rest(
        scene.vehicle,
        scene.mount(),
        scene.vehicle_effects(seed, f64::from(world_hz)),
        world_s,
    );
    let mut sensors = scene.sensors(seed, f64::from(rate_hz), f64::from(MAG_RATE_HZ));
    let knowledge = scene.pilot_knowledge();
    let pilot = scene.pilot.as_ref();
    let mut pilot = pilot.map(|p| Pilot::new(p, scene.duration_s, knowledge, vehicle.state()));
    let steps_us = 1_000_000 / u64::from(rate_hz);
    let frame_us = (1e6 / FRAME_RATE_HZ) as u64;
    let mut rmse = AttitudeRmse::default();
    for step in 0..(scene.duration_s * f64::from(rate_hz)).round() as u64 {
        let time_us = step * steps_us;
        let at_s = time_us as f64 * 1e-6;
        let imu = sensors.imu(&vehicle.moment());
        let due = |every_us: u64| time_us.is_multiple_of(every_us);
        let mag_due = due(1_000_000 / u64::from(MAG_RATE_HZ));
        let mag = if mag_due { sensors.mag(&vehicle.moment()) } else { None };
        let rc =
            if due(frame_us) { pilot.as_mut().map(|pilot| pilot.frame(at_s, vehicle.state())) } else { None };
        let battery = due(20_000).then_some(Battery { voltage_v: 11.1 });
        let input = Input { time_us, imu, mag, rc, battery, bench: None, health: Health::default() };
        let Ok(output) = Autopilot::step(&mut controller, &input);
        let [w, x, y, z] = output.attitude.to_array().map(f64::from);
        let truth = vehicle.state();
        rmse.add(AttitudeError::between(Quaternion::new(w, x, y, z), truth.attitude));
        let astray = pilot.as_ref().is_some_and(|p| (truth.position - p.target_m(at_s)).norm() > 20.0);
        if !truth.is_finite() || truth.cos_tilt() < 0.0 || astray {
            return Ok(Flown { attitude_rmse_deg: None });
        }
        let speed = |us: f32| scene.vehicle.max_rad_s * ((f64::from(us) - 1000.0) * 1e-3).clamp(0.0, 1.0);
        vehicle.command(if output.driven { output.pulses_us.map(speed) } else { [0.0; 4] });
        for _ in 0..world_hz / rate_hz {
            vehicle.advance();
        }
    }
    Ok(Flown { attitude_rmse_deg: rmse.root().map(|error| error.total_rad.to_degrees()) })
}

/// Runs the study.
///
/// # Errors
/// None of the built-in scenes that it flies.
pub fn study(options: &Options, progress: Progress) -> Result<Study, InputError> {
    let all = [100, 200, 500, 1000, 2000, 4000, 8000];
    let (rates, seeds) = if options.quick { (&all[1..5], 2) } else { (&all[..], 10) };
    let step = m4::instructions("sample to motors mean");
    let problems = [("steps", "steps: 30° doublets"), ("shaky-frame", "shaky-frame: vibration")];
    let mut settings = Vec::new();
    for (n, (name, problem)) in problems.iter().enumerate() {
        let scene = Scene::load(name)?;
        for (k, &rate_hz) in rates.iter().enumerate() {
            let (mut squares, mut crashes, mut time) = (0.0, 0, f64::INFINITY);
            for seed in 0..seeds {
                let start = Instant::now();
                match fly(&scene, seed, rate_hz, WORLD_HZ)?.attitude_rmse_deg {
                    Some(error) => squares += error * error,
                    None => crashes += 1,
                }
                time = time.min(start.elapsed().as_nanos() as f64);
            }
            let error = (crashes == 0).then(|| libm::sqrt(squares / seeds as f64));
            let instructions = step.map(|step| step * f64::from(rate_hz));
            let mut also = vec![("crashes", f64::from(crashes))];
            if let Some(instructions) = instructions {
                also.push(("cpu_percent", 100.0 * instructions * CYCLES_PER_INSTRUCTION / CLOCK_HZ));
            }
            settings.push(Setting {
                problem,
                series: "whole flight code".into(),
                setting: format!("{rate_hz} Hz"),
                error,
                error_unit: "° RMSE",
                host_ns: options.timed.then_some(time / scene.duration_s),
                m4_instructions: instructions,
                also,
                default: rate_hz == DEFAULT_RATE_HZ,
                ..Setting::default()
            });
            progress((n as f64 + (k + 1) as f64 / rates.len() as f64) / problems.len() as f64);
        }
    }
    Ok(Study {
        name: "rates",
        title: "Rate of estimation and control",
        about: format!(
            "The error is that of the estimated attitude over whole flights in closed loop, RMSE over {seeds} seeds. \
             The share of the processor is instructions × 2 cycles at 168 MHz. Time is that of the simulation, whose \
             world has 8,000 steps a second at every rate."
        ),
        reference: "The simulated truth, in f64, in steps that do not depend on the rate of the flight code.".into(),
        per: "a second of flight",
        axis: Axis::M4,
        axis_title: "instructions per second on the Cortex-M4F",
        settings,
        remarks: vec![
            "The error has a floor that no rate goes below: the 30 Hz prefilter delays the attitude by 7.5 ms at every \
             rate, and noise is per √Hz. Where the frame shakes, the accelerometer's rectified vibration is the error, \
             and the rate decides only what of it is aliased: slower is then sometimes better by luck of the \
             frequencies, and no reason to be slow."
                .into(),
        ],
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flight::Flight;

    #[test]
    fn at_the_flights_own_rates_it_is_the_flight() {
        let mut scene = Scene::load("hover").unwrap();
        scene.set_duration(16.0).unwrap();
        let flight = Flight::new(&scene, 3).run(&mut ());
        let flown = fly(&scene, 3, DEFAULT_RATE_HZ, DEFAULT_RATE_HZ).unwrap();
        assert_eq!(flown.attitude_rmse_deg, Some(flight.attitude_rmse_deg));
    }
}
