//! Eq 18 in flight: why the estimator `paper` cannot fly the scene `steps`.
//!
//! In the air an accelerometer measures thrust and drag, not gravity. Thrust lies along the body's z axis at
//! any tilt, so without drag the accelerometer reads level at any tilt, and eq 18 pulls the estimate to level
//! with τ. To hold an estimated tilt φ̂, the vehicle has to turn at φ̂/τ.

use flight_core::STANDARD_GRAVITY;
use flight_core::estimator::{Estimator, EstimatorParams};
use flight_core::geometry::{Quaternion, Vec3, vec3};
use sim_host::dynamics::{GRAVITY, Ground, Mount, State, Vehicle, VehicleParams};
use sim_host::effects::vehicle::{LinearDrag, VehicleEffect};
use sim_host::flight::{Crash, Flight, Observer, StepView};
use sim_host::scene::{BUILT_IN, Scene};

use crate::spread::Spread;
use crate::still::on_os4;

/// Time constant τ of the estimator `paper`, s.
const TAU_S: f64 = 0.97 / 0.03 * 0.01;
/// Drag coefficient A of eqs 11-13 in the scene `steps`, kg/s.
const DRAG_KG_PER_S: f64 = 0.25;

fn in_the_air(effects: Vec<(&'static str, VehicleEffect)>, state: State, speed: f64) -> Vehicle {
    let params = VehicleParams::OS4;
    let mut vehicle = Vehicle::at_rest(params, Mount::Free(Ground::new(&params)), effects, 1e-3);
    vehicle.set_state(State { position: vec3(0.0, 0.0, -100.0), ..state }, [speed; 4]);
    vehicle.command([speed; 4]);
    vehicle
}

fn turned_about_x(angle: f64) -> Quaternion<f64> {
    Quaternion::new(libm::cos(0.5 * angle), libm::sin(0.5 * angle), 0.0, 0.0)
}

#[test]
fn without_drag_the_accelerometer_reads_level_at_any_tilt() {
    let tilts = (0..12).map(|k| turned_about_x(0.5 * f64::from(k)));
    for (k, attitude) in tilts.enumerate() {
        let state = State {
            position: Vec3::ZERO,
            velocity: vec3(3.0, -2.0, 1.0),
            attitude,
            rates: vec3(0.3, -0.2, 0.5),
        };
        let mut vehicle = in_the_air(vec![], state, 150.0 + 10.0 * k as f64);
        for _ in 0..100 {
            let force = vehicle.specific_force();
            assert!(force.x.abs() < 1e-12 && force.y.abs() < 1e-12 && force.z < -4.0, "{force:?}");
            vehicle.advance();
        }
    }
}

/// With drag the accelerometer shows the tilt only as the vehicle gains lateral speed: with T = m/A = 2.6 s,
/// v = g T tan φ (1 − e^(−t/T)), and drag along the body's axes and thrust together give
/// tan φ_shown = sin φ cos φ s/(1 − s sin² φ), s = 1 − e^(−t/T).
#[test]
fn drag_shows_tilt_with_the_time_constant_of_speed() {
    let tilt = 30.0_f64.to_radians();
    let params = VehicleParams::OS4;
    let time_constant_s = params.mass_kg / DRAG_KG_PER_S;
    assert!((time_constant_s - 2.6).abs() < 1e-9);
    // The thrust holds the height.
    let speed = libm::sqrt(params.mass_kg * GRAVITY / (4.0 * params.thrust_coefficient * libm::cos(tilt)));
    let drag = on_os4(&LinearDrag { a_kg_per_s: [DRAG_KG_PER_S; 3] });
    let attitude = turned_about_x(tilt);
    let state = State { position: Vec3::ZERO, velocity: Vec3::ZERO, attitude, rates: Vec3::ZERO };
    let mut vehicle = in_the_air(vec![drag], state, speed);
    let mut shown_deg = vec![];
    for ms in 0..=20_000 {
        let share = 1.0 - libm::exp(-f64::from(ms) * 1e-3 / time_constant_s);
        let (sin, cos) = (libm::sin(tilt), libm::cos(tilt));
        let expected = libm::atan2(sin * cos * share, 1.0 - share * sin * sin);
        let force = vehicle.specific_force();
        let shown = libm::atan2(-force.y, -force.z);
        assert!((shown - expected).abs() < 1e-9, "after {ms} ms: {shown} {expected}");
        shown_deg.push(shown.to_degrees());
        vehicle.advance();
    }
    // Tilt shown after the first half of a doublet, and at the end.
    assert!((shown_deg[700] - 6.2).abs() < 0.05 && (shown_deg[20_000] - 30.0).abs() < 0.05);
}

/// Estimators of the flight code, held at 30° by a loop with an integrator around them, while the accelerometer
/// reads level.
#[test]
fn holding_30_degrees_needs_a_turn_of_93_deg_per_s() {
    let dt_s = 1e-3_f32;
    let held = 30.0_f64.to_radians();
    for (params, tau_s, expected_deg_s) in
        [(EstimatorParams::PAPER, TAU_S, 92.78), (EstimatorParams::FLIGHT, 10.0, 3.0)]
    {
        let mut estimator = Estimator::new(&params).unwrap();
        let level = vec3(0.0, 0.0, -STANDARD_GRAVITY);
        // The estimator `flight` uses its age in place of τ until the age has reached τ.
        for _ in 0..20_000 {
            estimator.update(Vec3::ZERO, level, None, dt_s);
        }
        let (mut rate, mut integral, mut true_roll) = (0.0, 0.0, 0.0);
        let mut half_way = 0.0;
        for k in 0..8000 {
            let error = held - roll(estimator.down());
            integral += 20.0 * error * f64::from(dt_s);
            rate = 10.0 * error + integral;
            estimator.update(vec3(rate as f32, 0.0, 0.0), level, None, dt_s);
            true_roll += rate * f64::from(dt_s);
            if k == 3999 {
                half_way = true_roll;
            }
        }
        let rate_deg_s = rate.to_degrees();
        println!("τ = {tau_s} s: {rate_deg_s:.2} °/s");
        assert!((rate_deg_s / expected_deg_s - 1.0).abs() < 1e-3, "{rate_deg_s}");
        assert!((rate / (held / tau_s) - 1.0).abs() < 1e-3);
        // The true roll continues to rotate.
        assert!(((true_roll - half_way).to_degrees() / (4.0 * expected_deg_s) - 1.0).abs() < 1e-2);
    }
}

/// Returns a built-in scene with some of its text replaced.
fn altered(name: &str, changes: &[(&str, &str)]) -> Scene {
    let built_in = BUILT_IN.iter().find(|scene| scene.name == name).expect("a built-in scene").text;
    let text = changes.iter().fold(built_in.to_owned(), |text, (from, to)| {
        assert!(text.contains(from), "{name} has no {from}");
        text.replacen(from, to, 1)
    });
    Scene::parse(name, &text).unwrap_or_else(|error| panic!("{error}"))
}

const PAPER: (&str, &str) = ("[flight]\n", "[flight]\nestimator = \"paper\"\n");
const NO_DRAG: (&str, &str) = ("[effects.vehicle.linear_drag]\n", "");
/// The first half of the first doublet lasts 2 s; the second half follows it.
const HELD_2_S: [(&str, &str); 2] =
    [("at_s = 14.0\nfor_s = 0.7", "at_s = 14.0\nfor_s = 2.0"), ("at_s = 14.7", "at_s = 16.0")];

/// Start of the first half of the first doublet, s.
const FIRST_HALF_S: f64 = 14.0;

/// Largest true tilt in the first doublet, degrees.
#[derive(Default)]
struct FirstDoublet(f64);

impl Observer for FirstDoublet {
    fn step(&mut self, view: &StepView) {
        let after_s = view.time_us as f64 * 1e-6 - FIRST_HALF_S;
        if (0.0..1.4).contains(&after_s) {
            self.0 = self.0.max(libm::acos(view.truth.cos_tilt()).to_degrees());
        }
    }
}

#[test]
fn steps_crashes_with_paper_and_flies_with_flight() {
    let fly = |changes: &[(&str, &str)], seed| {
        let mut doublet = FirstDoublet::default();
        let outcome = Flight::new(&altered("steps", changes), seed).run(&mut doublet);
        println!("seed {seed}: {:?}, {:.1}° in the first doublet", outcome.crash, doublet.0);
        (outcome, doublet.0)
    };
    for seed in [7, 8, 9] {
        // The sticks command 30°.
        let (outcome, doublet_deg) = fly(&[PAPER], seed);
        assert!(outcome.crash.is_some() && (45.0..60.0).contains(&doublet_deg), "{outcome:?}");
        let (outcome, doublet_deg) = fly(&[], seed);
        assert!(outcome.crash.is_none() && (29.0..35.0).contains(&doublet_deg), "{outcome:?}");
        assert!(outcome.tilt_error_max_deg < 3.0, "{outcome:?}");
    }
}

#[test]
fn hover_with_paper_stays_within_half_a_metre() {
    let outcome = Flight::new(&altered("hover", &[PAPER]), 7).run(&mut ());
    assert!(outcome.crash.is_none() && outcome.position_error_max_m < 0.5, "{outcome:?}");
    assert!(outcome.attitude_rmse_deg < 1.0, "{outcome:?}");
}

/// Roll of a down direction in body axes, rad.
fn roll(down: Vec3<f32>) -> f64 {
    libm::atan2(f64::from(down.y), f64::from(down.z))
}

/// True roll rate and estimated roll from 0.8 to 1.0 s after the step, when both are settled.
#[derive(Default)]
struct Turning {
    rate: Spread,
    estimate: Spread,
}

impl Observer for Turning {
    fn step(&mut self, view: &StepView) {
        let after_s = view.time_us as f64 * 1e-6 - FIRST_HALF_S;
        if after_s > 0.8 && after_s < 1.0 {
            self.rate.add(view.truth.rates.x.to_degrees());
            self.estimate.add(roll(view.output.attitude.down()).to_degrees());
        }
    }
}

/// A lasting step of 30°. The angle loop commands the rate P (30° − φ̂). Without drag φ̂ settles with the rate
/// constant P + 1/τ where the commanded rate equals φ̂/τ, and the vehicle continues to turn at 30°/(τ + 1/P).
#[test]
fn a_30_degree_step_of_2_s_on_paper_passes_90_degrees() {
    let [first, second] = HELD_2_S;
    let fly = |changes: &[(&str, &str)]| {
        let scene = altered("steps", changes);
        let mut turning = Turning::default();
        let outcome = Flight::new(&scene, scene.seed).run(&mut turning);
        let Some((Crash::TippedOver, at_s)) = outcome.crash else { panic!("{outcome:?}") };
        let (rate, estimate) = (turning.rate.mean(), turning.estimate.mean());
        println!("{rate:.1} °/s, estimate {estimate:.1}°, 90° after {:.2} s", at_s - FIRST_HALF_S);
        (rate, estimate, at_s - FIRST_HALF_S)
    };
    let p = f64::from(altered("steps", &[]).config.params.control.tilt_p);
    assert_eq!(p, 5.5, "docs/paper.md gives figures for this gain");
    let expected_rate = 30.0 / (TAU_S + 1.0 / p);
    let expected_estimate = expected_rate * TAU_S;
    // The rate starts at 30° P and falls to the settled rate.
    let head_start = (30.0 * p - expected_rate) / (p + 1.0 / TAU_S);
    let expected_s = (90.0 - head_start) / expected_rate;
    println!("expected {expected_rate:.1} °/s, {expected_estimate:.1}°, {expected_s:.2} s");

    let (rate, estimate, passes_at_s) = fly(&[PAPER, first, second, NO_DRAG]);
    assert!((rate / expected_rate - 1.0).abs() < 0.03 && (estimate / expected_estimate - 1.0).abs() < 0.03);
    // The rate loop takes a tenth of a second to follow.
    assert!((passes_at_s - expected_s).abs() < 0.1);
    // Drag slows the turn down but does not prevent it.
    let (rate, _, passes_at_s) = fly(&[PAPER, first, second]);
    assert!(rate < expected_rate && passes_at_s < 2.0);
}

/// The estimators `paper` and `flight`, without a prefilter, in parallel to a flight that another estimator controls.
struct ParallelEstimators {
    rate_per_count: f32,
    force_per_count: f32,
    filters: [Estimator; 2],
    /// The error by the closed form: the true roll minus the roll that the accelerometer shows, low-passed
    /// with τ.
    predicted: [f64; 2],
    /// Largest error of each, largest difference from the closed form, rad, and the spread of the error over the
    /// doublet.
    worst: [f64; 2],
    worst_difference: [f64; 2],
    over_doublet: [Spread; 2],
}

impl Observer for ParallelEstimators {
    fn step(&mut self, view: &StepView) {
        let dt_s = if view.time_us == 0 { 0.0 } else { 1e-3 };
        let sample = view.input.imu.expect("the IMU is sampled at every step");
        let gyro = Vec3::from(sample.gyro.map(f32::from)) * self.rate_per_count;
        let accel = Vec3::from(sample.accel.map(f32::from)) * self.force_per_count;
        let [_, y, z] = sample.accel.map(f64::from);
        let truth = view.truth.attitude.down();
        let (true_roll, shown) = (libm::atan2(truth.y, truth.z), libm::atan2(-y, -z));
        let t_s = view.time_us as f64 * 1e-6;
        for (n, tau_s) in [TAU_S, 10.0].into_iter().enumerate() {
            self.filters[n].update(gyro, accel, None, dt_s);
            self.predicted[n] += (true_roll - shown - self.predicted[n]) * f64::from(dt_s) / tau_s;
            // From the doublet until the vehicle is level again.
            if (FIRST_HALF_S..FIRST_HALF_S + 3.0).contains(&t_s) {
                let error = true_roll - roll(self.filters[n].down());
                self.worst[n] = self.worst[n].max(error.abs());
                let difference = (error - self.predicted[n]).abs();
                self.worst_difference[n] = self.worst_difference[n].max(difference);
                if t_s < FIRST_HALF_S + 1.4 {
                    self.over_doublet[n].add(error);
                }
            }
        }
    }
}

/// Compares eq 18's error e in the doublets of the scene `steps` with its differential equation
/// e' = (φ − φ_shown − e)/τ. φ is the true tilt, and φ_shown is the tilt that the accelerometer shows (φ_f in
/// docs/paper.md). The equation holds whichever estimator controls the flight, and does not depend on the gyroscope.
///
/// For a sudden tilt of 30°, φ − φ_shown = 30° e^(−t/T) with T = m/A = 2.6 s. So after t = 0.7 s
/// e = 30° T/(T − τ) (e^(−t/T) − e^(−t/τ)), which is 22.2° with the estimator `paper` and 1.8° with `flight`.
#[test]
fn doublets_of_steps_mislead_paper_by_22_deg_flight_by_2() {
    let scene = altered("steps", &[]);
    let filter = |params| Estimator::new(&params).unwrap_or_else(|error| panic!("{error}"));
    let [gyro, accel, _] = scene.converters.map(|c| c.per_count() as f32);
    let mut parallel = ParallelEstimators {
        rate_per_count: gyro,
        force_per_count: accel,
        filters: [filter(EstimatorParams::PAPER), filter(EstimatorParams::FLIGHT)],
        predicted: [0.0; 2],
        worst: [0.0; 2],
        worst_difference: [0.0; 2],
        over_doublet: [Spread::default(); 2],
    };
    let outcome = Flight::new(&scene, scene.seed).run(&mut parallel);
    assert_eq!(outcome.crash, None);
    let step = |tau_s: f64, t: f64| {
        let long = 0.65 / DRAG_KG_PER_S;
        30.0 * long / (long - tau_s) * (libm::exp(-t / long) - libm::exp(-t / tau_s))
    };
    assert!((step(TAU_S, 0.7) - 22.2).abs() < 0.1 && (step(10.0, 0.7) - 1.8).abs() < 0.1);
    for n in 0..2 {
        let [worst, difference] = [parallel.worst[n], parallel.worst_difference[n]].map(f64::to_degrees);
        let rms =
            libm::hypot(parallel.over_doublet[n].deviation(), parallel.over_doublet[n].mean()).to_degrees();
        println!(
            "{n}: worst {worst:.2}°, {rms:.2}° RMS over the doublet, {difference:.2}° from the closed form"
        );
    }
    let [paper, flight] = parallel.worst.map(f64::to_degrees);
    assert!((paper - 22.5).abs() < 1.0 && (flight - 1.9).abs() < 0.3, "{paper} {flight}");
    assert!(parallel.worst_difference.iter().all(|d| d.to_degrees() < 0.5));
}
