//! The messages in both directions.

use flight_core::ArmState;
use flight_core::Config;
use flight_core::arming::Event;
use flight_core::sample::{Battery, ImuSample, MagSample, RcFrame};
use serde::{Deserialize, Serialize};

/// A message from `sim-host` to the firmware.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[allow(clippy::large_enum_variant)] // only one exists at a time, and there is no heap for a box
pub enum ToBoard {
    /// Builds the flight controller with this configuration.
    Start(Config),
    /// Runs a step of the flight.
    Step(Step),
    /// Ends the flight.
    End,
}

/// The input of a step. The counts go through the same decoding as the bytes of a real chip.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Step {
    /// Time of the step, µs.
    pub time_us: u64,
    /// Sample of gyroscope and accelerometer; `None` if no sample arrived.
    pub imu: Option<ImuSample>,
    /// Sample of the magnetometer, if one arrived.
    pub mag: Option<MagSample>,
    /// Frame of the receiver, if one arrived.
    pub rc: Option<RcFrame>,
    /// Reading of the battery, if there is one.
    pub battery: Option<Battery>,
}

/// A message from the firmware to `sim-host`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum ToHost {
    /// The firmware has started, and waits for [`ToBoard::Start`].
    Ready(Started),
    /// The flight controller is built with the configuration of [`ToBoard::Start`].
    Started,
    /// The flight controller rejects the configuration of [`ToBoard::Start`].
    Refused,
    /// A step is done.
    Done(Done),
    /// The received bytes are not a frame; no step was done.
    Bad(Received),
}

/// The reason why the firmware started.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Started {
    /// Whether the watchdog reset the firmware.
    pub watchdog_reset: bool,
}

/// The result of a step.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Done {
    /// [`Step::time_us`] of the step.
    pub time_us: u64,
    /// Arm state after the step.
    pub state: ArmState,
    /// Change of the arm state, or refusal to arm, in this step.
    pub event: Option<Event>,
    /// Whether the motors were permitted to turn.
    pub driven: bool,
    /// Pulses sent to rotors 1 to 4, µs.
    pub pulses_us: [f32; 4],
    /// Estimated attitude: w, x, y, z.
    pub attitude: [f32; 4],
    /// Instructions from the sample's arrival to the motors' last compare value; 0 if they are not counted.
    pub instructions: u32,
    /// Number of deadlines that the firmware's tasks have missed since the start.
    pub missed_deadlines: u32,
    /// Errors on the link.
    pub received: Received,
}

/// Errors on the link since the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Received {
    /// Number of damaged frames.
    pub corrupt: u32,
    /// Number of frames that are missing in the sequence.
    pub lost: u32,
    /// Number of frames that were repeated or out of order; they caused no step.
    pub repeated: u32,
}
