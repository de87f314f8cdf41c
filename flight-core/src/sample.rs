//! Inputs and outputs of one step of the flight controller.

use crate::arming::{ArmState, Event, MotorPermit};

/// All data that has arrived since the last step. A sensor without new data is `None`.
#[derive(Clone, Copy, Debug, Default)]
pub struct Input {
    /// Time of this step since start, µs: from the data-ready capture on the board, from the simulator on the host.
    /// The flight controller has no other clock.
    pub time_us: u64,
    /// Sample of gyroscope and accelerometer.
    pub imu: Option<ImuSample>,
    /// Sample of the magnetometer.
    pub mag: Option<MagSample>,
    /// Frame from the receiver.
    pub rc: Option<RcFrame>,
    /// Measurement of the battery.
    pub battery: Option<Battery>,
    /// Bench command.
    pub bench: Option<BenchCommand>,
    /// State of the board.
    pub health: Health,
}

/// Counts of the IMU, in the axes of the chip.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ImuSample {
    /// Angular rate about x, y, z of the chip, counts.
    pub gyro: [i16; 3],
    /// Specific force along x, y, z of the chip, counts.
    pub accel: [i16; 3],
}

/// Counts of the magnetometer, in the axes of the chip.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct MagSample {
    /// Magnetic field along x, y, z of the chip, counts.
    pub counts: [i16; 3],
}

/// One frame from the receiver.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct RcFrame {
    /// Throttle, roll, pitch and yaw in the 11-bit ticks of SBUS and CRSF: 172 to 1811, centre 992.
    pub channels: [u16; 4],
    /// Arm switch, in the same ticks.
    pub arm_switch: u16,
    /// Mode switch, in the same ticks.
    pub mode_switch: u16,
    /// State of the link as the receiver reports it.
    pub status: LinkStatus,
}

/// State of the link between receiver and transmitter, as the receiver reports it. The discriminants are codes in a
/// [`StepRecord`](crate::record::StepRecord) and never change.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[repr(u8)]
pub enum LinkStatus {
    /// The frame carries new channels from the pilot.
    #[default]
    Good = 0,
    /// The receiver has missed a frame and repeats the last channels.
    FrameLost = 1,
    /// The receiver has lost the transmitter and sends substitute channels.
    Failsafe = 2,
}

/// Command to turn one motor on the bench. Each command is also a heartbeat: the motor stops unless another one
/// follows within [`BENCH_SILENT_US`](crate::bench::BENCH_SILENT_US).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BenchCommand {
    /// Number of the rotor, 1 to 4.
    pub rotor: u8,
    /// Share of the maximum thrust of the rotor, 0 to 1.
    pub thrust: f32,
}

/// State of the battery.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Battery {
    /// Terminal voltage, V.
    pub voltage_v: f32,
}

/// State of the board.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Health {
    /// Whether USB is plugged in.
    pub usb: bool,
    /// Whether a request to erase flash is waiting for [`ArmState::Maintenance`].
    pub maintenance: bool,
    /// Whether the watchdog caused the last reset.
    pub watchdog_reset: bool,
    /// Number of deadlines that the tasks have missed since start.
    pub missed_deadlines: u32,
}

/// The result of one step.
#[derive(Debug)]
pub struct Output {
    /// Permission to drive the motors. Without it the board may only send the stop pulse.
    pub permit: Option<MotorPermit>,
    /// ESC pulses of rotors 1 to 4, µs: the stop pulse unless the arm state lets a motor turn.
    pub pulses_us: [f32; 4],
    /// Arm state after the step.
    pub state: ArmState,
    /// Change of the arm state, or a refusal, in this step.
    pub event: Option<Event>,
}
