//! The command `vehicle`: shows what follows from a vehicle file, and proposes gains.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use flight_core::control::ControlParams;
use input::InputError;
use serde_json::{Value, json};
use sim_host::flight::Flight;
use sim_host::output_file::check_outputs;
use sim_host::report::step_response::{self, Proposal, STEP_STICK_SHARE, StepResponse};
use sim_host::scene::Scene;
use vehicle::{Axis, Loop, MARGIN_DEG, Margin, Plant, Tuned, Vehicle, authority_rad_s2, tune};

use super::{Answer, heading};

#[derive(clap::Args)]
pub struct VehicleArguments {
    /// Built-in vehicle or vehicle file
    vehicle: String,
    /// Propose gains for a phase margin of 60° and fly the scene `steps` with them
    #[arg(long)]
    tune: bool,
    /// Write a report with plots of the step response with the proposed gains: one HTML file
    #[arg(long, value_name = "F.html", requires = "tune")]
    report: Option<PathBuf>,
}

/// Largest overshoot of the tilt with the proposed gains, as a share of the step; more fails the command.
const MAX_OVERSHOOT: f64 = 0.25;

pub fn run(arguments: &VehicleArguments) -> Result<Answer, InputError> {
    let vehicle = Vehicle::load(&arguments.vehicle)?;
    check_outputs(&[Path::new(&arguments.vehicle)], &[("--report", arguments.report.as_deref())])?;
    let plant = Plant::of(&vehicle);
    let mut text = format!("{}\n", heading(&vehicle.name, &vehicle.description));
    let mut json = json!({ "vehicle": vehicle.name, "description": vehicle.description });
    derived(&vehicle, &mut text, &mut json);
    limits(&vehicle, &mut text, &mut json);
    delays(&plant, &mut text, &mut json);
    loops(&plant, &vehicle.control, &mut text, &mut json);
    let warnings = warnings(&vehicle, &plant);
    if !warnings.is_empty() {
        text.push_str("\n\n  warnings");
        warnings.iter().for_each(|warning| write_line(&mut text, warning));
    }
    json["warnings"] = json!(warnings);
    let mut failed = false;
    if arguments.tune {
        failed = proposal(arguments, &vehicle, &plant, &mut text, &mut json)?;
    }
    Ok(Answer { json, text, failed })
}

fn write_line(text: &mut String, line: &str) {
    write!(text, "\n    {line}").expect("writing to a String does not fail");
}

/// Lists the values that are derived because the file does not give them.
fn derived(vehicle: &Vehicle, text: &mut String, json: &mut Value) {
    text.push_str("\n  derived from the file");
    let width = vehicle.derived.iter().map(|derived| derived.value.chars().count()).max().unwrap_or(0) + 2;
    for derived in &vehicle.derived {
        let estimate = if derived.estimate { ", an ESTIMATE" } else { "" };
        write_line(text, &format!("{:<40}{:<width$}{}{estimate}", derived.what, derived.value, derived.how));
    }
    let list = vehicle.derived.iter().map(|derived| {
        json!({ "what": derived.what, "value": derived.value, "how": derived.how, "estimate": derived.estimate })
    });
    json["derived"] = list.collect();
}

/// Lists the speeds, accelerations and angles that the vehicle reaches.
fn limits(vehicle: &Vehicle, text: &mut String, json: &mut Value) {
    let v = &vehicle.params;
    let [roll, pitch, yaw] = authority_rad_s2(v);
    let control = &vehicle.control;
    let deg_s = |rad_s: f32| f64::from(rad_s).to_degrees();
    text.push_str("\n\n  limits");
    write_line(
        text,
        &format!(
            "{:<40}{:.0} rad/s, {:.0} rpm",
            "rotors at hover",
            v.hover_rad_s(),
            v.hover_rad_s() * 9.549_297
        ),
    );
    write_line(
        text,
        &format!("{:<40}{roll:.0}, {pitch:.0}, {yaw:.1} rad/s²", "angular acceleration at hover"),
    );
    write_line(
        text,
        &format!(
            "{:<40}tilt {:.0}°, rate {:.0}°/s, yaw {:.0}°/s",
            "setpoints at full stick",
            deg_s(control.max_tilt_rad),
            deg_s(control.max_stick_rate_rad_s),
            deg_s(control.max_yaw_rate_rad_s)
        ),
    );
    json["hover_throttle"] = json!(v.hover_throttle());
    json["thrust_to_weight"] = json!(1.0 / v.hover_throttle());
    json["hover_rad_s"] = json!(v.hover_rad_s());
    json["authority_rad_s2"] = json!([roll, pitch, yaw]);
}

/// Lists the delays from a motion to the thrust against it.
fn delays(plant: &Plant, text: &mut String, json: &mut Value) {
    let ms = |s: f64| s * 1e3;
    text.push_str("\n\n  delays, ms");
    write_line(
        text,
        &format!(
            "{:<40}{:.1} prefilter, {:.2} sample to motor, {:.0} rotors (lag)",
            "from a motion to the thrust against it",
            ms(plant.prefilter_delay_s()),
            ms(plant.delay_s),
            ms(plant.lag_s)
        ),
    );
    json["delays_ms"] = json!({
        "prefilter": ms(plant.prefilter_delay_s()), "sample_to_motor": ms(plant.delay_s), "rotor_lag": ms(plant.lag_s),
    });
}

/// Returns name, gains and margin of each loop: for each axis the whole loop, and the rate loop alone.
fn all_loops(plant: &Plant, control: &ControlParams) -> Vec<(String, Loop, Margin)> {
    let axes = [(Axis::Roll, "roll"), (Axis::Pitch, "pitch"), (Axis::Yaw, "yaw")];
    let of_axis = |(axis, name): (Axis, &str)| {
        let gains = Loop::of(control, axis);
        let rate = Loop { k: 0.0, ..gains };
        [(name.to_owned(), gains, plant.margin(&gains)), (format!("{name}_rate"), rate, plant.margin(&rate))]
    };
    axes.into_iter().flat_map(of_axis).collect()
}

/// Lists crossover frequency and phase margin of each loop.
fn loops(plant: &Plant, control: &ControlParams, text: &mut String, json: &mut Value) {
    text.push_str("\n\n  open loops, cut at the rotors");
    json["loops"] = json!({});
    for (name, gains, margin) in all_loops(plant, control) {
        let line = format!(
            "{:<40}crossover {:.2} Hz, phase margin {:.0}°",
            name.replace('_', " "),
            hz(margin.crossover_rad_s),
            margin.phase_deg
        );
        write_line(text, &line);
        json["loops"][name] = json!({
            "crossover_hz": hz(margin.crossover_rad_s), "phase_margin_deg": margin.phase_deg,
            "p": gains.p, "i": gains.i, "d": gains.d, "k": gains.k,
        });
    }
}

fn hz(rad_s: f64) -> f64 {
    rad_s / std::f64::consts::TAU
}

/// Returns a warning for each unusual value, with its consequence.
fn warnings(vehicle: &Vehicle, plant: &Plant) -> Vec<String> {
    let mut warnings = Vec::new();
    let hover = vehicle.params.hover_throttle();
    if hover > 0.6 {
        warnings.push(format!(
            "hover takes {:.0} % of the thrust: little is left to climb or to control the attitude",
            hover * 100.0
        ));
    }
    if hover < 0.12 {
        warnings.push(format!(
            "hover takes {:.0} % of the thrust: 1 % of the throttle stick is {:.0} % of the weight",
            hover * 100.0,
            1.0 / hover
        ));
    }
    for (axis, name) in [(Axis::Roll, "roll"), (Axis::Pitch, "pitch"), (Axis::Yaw, "yaw")] {
        let margin = plant.margin(&Loop::of(&vehicle.control, axis));
        if margin.phase_deg < 35.0 {
            warnings.push(format!(
                "{name} has a phase margin of {:.0}°: it will oscillate; --tune proposes other gains",
                margin.phase_deg
            ));
        }
    }
    for derived in vehicle.derived.iter().filter(|derived| derived.estimate) {
        warnings.push(format!("estimate, not a measurement: {} ({})", derived.what, derived.how));
    }
    warnings
}

/// Returns the gains as the table `[gains]` of a vehicle file.
fn gains_table(control: &ControlParams) -> String {
    let three = |v: flight_core::geometry::Vec3<f32>| format!("[{:?}, {:?}, {:?}]", v.x, v.y, v.z);
    format!(
        "[gains]\ntilt_p = {:?}\nheading_p = {:?}\nrate_p = {}\nrate_i = {}\nrate_d = {}\nmax_integral_rad_s2 = {}\n",
        control.tilt_p,
        control.heading_p,
        three(control.rate_p),
        three(control.rate_i),
        three(control.rate_d),
        three(control.max_integral_rad_s2)
    )
}

/// Proposes gains and flies the scene `steps` with them. Returns whether the flight crashed or overshot too far.
fn proposal(
    arguments: &VehicleArguments,
    vehicle: &Vehicle,
    plant: &Plant,
    text: &mut String,
    json: &mut Value,
) -> Result<bool, InputError> {
    let tuned: Tuned = tune(&vehicle.params, plant, MARGIN_DEG);
    let mut control = vehicle.control;
    tuned.apply_to(&mut control);
    let mut scene = Scene::load_with_vehicle("steps", Some(&arguments.vehicle))?;
    scene.set_control(control)?;
    let mut response = StepResponse::default();
    let outcome = Flight::new(&scene, scene.seed).run(&mut response);
    let step_rad = STEP_STICK_SHARE * f64::from(control.max_tilt_rad);
    let overshoot = response.max_tilt_rad() / step_rad - 1.0;
    let times = response.metrics(step_rad);
    let table = gains_table(&control);
    text.push_str("\n\n  proposed gains, for the vehicle file\n\n");
    text.push_str(&table);
    loops(plant, &control, text, &mut json["proposed"]);
    json["proposed"]["gains"] = json!(table);
    write!(
        text,
        "\n\n  flown in the scene `steps`: doublets of {:.0}°, overshoot {:.0} %, {}",
        step_rad.to_degrees(),
        overshoot * 100.0,
        outcome
            .crash
            .map_or("no crash".into(), |(crash, at_s)| format!("CRASHED at {at_s:.2} s: {}", crash.text())),
    )
    .expect("writing to a String does not fail");
    json["proposed"]["overshoot"] = json!(overshoot);
    json["proposed"]["step"] = json!({ "rise_s": times.rise_s, "settled_s": times.settled_s });
    if let Some(path) = &arguments.report {
        let loops: Vec<(String, f64, f64)> = all_loops(plant, &control)
            .into_iter()
            .map(|(name, _, margin)| (name.replace('_', " "), hz(margin.crossover_rad_s), margin.phase_deg))
            .collect();
        let proposal = Proposal {
            vehicle: &vehicle.name,
            step_rad,
            rotor_limits_rad_s: (vehicle.params.idle_rad_s, vehicle.params.max_rad_s),
            gains: &table,
            loops: &loops,
        };
        step_response::write(path, &proposal, &response)?;
    }
    json["proposed"]["crash"] =
        json!(outcome.crash.map(|(crash, at_s)| format!("{} at {at_s:.3} s", crash.text())));
    Ok(outcome.crash.is_some() || overshoot > MAX_OVERSHOOT)
}
