//! The messages.

use flight_core::ArmState;
use flight_core::Config;
use flight_core::arming::Event;
use flight_core::sample::{Battery, ImuSample, MagSample, RcFrame};
use serde::{Deserialize, Serialize};

/// From `sim-host` to the firmware.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[allow(clippy::large_enum_variant)] // there is one of them at a time, and no heap to box it in
pub enum ToBoard {
    /// Be this flight controller from now on.
    Start(Config),
    /// A step of the flight.
    Step(Step),
    /// The flight is over.
    End,
}

/// What arrives in a step. The firmware's own drivers stand in for the sensors' bytes: the counts go through the
/// same decoding as a chip's.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Step {
    /// Time of the step, µs.
    pub time_us: u64,
    /// Gyroscope and accelerometer; `None`: no sample came.
    pub imu: Option<ImuSample>,
    /// Magnetometer.
    pub mag: Option<MagSample>,
    /// Receiver.
    pub rc: Option<RcFrame>,
    /// Supply.
    pub battery: Option<Battery>,
}

/// From the firmware to `sim-host`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum ToHost {
    /// The firmware has started, and waits for [`ToBoard::Start`].
    Ready(Started),
    /// It is the flight controller that it was told to be.
    Started,
    /// A configuration that no flight controller can be built from.
    Refused,
    /// A step is done.
    Done(Done),
    /// What came was no frame; nothing was done.
    Bad(Received),
}

/// How the firmware came to start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Started {
    /// It was reset by its watchdog.
    pub watchdog_reset: bool,
}

/// What came of a step.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Done {
    /// [`Step::time_us`] of the step.
    pub time_us: u64,
    /// The arm state.
    pub state: ArmState,
    /// Its change or the refusal in this step.
    pub event: Option<Event>,
    /// Whether the motors were permitted to turn.
    pub driven: bool,
    /// What went out to the motors, rotors 1 to 4, µs.
    pub pulses_us: [f32; 4],
    /// The estimated attitude, w, x, y, z.
    pub attitude: [f32; 4],
    /// Instructions from the sample's arrival to the motors' last compare value; 0 where nobody counts them.
    pub instructions: u32,
    /// Deadlines that the firmware's tasks have missed since it started.
    pub missed_deadlines: u32,
    /// What came over the link.
    pub received: Received,
}

/// What has come over the link since the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Received {
    /// Frames that were damaged.
    pub corrupt: u32,
    /// Frames that are missing in the sequence.
    pub lost: u32,
    /// Frames that came again, or out of order, and were not stepped again.
    pub repeated: u32,
}
