//! The study `rates`: at which rate to sample, estimate and control.
//!
//! The world is simulated in steps of 1/8 ms at every rate of the flight code, so that all rates fly in the same world.
//! The flight code runs in every n-th of these steps, with filters designed for its rate. Between its steps the rotors
//! keep their command. Noise is set per √Hz, and so does not change with the rate.

use std::time::Instant;

use flight_core::FlightController;
use flight_core::geometry::Quaternion;
use flight_core::sample::{Battery, Health, Input};

use super::{Axis, Options, Progress, Setting, Study, m4};
use input::InputError;
use sim_host::attitude_error::{AttitudeError, AttitudeRmse};
use sim_host::dynamics::Vehicle;
use sim_host::flight::Autopilot;
use sim_host::pilot::{FRAME_RATE_HZ, Pilot};
use sim_host::scene::{DEFAULT_RATE_HZ, MAG_RATE_HZ, Scene};

/// Steps of the simulated world in a second.
const WORLD_HZ: u32 = 8000;
/// The processor's clock, and the cycles that an instruction is assumed to need: see `docs/timing.md`.
const CLOCK_HZ: f64 = 168e6;
const CYCLES_PER_INSTRUCTION: f64 = 2.0;

/// The problem whose error is the deviation of the true attitude from the flight at 8 kHz.
const PATH: &str = "steps: true attitude against that at 8 kHz";

/// The result of a flight.
struct Flown {
    /// RMSE of the estimated attitude over all steps, degrees; `None` after a crash.
    attitude_rmse_deg: Option<f64>,
    /// True attitude every 10 ms, which is the step of the lowest rate.
    path: Vec<Quaternion<f64>>,
}

impl Flown {
    /// Returns the RMS angle between the true attitudes of two flights, degrees; `None` if one of them crashed.
    fn difference_deg(&self, other: &Self) -> Option<f64> {
        let mut rmse = AttitudeRmse::default();
        let both = self.path.iter().zip(&other.path);
        both.for_each(|(one, other)| rmse.add(AttitudeError::between(*one, *other)));
        let flown = self.attitude_rmse_deg.and(other.attitude_rmse_deg);
        flown.and(rmse.root()).map(|error| error.total_rad.to_degrees())
    }
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
    let mut path = Vec::new();
    for step in 0..(scene.duration_s * f64::from(rate_hz)).round() as u64 {
        let time_us = step * steps_us;
        let at_s = time_us as f64 * 1e-6;
        let imu = sensors.imu(&vehicle.snapshot());
        let due = |every_us: u64| time_us.is_multiple_of(every_us);
        let mag_due = due(1_000_000 / u64::from(MAG_RATE_HZ));
        let mag = if mag_due { sensors.mag(&vehicle.snapshot()) } else { None };
        let rc =
            if due(frame_us) { pilot.as_mut().map(|pilot| pilot.frame(at_s, vehicle.state())) } else { None };
        let battery = due(20_000).then_some(Battery { voltage_v: 11.1 });
        let input = Input { time_us, imu, mag, rc, battery, bench: None, health: Health::default() };
        let Ok(output) = Autopilot::step(&mut controller, &input);
        let [w, x, y, z] = output.attitude.to_array().map(f64::from);
        let truth = vehicle.state();
        rmse.add(AttitudeError::between(Quaternion::new(w, x, y, z), truth.attitude));
        let is_lost = pilot.as_ref().is_some_and(|p| (truth.position - p.target_m(at_s)).norm() > 20.0);
        if !truth.is_finite() || truth.cos_tilt() < 0.0 || is_lost {
            return Ok(Flown { attitude_rmse_deg: None, path });
        }
        if due(10_000) {
            path.push(truth.attitude);
        }
        let speed = |us: f32| scene.vehicle.max_rad_s * ((f64::from(us) - 1000.0) * 1e-3).clamp(0.0, 1.0);
        vehicle.command(if output.driven { output.pulses_us.map(speed) } else { [0.0; 4] });
        for _ in 0..world_hz / rate_hz {
            vehicle.advance();
        }
    }
    Ok(Flown { attitude_rmse_deg: rmse.root().map(|error| error.total_rad.to_degrees()), path })
}

/// Runs the study.
///
/// # Errors
/// A built-in scene cannot be read; this does not happen.
pub fn study(options: &Options, progress: Progress) -> Result<Study, InputError> {
    let all = [100, 200, 500, 1000, 2000, 4000, 8000];
    let (rates, seeds) = if options.quick { (&all[1..5], 2_u32) } else { (&all[..], 10) };
    let step = m4::instructions("sample to motors mean");
    let row = |problem, rate_hz: u32, error, error_unit, host_ns| {
        let instructions = step.map(|step| step * f64::from(rate_hz));
        let percent = |instructions| 100.0 * instructions * CYCLES_PER_INSTRUCTION / CLOCK_HZ;
        Setting {
            problem,
            series: "whole flight code".into(),
            setting: format!("{rate_hz} Hz"),
            error,
            error_unit,
            host_ns,
            m4_instructions: instructions,
            also: instructions
                .map(|instructions| ("cpu_percent", percent(instructions)))
                .into_iter()
                .collect(),
            default: rate_hz == DEFAULT_RATE_HZ,
            ..Setting::default()
        }
    };
    let mut settings = Vec::new();
    let mut flights = 0.0;
    let mut count = |more: u32| {
        flights += f64::from(more);
        progress(flights / (2.0 * f64::from(seeds) + 1.0) / rates.len() as f64);
    };

    // Without noise, two flights differ only by the rate.
    let mut quiet = Scene::load("steps")?;
    for noise in ["gyro.white_noise", "accel.white_noise", "mag.white_noise"] {
        quiet = quiet.without(noise).unwrap_or(quiet);
    }
    let reference = fly(&quiet, 0, WORLD_HZ, WORLD_HZ)?;
    for &rate_hz in rates.iter().filter(|rate_hz| **rate_hz < WORLD_HZ) {
        let start = Instant::now();
        let error = fly(&quiet, 0, rate_hz, WORLD_HZ)?.difference_deg(&reference);
        let time = start.elapsed().as_nanos() as f64 / quiet.duration_s;
        settings.push(row(PATH, rate_hz, error, "° RMS", options.timed.then_some(time)));
        count(1);
    }
    for (name, problem) in
        [("steps", "steps: estimate against truth"), ("shaky-frame", "shaky-frame: estimate against truth")]
    {
        let scene = Scene::load(name)?;
        for &rate_hz in rates {
            let (mut squares, mut time) = (Some(0.0), f64::INFINITY);
            for seed in 0..seeds {
                let start = Instant::now();
                let error = fly(&scene, seed.into(), rate_hz, WORLD_HZ)?.attitude_rmse_deg;
                squares = squares.zip(error).map(|(sum, error)| sum + error * error);
                time = time.min(start.elapsed().as_nanos() as f64 / scene.duration_s);
                count(1);
            }
            let error = squares.map(|sum| libm::sqrt(sum / f64::from(seeds)));
            settings.push(row(problem, rate_hz, error, "° RMSE", options.timed.then_some(time)));
        }
    }
    Ok(Study {
        name: "rates",
        title: "Rate of estimation and control",
        about: format!(
            "There are two errors. The first is the difference of the true attitude from that of the same flight at 8 kHz, without \
             noise: it shows the effect of the rate alone, through the delay of sampling and of holding a command. The second is \
             the error of the estimated attitude over whole flights with noise, RMSE over {seeds} seeds; a rate at which a flight \
             crashes has none. The share of the processor is instructions × 2 cycles at 168 MHz. Time is that of the simulation."
        ),
        reference: "The simulated truth in f64, in a world of 8,000 steps a second at every rate of the flight \
                    code."
            .into(),
        per: "a second of flight",
        axis: Axis::M4,
        axis_title: "instructions per second on the Cortex-M4F",
        settings,
        remarks: vec![
            "The error of the estimate does not fall with the rate. The 30 Hz prefilter delays it by 7.5 ms at every rate, and \
             noise is set per √Hz. What remains is the scatter of the random draws, which differ from rate to rate. In the scene \
             with a shaking frame the accelerometer's vibration is the error, and the rate only decides which part of it is \
             aliased. A higher rate improves control: the flight itself is nearer to the ideal one."
                .into(),
        ],
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use sim_host::flight::Flight;

    #[test]
    fn study_at_the_default_rate_equals_the_flight() {
        let mut scene = Scene::load("hover").unwrap();
        scene.set_duration(16.0).unwrap();
        let flight = Flight::new(&scene, 3).run(&mut ());
        let flown = fly(&scene, 3, DEFAULT_RATE_HZ, DEFAULT_RATE_HZ).unwrap();
        assert_eq!(flown.attitude_rmse_deg, Some(flight.attitude_rmse_deg));
    }
}
