//! Worlds at the ends of their parameters.

use flight_core::ArmState;
use sim_host::flight::{Crash, Flight, Outcome};
use sim_host::scene::Scene;

fn hover_with(tables: &str) -> Result<Scene, String> {
    Scene::parse("hard.toml", &format!("include = \"hover\"\n{tables}")).map_err(|error| error.to_string())
}

fn fly(tables: &str) -> Outcome {
    Flight::new(&hover_with(tables).unwrap(), 3).run(&mut ())
}

#[test]
fn masses_that_are_none_are_refused() {
    for mass in ["1e-6", "1e6", "0.0", "-1.0", "inf"] {
        let error =
            hover_with(&format!("[scene]\nvehicle = {{ like = \"os4\", mass_kg = {mass} }}\n")).unwrap_err();
        assert!(
            error.contains("scene.vehicle.mass_kg") && error.contains("must be from 0.01 to 100 kg"),
            "{error}"
        );
    }
}

#[test]
fn stiff_motors_are_exact_at_any_step() {
    // τ = 0.1 ms at steps of 1 ms: the lag is a closed form, so this is the flight with motors that are instant.
    let stiff = fly("[effects.vehicle.motor_lag]\ntau_s = 0.0001\n");
    assert_eq!((stiff.crash, stiff.final_state), (None, ArmState::Disarmed));
    assert!(stiff.tilt_max_deg < 2.0, "{stiff:?}");
}

#[test]
fn drag_of_nothing_and_of_honey() {
    let none = fly("[effects.vehicle.linear_drag]\na_kg_per_s = [0.0, 0.0, 0.0]\n");
    assert_eq!((none.crash, none.final_state), (None, ArmState::Disarmed));
    // 500 kg/s on 0.65 kg are 1.3 ms: RK4 is stable to 2.8 times that in a step of 1 ms. It hardly moves at all.
    let honey = fly("[effects.vehicle.linear_drag]\na_kg_per_s = [500.0, 500.0, 500.0]\n");
    assert!(honey.crash.is_none(), "{honey:?}");
    assert!(honey.attitude_rmse_deg < 1.0, "{honey:?}");
}

#[test]
fn a_wind_beyond_hover_authority_carries_it_away_and_every_number_stays_one() {
    let outcome = fly("[effects.wind.constant]\nvelocity_m_s = [-14.0, 0.0, 0.0]\n");
    assert_eq!(outcome.crash.map(|(crash, _)| crash), Some(Crash::FlownAway), "{outcome:?}");
    // Four times that shakes it on the ground, and it does not even arm.
    let storm = fly("[effects.wind.constant]\nvelocity_m_s = [-60.0, 0.0, 0.0]\n");
    assert_eq!(storm.final_state, ArmState::Disarmed);
    for outcome in [outcome, storm] {
        assert!(outcome.attitude_rmse_deg.is_finite() && outcome.position_error_max_m.is_finite());
    }
}
