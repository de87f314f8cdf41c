//! A finished step, as the board's monitor gets it.

use flight_core::ArmState;
use flight_core::arming::Event;
use flight_core::geometry::Quaternion;

/// A finished step, for the board's `Monitor::show`.
pub struct Step {
    /// Time of the step, µs: [`flight_core::Input::time_us`].
    pub time_us: u64,
    /// Whether the step had an IMU sample.
    pub sampled: bool,
    /// Arm state after the step: [`flight_core::Output::state`].
    pub state: ArmState,
    /// Change of the arm state, or refusal, in this step.
    pub event: Option<Event>,
    /// Attitude after the step.
    pub attitude: Quaternion<f32>,
    /// Deadlines that the tasks have missed since start.
    pub missed_deadlines: u32,
}
