//! Eqs 4-9 and 14 across crates: the simulated vehicle produces what the flight code's mixer computes.

use flight_core::geometry::{Vec3, vec3};
use flight_core::mixer::{Airframe, Mixer, Saturation, Wrench};
use sim_host::dynamics::{GRAVITY, Ground, Mount, State, Vehicle, VehicleParams};
use sim_host::effects::vehicle::{RotorGyroscopic, VehicleEffect};

use crate::still::on_os4;

const PARAMS: VehicleParams = VehicleParams::OS4;

/// Returns a vehicle in the air, with body rates and rotor speeds in rad/s.
fn flying(effects: Vec<(&'static str, VehicleEffect)>, rates: Vec3<f64>, rotors: [f64; 4]) -> Vehicle {
    let mut vehicle = Vehicle::at_rest(PARAMS, Mount::Free(Ground::new(&PARAMS)), effects, 1e-3);
    vehicle.set_state(State { position: vec3(0.0, 0.0, -100.0), rates, ..*vehicle.state() }, rotors);
    vehicle
}

#[test]
fn vehicle_produces_the_wrench_that_the_mixer_solves_for() {
    let mixer = Mixer::new(&Airframe::OS4).unwrap();
    for (thrust_n, torque) in [
        (6.4, [0.0, 0.0, 0.0]),
        (6.4, [0.2, 0.0, 0.0]),
        (6.4, [0.0, 0.2, 0.0]),
        (6.4, [0.0, 0.0, 0.02]),
        (7.5, [-0.1, 0.15, -0.015]),
    ] {
        let wanted = Wrench { thrust_n, torque_n_m: torque.into() };
        let (squares, saturation) = mixer.mix(&wanted);
        assert_eq!(saturation, Saturation::default());
        let vehicle = flying(vec![], Vec3::ZERO, Mixer::speeds(squares).map(f64::from));
        let thrust = (GRAVITY - vehicle.acceleration().z) * PARAMS.mass_kg;
        let produced = vehicle.angular_acceleration().scale_by(PARAMS.inertia_kg_m2);
        assert!((thrust - f64::from(thrust_n)).abs() < 1e-5, "{thrust}");
        assert!((produced - Vec3::from(torque.map(f64::from))).norm() < 1e-6, "{produced:?}");
    }
}

/// J_r Ω_r of eqs 8, 9 and 14 from the angular momentum: a rotor that turns anticlockwise seen from above rotates
/// about −z, and a body that rotates with ω is subject to −ω × h.
#[test]
fn rotor_momentum_gives_the_signs_of_the_gyroscopic_terms() {
    let j = PARAMS.rotor_inertia_kg_m2;
    let rotors = [250.0, 180.0, 230.0, 210.0];
    let anticlockwise = [true, false, true, false];
    let spin: f64 = rotors.iter().zip(anticlockwise).map(|(speed, a)| if a { -speed } else { *speed }).sum();
    let momentum = vec3(0.0, 0.0, j * spin);
    for rates in [vec3(1.0, 0.0, 0.0), vec3(0.0, 1.0, 0.0), vec3(0.3, -2.0, 1.5)] {
        let with = flying(vec![on_os4(&RotorGyroscopic {})], rates, rotors).angular_acceleration();
        let without = flying(vec![], rates, rotors).angular_acceleration();
        let torque = (with - without).scale_by(PARAMS.inertia_kg_m2);
        assert!((torque + rates.cross(momentum)).norm() < 1e-12, "{torque:?}");
    }
}
