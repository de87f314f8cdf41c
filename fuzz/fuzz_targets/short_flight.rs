//! The start of a flight, long enough that every effect is built and applied and the sensors are read.

use flight_core::FlightController;
use flight_core::sample::Input;
use sim_host::flight::{Autopilot, AutopilotOutput, Flight, Observer, StepView};
use sim_host::scene::Scene;

/// A flight controller that ends the flight after a number of steps.
struct Limited(FlightController, u32);

impl Autopilot for Limited {
    type Error = ();

    fn step(&mut self, input: &Input) -> Result<AutopilotOutput, ()> {
        self.1 = self.1.checked_sub(1).ok_or(())?;
        let Ok(answer) = Autopilot::step(&mut self.0, input);
        Ok(answer)
    }
}

/// Checks in every step that the flight controller's outputs and the truth are finite.
struct FiniteCheck;

impl Observer for FiniteCheck {
    fn step(&mut self, view: &StepView) {
        assert!(view.output.pulses_us.iter().all(|us| (1_000.0..=2_000.0).contains(us)), "{:?}", view.output);
        assert!((view.estimate.norm_squared() - 1.0).abs() < 1e-3, "{:?}", view.estimate);
        assert!(view.truth.is_finite(), "{:?} in a flight that goes on", view.truth);
    }
}

/// Flies `steps` steps of the scene and returns the digest of its trajectory.
pub fn fly(scene: &Scene, steps: u32) -> u64 {
    let flight = Flight::with_autopilot(Limited(scene.controller(), steps), scene, scene.seed);
    flight.fly(&mut FiniteCheck).0.digest
}
