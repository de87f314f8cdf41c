//! What goes into one step of the flight controller, and what comes out.

use crate::arming::{ArmState, Event, MotorPermit};

/// Everything that arrived since the last step. A sensor that brought nothing new is `None`.
#[derive(Clone, Copy, Debug, Default)]
pub struct Input {
    /// Time of this step, µs since start, from the data-ready capture or the simulator's frame. The only
    /// clock there is.
    pub time_us: u64,
    /// Gyroscope and accelerometer.
    pub imu: Option<ImuSample>,
    /// Magnetometer.
    pub mag: Option<MagSample>,
    /// Radio control.
    pub rc: Option<RcFrame>,
    /// Supply.
    pub battery: Option<Battery>,
    /// A motor to be turned on the bench.
    pub bench: Option<BenchCommand>,
    /// What the board knows about itself.
    pub health: Health,
}

/// Raw counts of the inertial sensor, in the chip's own axes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ImuSample {
    /// Angular rate about the chip's x, y, z.
    pub gyro: [i16; 3],
    /// Specific force along the chip's x, y, z.
    pub accel: [i16; 3],
}

/// Raw counts of the magnetometer, in the chip's own axes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct MagSample {
    /// Field along the chip's x, y, z.
    pub counts: [i16; 3],
}

/// One frame from the receiver.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct RcFrame {
    /// Throttle, roll, pitch, yaw in the 11-bit ticks of SBUS and CRSF: 172 to 1811, centre 992.
    pub channels: [u16; 4],
    /// Arm switch, ticks.
    pub arm_switch: u16,
    /// Mode switch, ticks.
    pub mode_switch: u16,
    /// What the receiver says of its link.
    pub status: LinkStatus,
}

/// What a receiver says of its link to the transmitter. The numbers are codes in a
/// [`StepRecord`](crate::record::StepRecord), and do not change.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[repr(u8)]
pub enum LinkStatus {
    /// The frame is the pilot's.
    #[default]
    Good = 0,
    /// The receiver missed one, and repeats the last.
    FrameLost = 1,
    /// The receiver has lost the transmitter, and makes the channels up.
    Failsafe = 2,
}

/// Turn one motor on the bench. Each one is a heartbeat too: without the next the motor stops.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BenchCommand {
    /// Which: 1 to 4.
    pub rotor: u8,
    /// Share of the rotor's largest thrust, 0 to 1.
    pub thrust: f32,
}

/// State of the supply.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Battery {
    /// Terminal voltage, V.
    pub voltage_v: f32,
}

/// What the board knows about itself.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Health {
    /// USB is plugged in.
    pub usb: bool,
    /// Somebody wants to erase flash, and waits for [`ArmState::Maintenance`].
    pub maintenance: bool,
    /// The watchdog caused the last reset.
    pub watchdog_reset: bool,
    /// Deadlines that the board's tasks have missed since start.
    pub missed_deadlines: u32,
}

/// The result of one step.
#[derive(Debug)]
pub struct Output {
    /// The key to the motors: without it the board may only send the stop pulse.
    pub permit: Option<MotorPermit>,
    /// ESC pulses of rotors 1 to 4, µs. The stop pulse when there is no permit.
    pub pulses_us: [f32; 4],
    /// Whether the motors may turn.
    pub state: ArmState,
    /// What happened to the arm state in this step, if anything did.
    pub event: Option<Event>,
}
