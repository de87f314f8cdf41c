//! The drift of the heading in coning motion, through the whole flight controller.
//!
//! The vertical body axis describes a cone of 1°, 50 times a second (Goodman and Robinson, *ASME Journal of Applied
//! Mechanics* 25, 1958). The rates about the horizontal axes oscillate and their mean is zero, but the vehicle turns
//! about the vertical in the mean. A prefilter takes the oscillation away and leaves the turn, which nothing then
//! explains: ½ a² ω = 0.0478 rad/s.

use std::f64::consts::TAU;

use flight_core::calibration::{Calibration, Sensitivity};
use flight_core::estimator::EstimatorParams;
use flight_core::geometry::{Mat3, Quaternion};
use flight_core::sample::{Health, ImuSample, Input};
use flight_core::{Config, FlightController, Params};

const CONE_RAD: f64 = TAU / 360.0;
const CONE_RAD_S: f64 = 50.0 * TAU;
const STEP_S: f64 = 0.001;

/// True attitude: a rotation by the cone's angle about an axis that rotates in the horizontal plane.
fn attitude(t_s: f64) -> Quaternion<f64> {
    let ((half, cos_half), (sin, cos)) = (libm::sincos(0.5 * CONE_RAD), libm::sincos(CONE_RAD_S * t_s));
    Quaternion::new(cos_half, half * cos, half * sin, 0.0)
}

/// Mean body rates over the step that ends at this time, rad/s: the exact integral of the rates.
fn rates(t_s: f64) -> [f64; 3] {
    let half = libm::sin(0.5 * CONE_RAD);
    let (before, now) = (libm::sincos(CONE_RAD_S * (t_s - STEP_S)), libm::sincos(CONE_RAD_S * t_s));
    let side = libm::sin(CONE_RAD) / STEP_S;
    [side * (now.1 - before.1), side * (now.0 - before.0), -2.0 * half * half * CONE_RAD_S]
}

/// Returns the drift of the heading, °/h.
fn drift_deg_h(estimator: EstimatorParams) -> f64 {
    let mut params = Params { estimator, ..Params::default() };
    // The constant rate about the vertical is a whole number of counts, so that rounding causes no drift: 240 counts.
    let per_count = rates(0.0)[2].abs() / 240.0;
    params.gyro = Sensitivity { per_count: per_count as f32, mounting: Mat3::IDENTITY };
    let config = Config { params, calibration: Some(Calibration::NONE) };
    let mut controller = FlightController::new(&config).unwrap();
    let mut heading_error = [0.0; 2];
    for step in 1..=70_000_u32 {
        let t_s = f64::from(step) * STEP_S;
        let truth = attitude(t_s);
        let down = truth.conjugate().rotate([0.0, 0.0, -2048.0].into());
        let imu = ImuSample {
            gyro: rates(t_s).map(|rate| (rate / per_count).round() as i16),
            accel: <[f64; 3]>::from(down).map(|counts| counts.round() as i16),
        };
        let (time_us, imu) = (u64::from(step) * 1000, Some(imu));
        let health = Health::default();
        controller.step(&Input { time_us, imu, mag: None, rc: None, battery: None, bench: None, health });
        let [w, x, y, z] = controller.attitude().to_array().map(f64::from);
        let error = Quaternion::new(w, x, y, z) * truth.conjugate();
        let [w, _, _, z] = error.to_array();
        heading_error[usize::from(step > 10_000)] = 2.0 * libm::atan2(z, w);
    }
    let turns = libm::remainder(heading_error[1] - heading_error[0], TAU);
    turns.to_degrees().abs() / 60.0 * 3600.0
}

/// One sample for each update leaves ½ a² ω (1 − sin ωΔt/(ωΔt)) = 161.5 °/h: the turn within a step, which the
/// rotation vector of its mean rates does not contain.
#[test]
fn calibrated_rates_leave_only_the_error_of_the_step() {
    let turned = CONE_RAD_S * STEP_S;
    let share = 1.0 - libm::sin(turned) / turned;
    let exact = (0.5 * CONE_RAD * CONE_RAD * CONE_RAD_S * share).to_degrees() * 3600.0;
    assert!((exact - 161.5).abs() < 0.1, "{exact}");
    let drift = drift_deg_h(EstimatorParams::ROBUST);
    println!("robust: {drift:.1} °/h");
    assert!((drift - exact).abs() < 3.5, "{drift}");
}

/// The paper's order, prefilter before estimator, leaves nearly the whole turn: 9,870 °/h without any oscillation left.
#[test]
fn prefiltered_rates_drift_by_the_turn() {
    let turn = (0.5 * CONE_RAD * CONE_RAD * CONE_RAD_S).to_degrees() * 3600.0;
    let drift = drift_deg_h(EstimatorParams::PAPER);
    println!("paper: {drift:.0} °/h of {turn:.0}");
    assert!(drift > 0.8 * turn && drift < turn, "{drift} {turn}");
}
