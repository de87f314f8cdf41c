//! Demands beyond the rotors' limits, and integrator windup.

use flight_core::ArmState;
use flight_core::control::{ControlParams, Controller};
use flight_core::geometry::{Vec3, vec3};
use flight_core::mixer::{Airframe, Mixer, Saturation, Wrench};
use flight_core::rc::{FlightMode, Sticks};
use proptest::prelude::*;
use sim_host::flight::Flight;
use sim_host::scene::Scene;

/// Signs of thrust, roll, pitch and yaw in the squared speed of each rotor.
const SIGNS: [[f64; 4]; 4] =
    [[1.0, 1.0, 1.0, 1.0], [1.0, -1.0, 1.0, -1.0], [1.0, -1.0, -1.0, 1.0], [1.0, 1.0, -1.0, -1.0]];

/// Returns the demand in squared speeds: thrust, roll, pitch, yaw.
fn in_squares(demand: &Wrench) -> [f64; 4] {
    let a = Airframe::OS4;
    let (b, d, l) =
        (f64::from(a.thrust_coefficient), f64::from(a.torque_coefficient), f64::from(a.forward_m));
    let tilt = 1.0 / (4.0 * b * l);
    let [x, y, z] = <[f32; 3]>::from(demand.torque_n_m).map(f64::from);
    [f64::from(demand.thrust_n) / (4.0 * b), x * tilt, y * tilt, z / (4.0 * d)]
}

/// Returns the largest x in [0, 1] for which some y satisfies every constraint p x + q y ≤ r: a linear program in two
/// unknowns, solved by its vertices.
fn largest(constraints: &[[f64; 3]]) -> Option<f64> {
    let mut all = constraints.to_vec();
    all.extend([[1.0, 0.0, 1.0], [-1.0, 0.0, 0.0]]);
    let feasible = |x: f64, y: f64| all.iter().all(|[p, q, r]| p * x + q * y <= r + 1e-6 * (1.0 + r.abs()));
    let mut best = None;
    for (i, [p1, q1, r1]) in all.iter().enumerate() {
        for [p2, q2, r2] in &all[i + 1..] {
            let det = p1 * q2 - p2 * q1;
            if det.abs() < 1e-12 {
                continue;
            }
            let (x, y) = ((r1 * q2 - r2 * q1) / det, (p1 * r2 - p2 * r1) / det);
            if feasible(x, y) && best.is_none_or(|best| x > best) {
                best = Some(x);
            }
        }
    }
    best
}

/// Returns the squared speeds by the priorities in the mixer's documentation: the largest share of roll and pitch that
/// any collective allows, then the largest share of yaw with it, then the collective nearest to the demanded one.
fn optimum(demand: &Wrench) -> ([f64; 4], [f64; 2]) {
    let a = Airframe::OS4;
    let (low, high) = (f64::from(a.idle_rad_s).powi(2), f64::from(a.max_rad_s).powi(2));
    let [thrust, roll, pitch, yaw] = in_squares(demand);
    let tilt = SIGNS.map(|[_, r, p, _]| r * roll + p * pitch);
    let rows = |of: &dyn Fn(usize) -> f64, fixed: &dyn Fn(usize) -> f64| -> Vec<[f64; 3]> {
        (0..4).flat_map(|n| [[of(n), 1.0, high - fixed(n)], [-of(n), -1.0, fixed(n) - low]]).collect()
    };
    let tilt_share = largest(&rows(&|n| tilt[n], &|_| 0.0)).unwrap();
    let yaw_share = largest(&rows(&|n| SIGNS[n][3] * yaw, &|n| tilt_share * tilt[n])).unwrap();
    let offsets: Vec<f64> = (0..4).map(|n| tilt_share * tilt[n] + yaw_share * SIGNS[n][3] * yaw).collect();
    let max = offsets.iter().copied().fold(f64::MIN, f64::max);
    let min = offsets.iter().copied().fold(f64::MAX, f64::min);
    let collective = thrust.min(high - max).max(low - min);
    ([0, 1, 2, 3].map(|n| collective + offsets[n]), [tilt_share, yaw_share])
}

fn check_optimum(demand: Wrench) -> Result<(), TestCaseError> {
    let mixer = Mixer::new(&Airframe::OS4).unwrap();
    let (squares, _) = mixer.mix(&demand);
    let (best, shares) = optimum(&demand);
    // In f32 the result loses some ε of numbers as large as the demand's.
    let size = in_squares(&demand).into_iter().fold(1e5, |size: f64, part| size.max(part.abs()));
    for (got, best) in squares.into_iter().zip(best) {
        let off = (f64::from(got) - best).abs();
        prop_assert!(off < 4e-6 * size, "{demand:?}: {squares:?}, {best}, shares {shares:?}");
    }
    Ok(())
}

#[test]
fn mixer_at_command_corners_equals_the_linear_program() {
    let limit = 1.04_f32;
    for thrust_n in [0.0, 3.0, 6.4, 12.74, -5.0, 100.0] {
        for x in [-2.0 * limit, -limit, -0.5 * limit, 0.0, 0.5 * limit, limit, 2.0 * limit] {
            for y in [-2.0 * limit, -limit, 0.0, 0.7 * limit, limit] {
                for z in [-0.3, -0.153, 0.0, 0.05, 0.153, 0.3] {
                    check_optimum(Wrench { thrust_n, torque_n_m: vec3(x, y, z) }).unwrap();
                }
            }
        }
    }
}

proptest! {
    #[test]
    fn mixer_of_any_demand_equals_the_linear_program(
        thrust_n in -10.0_f32..30.0, x in -3.0_f32..3.0, y in -3.0_f32..3.0, z in -0.6_f32..0.6,
    ) {
        check_optimum(Wrench { thrust_n, torque_n_m: vec3(x, y, z) })?;
    }
}

#[test]
fn integrator_stays_in_its_limit_in_a_minute_of_windup() {
    // The vehicle is held at 30° for a minute: the integrator goes to its limit and no further.
    let params = ControlParams::OS4;
    let inertia = Airframe::OS4.inertia_kg_m2;
    let mut controller = Controller::new(&params, inertia).unwrap();
    controller.set_sticks(&Sticks { throttle: 0.5, roll: 0.0, pitch: 0.0, yaw: 0.0 }, FlightMode::Angle);
    let (sin, cos) = 0.5_f32.sin_cos();
    let held = |controller: &mut Controller| {
        controller.step(vec3(0.0, sin, cos), 0.0, Vec3::ZERO, Saturation::default(), 1e-3)
    };
    let first = held(&mut controller);
    let mut torque = first;
    for _ in 0..60_000 {
        torque = held(&mut controller);
        assert!(torque.dot(torque).is_finite());
    }
    let wound = (torque.x - first.x).abs() / inertia.x;
    assert!(wound <= params.max_integral_rad_s2.x * 1.01, "{wound}");
    // While the mixer saturates, the integrator does not wind up at all.
    let mut cut = Controller::new(&params, inertia).unwrap();
    cut.set_sticks(&Sticks { throttle: 0.5, roll: 0.0, pitch: 0.0, yaw: 0.0 }, FlightMode::Angle);
    let full = Saturation { roll_pitch: true, yaw: true };
    let one = cut.step(vec3(0.0, sin, cos), 0.0, Vec3::ZERO, full, 1e-3);
    let last = (0..60_000).fold(one, |_, _| cut.step(vec3(0.0, sin, cos), 0.0, Vec3::ZERO, full, 1e-3));
    assert_eq!(one, last);
}

#[test]
fn motors_slower_than_a_control_step_fly() {
    // 50 ms of lag are fifty control steps. At 150 ms the loop with the default gains is slow but stable.
    for tau_s in [0.001, 0.02, 0.1, 0.15] {
        let text = format!("include = \"steps\"\n[effects.vehicle.motor_lag]\ntau_s = {tau_s}\n");
        let scene = Scene::parse("slow.toml", &text).unwrap();
        let outcome = Flight::new(&scene, 1).run(&mut ());
        assert_eq!((outcome.crash, outcome.final_state), (None, ArmState::Disarmed), "{tau_s}: {outcome:?}");
    }
}
