//! A day of simulated flight, 86.4 million steps: quantities that must not drift.
//!
//! Time, norms, energy and errors are averaged in 24 stretches of the flight, each compared with the first one of pure
//! hover. A sum in f32, a filter whose state is too large for its small inputs, or a drifting integrator shows as a
//! drift from stretch to stretch. The estimator is a complementary filter without a covariance; its error against the
//! truth is checked instead.

use std::f64::consts::TAU;

use flight_core::ArmState;
use flight_core::geometry::{Quaternion, Vec3, vec3};
use sim_host::dynamics::{GRAVITY, Mount, State, Vehicle, VehicleParams};
use sim_host::flight::{Flight, Observer, Outcome, StepView};
use sim_host::scene::Scene;

const STRETCHES: usize = 24;

/// Sums over a stretch of the flight.
#[derive(Clone, Copy, Debug, Default)]
struct Stretch {
    steps: f64,
    height_m: f64,
    /// Potential and kinetic energy per mass, J/kg.
    energy_j_kg: f64,
    /// Sum of the squared errors of the estimate, rad².
    error_squared: f64,
    /// Sum of the estimated heading, rad.
    heading_rad: f64,
    pulse_us: f64,
}

impl Stretch {
    fn mean(&self) -> Self {
        let of = |sum: f64| sum / self.steps;
        Self {
            steps: 1.0,
            height_m: of(self.height_m),
            energy_j_kg: of(self.energy_j_kg),
            error_squared: of(self.error_squared),
            heading_rad: of(self.heading_rad),
            pulse_us: of(self.pulse_us),
        }
    }
}

struct DriftRecorder {
    from_us: u64,
    stretch_us: u64,
    stretches: [Stretch; STRETCHES],
    time_error_s: f64,
    truth_norm_error: f64,
    estimate_norm_error: f64,
}

impl Observer for DriftRecorder {
    fn step(&mut self, view: &StepView) {
        let time_s = view.time_us as f64 * 1e-6;
        self.time_error_s = self.time_error_s.max((view.snapshot.time_s - time_s).abs());
        let off = |q: Quaternion<f64>| (libm::sqrt(q.norm_squared()) - 1.0).abs();
        self.truth_norm_error = self.truth_norm_error.max(off(view.truth.attitude));
        self.estimate_norm_error = self.estimate_norm_error.max(off(view.estimate));
        let since_us = view.time_us.checked_sub(self.from_us);
        let Some(stretch) =
            since_us.and_then(|since_us| self.stretches.get_mut((since_us / self.stretch_us) as usize))
        else {
            return;
        };
        let error = view.estimate * view.truth.attitude.conjugate();
        let sine = 2.0 * error.v.norm();
        let [w, x, y, z] = view.estimate.to_array();
        stretch.steps += 1.0;
        stretch.height_m -= view.truth.position.z;
        stretch.energy_j_kg +=
            0.5 * view.truth.velocity.dot(view.truth.velocity) - GRAVITY * view.truth.position.z;
        stretch.error_squared += sine * sine;
        stretch.heading_rad += libm::atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z));
        stretch.pulse_us += view.output.pulses_us.iter().map(|us| 0.25 * f64::from(*us)).sum::<f64>();
    }
}

/// Flies the scene `hover` for `duration_s`, and records the stretches between a minute after take-off and the landing.
fn hover_for(duration_s: f64) -> (Outcome, DriftRecorder) {
    let mut scene = Scene::load("hover").unwrap();
    scene.set_duration(duration_s).unwrap();
    let (from_us, land_us) = (65_000_000, ((duration_s - 8.0) * 1e6) as u64);
    let mut recorder = DriftRecorder {
        from_us,
        stretch_us: (land_us - from_us) / STRETCHES as u64,
        stretches: [Stretch::default(); STRETCHES],
        time_error_s: 0.0,
        truth_norm_error: 0.0,
        estimate_norm_error: 0.0,
    };
    let outcome = Flight::new(&scene, scene.seed).run(&mut recorder);
    (outcome, recorder)
}

/// Checks a flight of `duration_s`, whose stretches are `length` times an hour long. Some bounds do not depend on the
/// length, those of the stretches' means do. For a quantity that is held (height, and the throttle that holds it), the
/// swings leave the same rest in every stretch, which is divided by its length: the means differ by 1/length of an
/// hour's. The heading is not held but measured, with noise whose mean goes with 1/√length.
fn judge(duration_s: f64, length: f64) {
    let (outcome, recorder) = hover_for(duration_s);
    assert_eq!((outcome.crash, outcome.final_state), (None, ArmState::Disarmed));
    assert_eq!(outcome.control_steps as f64, duration_s * 1e3);
    let means = recorder.stretches.map(|stretch| stretch.mean());
    let spread = |of: fn(&Stretch) -> f64| {
        means.iter().map(|m| of(m) - of(&means[0])).fold(0.0, |a: f64, b| a.max(b.abs()))
    };
    let height_m = spread(|m| m.height_m);
    let energy_j_kg = spread(|m| m.energy_j_kg);
    let heading_deg = spread(|m| m.heading_rad).to_degrees();
    let pulse_us = spread(|m| m.pulse_us);
    let errors_deg = means.map(|m| libm::sqrt(m.error_squared).to_degrees());
    let (min, max) =
        errors_deg.iter().fold((f64::INFINITY, 0.0), |(a, b): (f64, f64), x| (a.min(*x), b.max(*x)));
    println!(
        "{duration_s} s: time off by {:e} s, norms by {:e} (truth) and {:e} (estimate); from stretch to stretch height \
         {height_m:e} m, energy {energy_j_kg:e} J/kg, heading {heading_deg:e}°, pulse {pulse_us:e} µs, error {min:.4}° to \
         {max:.4}°",
        recorder.time_error_s, recorder.truth_norm_error, recorder.estimate_norm_error
    );
    // The time in s is rounded once at the end; norms are those of f64 and of f32.
    assert!(recorder.time_error_s <= duration_s * f64::EPSILON);
    assert!(recorder.truth_norm_error <= 4.0 * f64::EPSILON);
    assert!(recorder.estimate_norm_error <= f64::from(f32::EPSILON));
    // Bounds are three to four times the drift of a day. Here energy is height times gravity.
    let noise = 1.0 / length;
    for (what, drift, bound) in [
        ("height, m", height_m, 2e-6 * noise),
        ("energy, J/kg", energy_j_kg, 2.1e-5 * noise),
        ("heading, °", heading_deg, 8e-4 * libm::sqrt(noise)),
        ("pulse, µs", pulse_us, 1.2e-4 * noise),
    ] {
        assert!(drift <= bound, "{what}: drift {drift:e} from stretch to stretch, bound {bound:e}");
    }
    // Error of heading and tilt together. It includes the bias that was left when the gyroscope was zeroed.
    assert!(max <= 0.35, "{max}");
    assert!(length < 1.0 || max - min <= 0.05, "{min} to {max}");
}

#[test]
fn ten_minutes_of_hover_drift_within_bounds() {
    judge(600.0, 600.0 / 86_400.0);
}

#[test]
#[ignore = "a day of flight: 86.4 million steps, more than a minute; .ci/nightly runs it"]
fn day_of_hover_does_not_drift() {
    let before_kb = peak_memory_kb();
    judge(86_400.0, 1.0);
    if let (Some(before_kb), Some(after_kb)) = (before_kb, peak_memory_kb()) {
        println!("peak memory {before_kb} KB before, {after_kb} KB after");
        // One byte per step would be 84,375 KB.
        assert!(after_kb - before_kb < 4_096, "{before_kb} KB before, {after_kb} KB after");
    }
}

/// Returns the peak memory of this process so far, KB, if the system reports it.
fn peak_memory_kb() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    line.trim().strip_suffix(" kB")?.parse().ok()
}

/// Lets the vehicle tumble freely about its centre; returns the relative errors of energy and of angular momentum in
/// the world.
fn tumble(steps: u64) -> (f64, f64) {
    let params = VehicleParams { inertia_kg_m2: vec3(7.5e-3, 9.0e-3, 13.0e-3), ..VehicleParams::OS4 };
    let mut vehicle = Vehicle::at_rest(params, Mount::BallJoint, vec![], 1e-3);
    let rates = vec3(0.1, TAU, 0.1);
    vehicle.set_state(State { rates, ..*vehicle.state() }, [0.0; 4]);
    let energy = |state: &State| 0.5 * state.rates.dot(state.rates.scale_by(params.inertia_kg_m2));
    let momentum =
        |state: &State| -> Vec3<f64> { state.attitude.rotate(state.rates.scale_by(params.inertia_kg_m2)) };
    let (energy_0, momentum_0) = (energy(vehicle.state()), momentum(vehicle.state()));
    for _ in 0..steps {
        vehicle.advance();
    }
    let state = vehicle.state();
    ((energy(state) / energy_0 - 1.0).abs(), (momentum(state) - momentum_0).norm() / momentum_0.norm())
}

fn check_tumbling(steps: u64) {
    let (energy, momentum) = tumble(steps);
    println!("{steps} steps of tumbling: relative error of energy {energy:e}, of momentum {momentum:e}");
    // Rounding errors grow with the root of the number of steps; the bounds are three times the errors of a day.
    let walk = f64::EPSILON * libm::sqrt(steps as f64);
    assert!(energy <= 8.0 * walk && momentum <= 24.0 * walk, "{energy:e} {momentum:e}, random walk {walk:e}");
}

#[test]
fn ten_minutes_of_tumbling_keep_energy_and_momentum() {
    check_tumbling(600_000);
}

#[test]
#[ignore = "a day of tumbling: 86.4 million steps, half a minute; .ci/nightly runs it"]
fn day_of_tumbling_keeps_energy_and_momentum() {
    check_tumbling(86_400_000);
}
