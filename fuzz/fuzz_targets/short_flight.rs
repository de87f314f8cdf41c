//! The beginning of a flight: long enough that every effect is built and applied, and the sensors are read.

use flight_core::FlightController;
use flight_core::sample::Input;
use sim_host::flight::{Answer, Autopilot, Flight, Observer, StepView};
use sim_host::scene::Scene;

/// The flight controller, until its steps are used up.
struct Limited(FlightController, u32);

impl Autopilot for Limited {
    type Error = ();

    fn step(&mut self, input: &Input) -> Result<Answer, ()> {
        self.1 = self.1.checked_sub(1).ok_or(())?;
        let Ok(answer) = Autopilot::step(&mut self.0, input);
        Ok(answer)
    }
}

/// Who sees that what flight-core gives is finite, whatever the world gives it.
struct Watch;

impl Observer for Watch {
    fn step(&mut self, view: &StepView) {
        assert!(view.output.pulses_us.iter().all(|us| (1_000.0..=2_000.0).contains(us)), "{:?}", view.output);
        assert!((view.estimate.norm_squared() - 1.0).abs() < 1e-3, "{:?}", view.estimate);
        assert!(view.truth.is_finite(), "{:?} in a flight that goes on", view.truth);
    }
}

/// Flies `steps` of the scene, and returns the digest of its trajectory.
pub fn fly(scene: &Scene, steps: u32) -> u64 {
    let flight = Flight::flown_by(Limited(scene.controller(), steps), scene, scene.seed);
    flight.fly(&mut Watch).0.digest
}
