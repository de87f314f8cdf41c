//! Who flies.

use std::convert::Infallible;

use flight_core::arming::Event;
use flight_core::esc::EscParams;
use flight_core::geometry::{Quaternion, Vec3};
use flight_core::sample::Input;
use flight_core::{ArmState, FlightController};

/// Pulse of a motor that stands still, µs.
const STOP_US: f32 = EscParams::STANDARD.stop_us;

/// What an autopilot makes of a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Answer {
    /// Whether the motors are permitted to turn. Without it they stand still, whatever the pulses say.
    pub driven: bool,
    /// Pulses of rotors 1 to 4 as the permit lets them through, µs.
    pub pulses_us: [f32; 4],
    /// The arm state.
    pub state: ArmState,
    /// What happened to the arm state in this step, if anything did.
    pub event: Option<Event>,
    /// Estimated attitude, body to world.
    pub attitude: Quaternion<f32>,
    /// Body rates after prefilter and gyro zero, rad/s; `None` if the autopilot does not tell.
    pub rates_rad_s: Option<Vec3<f32>>,
}

/// Who flies: takes what arrives in a step, and says what the motors are to do.
pub trait Autopilot {
    /// Why there may be no answer.
    type Error;

    /// One step.
    ///
    /// # Errors
    /// There is no answer and will be none: the flight is over.
    fn step(&mut self, input: &Input) -> Result<Answer, Self::Error>;
}

/// The flight code in this process.
impl Autopilot for FlightController {
    type Error = Infallible;

    #[inline(always)]
    fn step(&mut self, input: &Input) -> Result<Answer, Infallible> {
        let output = self.step(input);
        let (driven, pulses_us) = match output.permit {
            Some(permit) => (true, permit.apply(output.pulses_us, STOP_US)),
            None => (false, output.pulses_us),
        };
        Ok(Answer {
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

    fn step(&mut self, input: &Input) -> Result<Answer, A::Error> {
        (**self).step(input)
    }
}
