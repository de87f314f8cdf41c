//! The interface of an autopilot, which flies the vehicle.

use std::convert::Infallible;

use flight_core::arming::Event;
use flight_core::esc::EscParams;
use flight_core::geometry::{Quaternion, Vec3};
use flight_core::sample::Input;
use flight_core::{ArmState, FlightController};

/// Pulse that stops a motor, µs.
const STOP_US: f32 = EscParams::STANDARD.stop_us;

/// The output of an autopilot for one step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AutopilotOutput {
    /// True if the motors are permitted to turn. If false, they stop at any pulse.
    pub driven: bool,
    /// Pulses of rotors 1 to 4 after the permit was applied, µs.
    pub pulses_us: [f32; 4],
    /// The arm state.
    pub state: ArmState,
    /// Event of the arm state in this step, if any.
    pub event: Option<Event>,
    /// Estimated attitude, body to world.
    pub attitude: Quaternion<f32>,
    /// Body rates after prefilter and gyro zero, rad/s; `None` if the autopilot does not report them.
    pub rates_rad_s: Option<Vec3<f32>>,
}

/// An autopilot: takes the input of a step, and returns the motor commands.
pub trait Autopilot {
    /// The reason for a failure.
    type Error;

    /// Does one step.
    ///
    /// # Errors
    /// The autopilot has failed, and the flight ends.
    fn step(&mut self, input: &Input) -> Result<AutopilotOutput, Self::Error>;
}

/// The flight code in this process.
impl Autopilot for FlightController {
    type Error = Infallible;

    #[inline(always)]
    fn step(&mut self, input: &Input) -> Result<AutopilotOutput, Infallible> {
        let output = self.step(input);
        let (driven, pulses_us) = match output.permit {
            Some(permit) => (true, permit.apply(output.pulses_us, STOP_US)),
            None => (false, output.pulses_us),
        };
        Ok(AutopilotOutput {
            driven,
            pulses_us,
            state: output.state,
            event: output.event,
            attitude: self.attitude(),
            rates_rad_s: Some(self.rates_rad_s()),
        })
    }
}

impl<A: Autopilot> Autopilot for &mut A {
    type Error = A::Error;

    fn step(&mut self, input: &Input) -> Result<AutopilotOutput, A::Error> {
        (**self).step(input)
    }
}
