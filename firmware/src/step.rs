//! What the board is shown of a step.

use flight_core::ArmState;
use flight_core::arming::Event;
use flight_core::geometry::Quaternion;

/// A finished step, for the board's `Monitor::show`.
pub struct Step {
    /// [`flight_core::Input::time_us`].
    pub time_us: u64,
    /// Whether an inertial sample came.
    pub sampled: bool,
    /// [`flight_core::Output::state`].
    pub state: ArmState,
    /// What happened to the arm state, if anything did.
    pub event: Option<Event>,
    /// The attitude after the step.
    pub attitude: Quaternion<f32>,
    /// Deadlines that the tasks have missed since start.
    pub missed_deadlines: u32,
}
