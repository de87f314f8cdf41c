//! Simulated worlds at the limits of their parameters.

use flight_core::ArmState;
use flight_core::geometry::{Quaternion, Vec3, vec3};
use sim_host::dynamics::{GRAVITY, Ground, Mount, State, Vehicle, VehicleParams};
use sim_host::effects::vehicle::{Lag, VehicleEffect};
use sim_host::flight::{Crash, Flight, Outcome};
use sim_host::scene::Scene;

use crate::truth::rotation;

fn hover_with(tables: &str) -> Result<Scene, String> {
    Scene::parse("hard.toml", &format!("include = \"hover\"\n{tables}")).map_err(|error| error.to_string())
}

fn fly(tables: &str) -> Outcome {
    Flight::new(&hover_with(tables).unwrap(), 3).run(&mut ())
}

#[test]
fn invalid_masses_are_refused() {
    for mass in ["1e-3", "1e9", "0.0", "-1.0", "inf"] {
        let error = hover_with(&format!("[vehicle]\nmass_g = {mass}\n")).unwrap_err();
        assert!(error.contains("mass_g = ") && error.contains("must be from 10 to 100000 g"), "{error}");
    }
}

#[test]
fn stiff_motors_hover_at_a_step_of_ten_tau() {
    // τ = 0.1 ms at steps of 1 ms: the lag is computed in closed form, so it flies like instant motors.
    let stiff = fly("[effects.vehicle.motor_lag]\ntau_s = 0.0001\n");
    assert_eq!((stiff.crash, stiff.final_state), (None, ArmState::Disarmed));
    assert!(stiff.tilt_max_deg < 2.0, "{stiff:?}");
}

#[test]
fn stiff_motors_equal_instant_ones_at_a_step_of_100_tau() {
    // τ = 0.1 ms in steps of 10 ms, where an explicit step would multiply the difference by 1 − h/τ = −99 each time.
    // The thrust changes every 50 ms. Instant motors differ only in the first stage of the step after a command, which
    // has a sixth of the weight: h/6 · ΔU1/m of speed.
    let step_s = 0.01;
    let climb = |effects| {
        let ground = Mount::Free(Ground::new(&VehicleParams::OS4));
        let mut vehicle = Vehicle::at_rest(VehicleParams::OS4, ground, effects, step_s);
        for step in 0..500 {
            if step % 5 == 0 {
                vehicle.command([if step % 10 == 0 { 300.0 } else { 250.0 }; 4]);
            }
            vehicle.advance();
            assert!(vehicle.state().is_finite());
        }
        (*vehicle.state(), vehicle.rotors())
    };
    let (stiff, speeds) = climb(vec![("motor_lag", VehicleEffect::Lag(Lag::new(1e-4, 1e-4, step_s)))]);
    let (instant, wanted) = climb(vec![]);
    assert_eq!(speeds, wanted, "only e⁻¹⁰⁰ of the difference is left");
    let b = VehicleParams::OS4.thrust_coefficient;
    let first = step_s / 6.0 * 4.0 * b * 300.0_f64.powi(2) / VehicleParams::OS4.mass_kg;
    let difference = (stiff.velocity - instant.velocity).norm();
    assert!(difference < 1.01 * first, "{difference} m/s, bound 1.01 × {first} m/s");
}

/// Returns the mechanical energy above rest on the ground, including rotation, per mass, J/kg.
fn energy_j_kg(params: &VehicleParams, state: &State) -> f64 {
    let turning = state.rates.dot(state.rates.scale_by(params.inertia_kg_m2)) / params.mass_kg;
    0.5 * (state.velocity.dot(state.velocity) + turning) - GRAVITY * state.position.z
}

#[test]
fn ground_contact_at_any_speed_adds_no_energy() {
    // Free fall from a kilometre gives 140 m/s. A foot that goes deep into the ground is pushed with kN, and its
    // friction, μ N/(0.05 m/s), is too stiff for a step of 1 ms: it must not give back more energy than it took.
    let params = VehicleParams::OS4;
    let upside_down = rotation(vec3(3.0, 0.4, 0.0));
    for attitude in [Quaternion::IDENTITY, rotation(vec3(0.5, -0.3, 2.0)), upside_down] {
        for velocity in
            [vec3(0.0, 0.0, 20.0), vec3(0.0, 0.0, 140.0), vec3(60.0, -20.0, 30.0), vec3(90.0, 0.0, 0.1)]
        {
            for rates in [Vec3::ZERO, vec3(35.0, -10.0, 20.0)] {
                let ground = Mount::Free(Ground::new(&params));
                let mut vehicle = Vehicle::at_rest(params, ground, vec![], 1e-3);
                let state = State { position: vec3(0.0, 0.0, -0.5), velocity, attitude, rates };
                vehicle.set_state(state, [0.0; 4]);
                let first = energy_j_kg(&params, &state);
                let mut touched = false;
                for _ in 0..20_000 {
                    vehicle.advance();
                    touched |= vehicle.touches_ground();
                    let now = vehicle.state();
                    assert!(now.is_finite(), "{state:?}");
                    // Only gravity pulls down: the ground does not hold a foot that leaves it.
                    assert!(vehicle.acceleration().z <= GRAVITY + 1e-9, "{:?}", vehicle.acceleration());
                    // The springs store part of the energy for a while; they must not give back more.
                    let energy = energy_j_kg(&params, now);
                    assert!(energy < first * (1.0 + 1e-9) + 1e-9, "{energy} of {first} J/kg from {state:?}");
                }
                assert!(touched);
                let energy = 0.5 * vehicle.state().velocity.dot(vehicle.state().velocity);
                println!("{velocity:?} {rates:?}: {energy:e}");
            }
        }
    }
}

#[test]
fn vehicles_at_parameter_limits_are_refused_or_stand_still() {
    let (mut stood, mut refused) = (0, 0);
    for mass in [0.01, 0.65, 100.0] {
        for inertia in [1e-6, 7.5e-3, 100.0] {
            for arm in [0.02, 0.23, 5.0] {
                // Feet with 1 mm of compression right a vehicle with 500/m · l² per m of height; a higher vehicle
                // really topples.
                for leg in [0.01, 0.05, 1.0].into_iter().filter(|leg| 250.0 * arm * arm > *leg) {
                    let table = format!(
                        "[vehicle]\nmass_g = {:?}\nfeet_mm = {:?}\nrotors.arm_mm = {:?}\nrotors.thrust_n_s2 = {:?}\n\
                         inertia.kg_m2 = [{inertia:?}, {inertia:?}, {inertia:?}]\n",
                        mass * 1e3,
                        leg * 1e3,
                        arm * 1e3,
                        // The thrust coefficient is that of OS4, scaled with the mass.
                        mass / 0.65 * 3.13e-5,
                    );
                    match hover_with(&table) {
                        Err(error) => {
                            assert!(error.contains("vehicle.inertia.kg_m2"), "{error}");
                            refused += 1;
                        }
                        Ok(scene) => {
                            let mut vehicle = Vehicle::at_rest(
                                scene.vehicle,
                                scene.mount(),
                                scene.vehicle_effects(1, 1e3),
                                1e-3,
                            );
                            let tilted = rotation(vec3(0.01, -0.02, 0.5));
                            let state = *vehicle.state();
                            vehicle.set_state(State { attitude: tilted, ..state }, [0.0; 4]);
                            (0..10_000).for_each(|_| vehicle.advance());
                            let now = vehicle.state();
                            assert!(now.is_finite() && now.cos_tilt() > 0.99, "{table}: {now:?}");
                            assert!(now.velocity.norm() < 0.1 && now.rates.norm() < 1.0, "{table}: {now:?}");
                            stood += 1;
                        }
                    }
                }
            }
        }
    }
    println!("{stood} stood, {refused} refused");
    assert!(stood > 20 && refused > 10);
}

#[test]
fn zero_and_extreme_drag_fly_and_stiff_drag_is_refused() {
    let none = fly("[effects.vehicle.linear_drag]\na_kg_per_s = [0.0, 0.0, 0.0]\n");
    assert_eq!((none.crash, none.final_state), (None, ArmState::Disarmed));
    // A drag of 500 kg/s on 0.65 kg has a time constant of 1.3 ms. With the step h = 1 ms the rate λ gives λh = 0.77,
    // and RK4 is stable up to λh = 2.8. The vehicle hardly moves.
    let extreme = fly("[effects.vehicle.linear_drag]\na_kg_per_s = [500.0, 500.0, 500.0]\n");
    assert!(extreme.crash.is_none(), "{extreme:?}");
    assert!(extreme.attitude_rmse_deg < 1.0, "{extreme:?}");
    // Drag that is too stiff for the step is refused, for every kind of drag, and for a light vehicle at lower values.
    for (drag, field) in [
        ("linear_drag]\na_kg_per_s = [0.0, 900.0, 0.0]", "vehicle.linear_drag"),
        ("quadratic_drag]\ncd_area_m2 = [100.0, 1.0, 1.0]", "vehicle.quadratic_drag"),
        ("rotor_drag]\nk_kg_per_rad = 1.0", "vehicle.rotor_drag"),
    ] {
        let error = hover_with(&format!("[effects.vehicle.{drag}\n")).unwrap_err();
        assert!(error.contains(field) && error.contains("one step of 1 ms"), "{error}");
    }
    let light = "[vehicle]\nmass_g = 20.0\nrotors.idle_rad_s = 5.0\n[effects.vehicle.linear_drag]\na_kg_per_s = [30.0, 0.0, 0.0]\n";
    assert!(hover_with(light).unwrap_err().contains("at most"), "{light}");
}

#[test]
fn too_strong_wind_ends_as_flown_away_with_finite_numbers() {
    let outcome = fly("[effects.wind.constant]\nvelocity_m_s = [-14.0, 0.0, 0.0]\n");
    assert_eq!(outcome.crash.map(|(crash, _)| crash), Some(Crash::FlownAway), "{outcome:?}");
    // Four times the wind shakes the vehicle on the ground, and it does not arm.
    let storm = fly("[effects.wind.constant]\nvelocity_m_s = [-60.0, 0.0, 0.0]\n");
    assert_eq!(storm.final_state, ArmState::Disarmed);
    for outcome in [outcome, storm] {
        assert!(outcome.attitude_rmse_deg.is_finite() && outcome.position_error_max_m.is_finite());
    }
}
