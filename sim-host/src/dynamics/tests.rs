use super::*;
use crate::effects::vehicle::{LinearDrag, MotorLag, RotorGyroscopic};
use crate::effects::{BuildContext, EffectParams};
use proptest::prelude::*;

mod effects;

const STEP_S: f64 = 1e-3;

type Effects = Vec<(&'static str, VehicleEffect)>;

/// Builds an effect for OS4 at this step.
fn built(params: &impl EffectParams<Effect = VehicleEffect>, step_s: f64) -> (&'static str, VehicleEffect) {
    params.validate("test").unwrap();
    let context = BuildContext {
        name: "test",
        seed: 1,
        rate_hz: 1.0 / step_s,
        duration_s: 60.0,
        vehicle: &VehicleParams::OS4,
    };
    ("test", params.build(&context))
}

fn lag(tau_s: f64, step_s: f64) -> (&'static str, VehicleEffect) {
    built(&MotorLag { tau_s, tau_down_s: None }, step_s)
}

fn drag(step_s: f64) -> (&'static str, VehicleEffect) {
    built(&LinearDrag { a_kg_per_s: [0.25; 3] }, step_s)
}

fn on_the_ground(mut effects: Effects) -> Vehicle {
    let ground = Ground::new(&VehicleParams::OS4);
    effects.push(lag(0.05, STEP_S));
    Vehicle::at_rest(VehicleParams::OS4, Mount::Free(ground), effects, STEP_S)
}

fn in_the_air(effects: Effects) -> Vehicle {
    let mut v = on_the_ground(effects);
    v.set_state(State { position: vec3(0.0, 0.0, -100.0), ..*v.state() }, [0.0; 4]);
    v
}

fn hover_rad_s() -> f64 {
    libm::sqrt(0.65 * GRAVITY / (4.0 * 3.13e-5))
}

fn run(v: &mut Vehicle, seconds: f64) {
    for _ in 0..(seconds / STEP_S).round() as u32 {
        v.advance();
    }
}

fn half_angles(a: f64) -> (f64, f64) {
    ((0.5 * a).sin(), (0.5 * a).cos())
}

fn euler(roll: f64, pitch: f64, yaw: f64) -> Quaternion<f64> {
    Quaternion::from_half_angles(half_angles(roll), half_angles(pitch), half_angles(yaw))
}

#[test]
fn vehicle_on_the_ground_stays_and_reads_1_g() {
    let mut v = on_the_ground(vec![]);
    let start = *v.state();
    for _ in 0..10_000 {
        v.advance();
        assert!((v.specific_force() - vec3(0.0, 0.0, -GRAVITY)).norm() < 1e-9);
    }
    assert!((v.state().position - start.position).norm() < 1e-12 && v.state().rates.norm() < 1e-12);
    assert!(v.touches_ground());
}

#[test]
fn free_fall_reads_zero_and_drops_half_g_t_squared() {
    let mut v = in_the_air(vec![]);
    run(&mut v, 2.0);
    assert!((v.state().position.z + 100.0 - 0.5 * GRAVITY * 4.0).abs() < 1e-9);
    assert!(v.specific_force().norm() < 1e-12);
}

#[test]
fn hover_speed_holds_and_reads_one_g() {
    let mut v = in_the_air(vec![]);
    let speed = hover_rad_s();
    assert!((speed - 225.7).abs() < 0.1);
    v.set_state(*v.state(), [speed; 4]);
    v.command([speed; 4]);
    run(&mut v, 5.0);
    assert!((v.state().position.z + 100.0).abs() < 1e-9);
    assert!((v.specific_force() - vec3(0.0, 0.0, -GRAVITY)).norm() < 1e-9);
}

#[test]
fn linear_drag_reaches_terminal_velocity() {
    // v(t) = (m g/A)(1 − exp(−A t/m))
    let mut v = in_the_air(vec![drag(STEP_S)]);
    run(&mut v, 3.0);
    let exact = 0.65 * GRAVITY / 0.25 * (1.0 - libm::exp(-0.25 * 3.0 / 0.65));
    assert!((v.state().velocity.z - exact).abs() < 1e-9, "{} {exact}", v.state().velocity.z);
}

#[test]
fn rotors_lag_exponentially_at_any_time_constant() {
    for tau_s in [0.05, 1e-4] {
        let ground = Ground::new(&VehicleParams::OS4);
        let effects = vec![lag(tau_s, 0.01)];
        let mut v = Vehicle::at_rest(VehicleParams::OS4, Mount::Free(ground), effects, 0.01);
        v.command([200.0; 4]);
        v.advance();
        let exact = 200.0 * (1.0 - libm::exp(-0.01 / tau_s));
        assert!((v.rotors()[0] - exact).abs() < 1e-9);
    }
}

/// Returns the angular accelerations from rates and rotor speeds by eqs 8-10 as printed, with the missing dots added.
fn printed_8_to_10(rates: Vec3<f64>, rotors: [f64; 4]) -> Vec3<f64> {
    let (ixx, iyy, izz, jr, l) = (7.5e-3, 7.5e-3, 1.3e-2, 6e-5, 0.23);
    let [s1, s2, s3, s4] = rotors.map(|w| w * w);
    let lever = 3.13e-5 * std::f64::consts::FRAC_PI_4.sin();
    let (u2, u3, u4) =
        (lever * (s1 - s2 - s3 + s4), lever * (s1 + s2 - s3 - s4), 7.5e-7 * (s1 - s2 + s3 - s4));
    let omega_r = rotors[0] - rotors[1] + rotors[2] - rotors[3];
    let Vec3 { x: p, y: q, z: r } = rates;
    vec3(
        (q * r * (iyy - izz) + jr * q * omega_r + l * u2) / ixx,
        (p * r * (izz - ixx) - jr * p * omega_r + l * u3) / iyy,
        (q * p * (ixx - iyy) + u4) / izz,
    )
}

proptest! {
    /// With body rates in place of Euler rates, eqs 8-10 are the equations of the rigid body.
    #[test]
    fn equations_8_to_10_hold_in_body_rates(
        rates in prop::array::uniform3(-5.0_f64..5.0), rotors in prop::array::uniform4(50.0_f64..300.0),
    ) {
        let mut v = in_the_air(vec![built(&RotorGyroscopic {}, STEP_S)]);
        v.set_state(State { rates: rates.into(), ..*v.state() }, rotors);
        let printed = printed_8_to_10(rates.into(), rotors);
        prop_assert!((v.angular_acceleration() - printed).norm() < 1e-9 * (1.0 + printed.norm()));
    }

    /// Eqs 11-13 with the corrected sign of yaw, in any attitude.
    #[test]
    fn equations_11_to_13_hold_with_the_corrected_yaw_sign(
        roll in -1.4_f64..1.4, pitch in -1.4_f64..1.4, yaw in -3.1_f64..3.1, speed in 100.0_f64..300.0,
    ) {
        let mut v = in_the_air(vec![]);
        v.set_state(State { attitude: euler(roll, pitch, yaw), ..*v.state() }, [speed; 4]);
        let u1_m = 4.0 * 3.13e-5 * speed * speed / 0.65;
        let ((sf, cf), (st, ct), (sp, cp)) = (roll.sin_cos(), pitch.sin_cos(), yaw.sin_cos());
        let expected = vec3(
            (-sp * sf - cp * st * cf) * u1_m,
            (cp * sf - sp * st * cf) * u1_m,
            GRAVITY - ct * cf * u1_m,
        );
        prop_assert!((v.acceleration() - expected).norm() < 1e-9);
    }
}

/// The printed eqs 11-12, for comparison: correct at ψ = 0, reversed at ψ = 90°.
#[test]
fn printed_equations_11_and_12_are_reversed_at_90_deg_yaw() {
    let printed = |roll: f64, pitch: f64, yaw: f64, a: f64| {
        let ((sf, cf), (st, _), (sp, cp)) = (roll.sin_cos(), pitch.sin_cos(), yaw.sin_cos());
        ((sp * sf - cp * st * cf) * a, (cp * sf + sp * st * cf) * a)
    };
    let speed = hover_rad_s();
    let truth = |roll, pitch, yaw| {
        let mut v = in_the_air(vec![]);
        v.set_state(State { attitude: euler(roll, pitch, yaw), ..*v.state() }, [speed; 4]);
        v.acceleration()
    };
    let a = truth(0.2, 0.1, 0.0);
    let (x, y) = printed(0.2, 0.1, 0.0, GRAVITY);
    assert!((a.x - x).abs() < 1e-9 && (a.y - y).abs() < 1e-9, "equal at ψ = 0");

    // Facing east and rolled right, the vehicle must accelerate to the south. The printed form gives north.
    let a = truth(0.2, 0.0, std::f64::consts::FRAC_PI_2);
    let (x, _) = printed(0.2, 0.0, std::f64::consts::FRAC_PI_2, GRAVITY);
    assert!(a.x < -1.0 && (a.x + x).abs() < 1e-9);
    // Facing east and nose up, it must accelerate to the west. The printed form gives east.
    let a = truth(0.0, 0.2, std::f64::consts::FRAC_PI_2);
    let (_, y) = printed(0.0, 0.2, std::f64::consts::FRAC_PI_2, GRAVITY);
    assert!(a.y < -1.0 && (a.y + y).abs() < 1e-9);
}

/// Compares eqs 8-10 taken literally (as accelerations of the Euler angles) with the rigid body. Both are integrated
/// from the same rates. They are equal for small angles and different for large ones.
#[test]
fn printed_equations_8_to_10_fail_at_large_angles() {
    let departure = |rate: f64| {
        let rotors = [0.0; 4];
        let mut v = in_the_air(vec![]);
        let rates = vec3(rate, rate, rate);
        v.set_state(State { rates, ..*v.state() }, rotors);
        // This integrates the printed form, φ̈ θ̈ ψ̈ as functions of φ̇ θ̇ ψ̇, by small Euler steps.
        let (mut angles, mut angle_rates) = (Vec3::ZERO, rates);
        for _ in 0..100_000 {
            let a = printed_8_to_10(angle_rates, rotors);
            angles += angle_rates * 1e-5;
            angle_rates += a * 1e-5;
        }
        run(&mut v, 1.0);
        let d = euler(angles.x, angles.y, angles.z).conjugate() * v.state().attitude;
        2.0 * libm::asin(d.v.norm())
    };
    // The difference grows as the product of two angles. It is below 0.003 at 0.05 rad, and above 0.1 at 0.8 rad.
    assert!(departure(0.05) < 0.003, "{}", departure(0.05));
    assert!(departure(0.8) > 0.1, "{}", departure(0.8));
}

#[test]
fn torque_free_tumbling_keeps_energy_and_momentum() {
    let mut v = in_the_air(vec![]);
    let i = VehicleParams::OS4.inertia_kg_m2;
    v.set_state(State { rates: vec3(3.0, 0.5, 8.0), ..*v.state() }, [0.0; 4]);
    let energy = |s: &State| s.rates.dot(s.rates.scale_by(i));
    let momentum = |s: &State| s.attitude.rotate(s.rates.scale_by(i));
    let (e0, m0) = (energy(v.state()), momentum(v.state()));
    run(&mut v, 4.0);
    assert!((energy(v.state()) / e0 - 1.0).abs() < 1e-10);
    assert!((momentum(v.state()) - m0).norm() < 1e-9 * m0.norm());
}

#[test]
fn symmetric_top_matches_its_closed_form() {
    // With I_x = I_y the transverse rate rotates about z at exactly (I_z − I_x)/I_x · r.
    let mut v = in_the_air(vec![]);
    v.set_state(State { rates: vec3(1.0, 0.0, 6.0), ..*v.state() }, [0.0; 4]);
    run(&mut v, 3.0);
    let phase = (1.3e-2 - 7.5e-3) / 7.5e-3 * 6.0 * 3.0;
    let exact = vec3(libm::cos(phase), libm::sin(phase), 6.0);
    assert!((v.state().rates - exact).norm() < 1e-9, "{:?} {exact:?}", v.state().rates);
}

#[test]
fn runge_kutta_is_of_fourth_order() {
    let end = |step_s: f64| {
        let ground = Ground::new(&VehicleParams::OS4);
        let effects = vec![lag(0.05, step_s), drag(step_s)];
        let mut v = Vehicle::at_rest(VehicleParams::OS4, Mount::Free(ground), effects, step_s);
        v.set_state(
            State { position: vec3(0.0, 0.0, -100.0), rates: vec3(2.0, 1.0, -1.5), ..*v.state() },
            [150.0, 200.0, 180.0, 210.0],
        );
        v.command([200.0; 4]);
        for _ in 0..(1.0 / step_s).round() as u32 {
            v.advance();
        }
        v.state().position
    };
    let reference = end(0.000_25);
    let (coarse, fine) = ((end(0.02) - reference).norm(), (end(0.01) - reference).norm());
    let order = libm::log2(coarse / fine);
    assert!((order - 4.0).abs() < 0.2, "{order}");
}

#[test]
fn dropped_vehicle_comes_to_rest() {
    let mut v = in_the_air(vec![]);
    v.set_state(
        State {
            position: vec3(0.0, 0.0, -0.3),
            velocity: vec3(0.5, 0.0, 0.0),
            attitude: euler(0.1, -0.05, 0.3),
            ..*v.state()
        },
        [0.0; 4],
    );
    run(&mut v, 5.0);
    let s = v.state();
    assert!(s.velocity.norm() < 1e-6 && s.rates.norm() < 1e-6 && s.cos_tilt() > 0.999_999, "{s:?}");
    assert!((s.position.z - (0.001 - 0.05)).abs() < 1e-6);
}

#[test]
fn ball_joint_allows_rotation_only() {
    let mut v = Vehicle::at_rest(VehicleParams::OS4, Mount::BallJoint, vec![lag(0.05, STEP_S)], STEP_S);
    v.command([230.0, 220.0, 220.0, 230.0]);
    run(&mut v, 0.2);
    assert_eq!((v.state().position, v.state().velocity), (Vec3::ZERO, Vec3::ZERO));
    assert!(v.state().rates.x > 0.1);
    // The accelerometer reads gravity in body axes, for any rotor speeds.
    let f = v.specific_force();
    let expected = v.state().attitude.conjugate().rotate(vec3(0.0, 0.0, -GRAVITY));
    assert!((f - expected).norm() < 1e-12);
}
