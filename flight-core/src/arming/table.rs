//! The arming table. It alone decides which state follows which, and for what cause.

use bitflags::bitflags;

use super::{ArmState, Cause};

bitflags! {
    /// The conditions of a step, one bit each.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub struct Conditions: u32 {
        /// The pilot requests arming: the arm gesture held for 1 s, or the arm switch. The request counts once; the
        /// pilot must release it before the next request.
        const ARM = 1 << 0;
        /// The pilot requests disarming: the disarm gesture held for 0.5 s, or the arm switch off for 0.1 s.
        const DISARM = 1 << 1;
        /// The link is lost: no frame has come from the receiver for 0.5 s, or the receiver reports link loss, or frames
        /// have arrived again for less than 0.5 s.
        const RC_LOST = 1 << 2;
        /// The last throttle position was 5 % or more.
        const THROTTLE_UP = 1 << 3;
        /// The IMU has sent no valid sample for 0.1 s: no sample at all, or only samples with its code for invalid data.
        const IMU_LOST = 1 << 4;
        /// An axis of the IMU has read the same value for 0.1 s, and the value is not at the end of its range.
        const IMU_STUCK = 1 << 5;
        /// The vehicle has not been at rest for 1 s, so that the gyroscope is not zeroed.
        const NOT_STILL = 1 << 6;
        /// The vehicle is tilted by more than 25°.
        const NOT_LEVEL = 1 << 7;
        /// The sensors of this vehicle have not been calibrated.
        const NO_CALIBRATION = 1 << 8;
        /// The battery voltage is below the minimum for starting a flight, or has not been measured for 2 s.
        const BATTERY_LOW = 1 << 9;
        /// The battery voltage has been below the minimum for continuing a flight for 3 s. Stays set until the flight
        /// is over.
        const BATTERY_CRITICAL = 1 << 10;
        /// A task of the board has missed its deadline in the last second.
        const OVERLOAD = 1 << 11;
        /// USB is plugged in, so people may be near the rotors.
        const BENCH_LOCK = 1 << 12;
        /// A bench command is in force: the last one is no older than 0.25 s.
        const BENCH_COMMAND = 1 << 13;
        /// Bench commands have continued for longer than their time limit.
        const BENCH_EXPIRED = 1 << 14;
        /// A request to erase flash is present. Erasing stops the processor for up to half a second.
        const MAINTENANCE = 1 << 15;
        /// The watchdog has reset the board. Set in the first step only.
        const WATCHDOG_RESET = 1 << 16;
        /// The present state has reached its time limit: 0.5 s for `Arming`, the configured time for `Descent`.
        const TIME_UP = 1 << 17;
        /// In angle mode the vehicle has been tilted by 20° more than the sticks can command for half a second: a
        /// rotor has failed, or the vehicle lies on its back.
        const TILT_LIMIT = 1 << 18;
    }
}

impl Conditions {
    /// The conditions that appear in the rows of [`ArmState::Armed`] and [`ArmState::Descent`].
    pub const IN_FLIGHT: Self = Self::DISARM
        .union(Self::RC_LOST)
        .union(Self::THROTTLE_UP)
        .union(Self::IMU_LOST)
        .union(Self::IMU_STUCK)
        .union(Self::BATTERY_CRITICAL)
        .union(Self::BENCH_LOCK)
        .union(Self::TIME_UP)
        .union(Self::TILT_LIMIT);

    /// Returns the set of the conditions in `list` that hold.
    #[inline(always)]
    pub(crate) fn of<const N: usize>(list: [(Self, bool); N]) -> Self {
        // Without a branch: each bit is multiplied by one or zero.
        let bits =
            list.into_iter().fold(0, |all, (condition, holds)| all | (condition.bits() * u32::from(holds)));
        Self::from_bits_retain(bits)
    }
}

/// A row of the table: in state `from`, if all conditions of `when` and none of `unless` hold, the next state is
/// `to`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Row {
    /// State in which the row applies.
    pub from: ArmState,
    /// Conditions that must all hold.
    pub when: Conditions,
    /// Conditions of which none may hold.
    pub unless: Conditions,
    /// Next state. The same as `from` if the row refuses a request.
    pub to: ArmState,
    /// Reason that is reported.
    pub cause: Cause,
}

impl Row {
    fn matches(&self, now: Conditions) -> bool {
        // `when` and `unless` are disjoint, so one comparison covers both.
        now.intersection(self.when.union(self.unless)) == self.when
    }
}

const fn row(from: ArmState, when: Conditions, to: ArmState, cause: Cause) -> Row {
    Row { from, when, unless: Conditions::empty(), to, cause }
}

/// A row that refuses an arm request because of `obstacle`.
const fn refuse(obstacle: Conditions, cause: Cause) -> Row {
    row(ArmState::Disarmed, Conditions::ARM.union(obstacle), ArmState::Disarmed, cause)
}

/// A row that returns from `Arming` to `Disarmed` because `obstacle` has appeared.
const fn recheck(obstacle: Conditions, cause: Cause) -> Row {
    row(ArmState::Arming, obstacle, ArmState::Disarmed, cause)
}

impl Row {
    const fn unless(self, unless: Conditions) -> Self {
        Self { unless, ..self }
    }
}

use ArmState::{Armed, Arming, Bench, Descent, Disarmed, Maintenance, Terminated};

/// The rows of [`ArmState::Disarmed`]. Here and below, the first row that matches decides; without a match the state
/// stays.
pub const DISARMED: [Row; 15] = [
    row(Disarmed, Conditions::WATCHDOG_RESET, Terminated, Cause::WatchdogReset),
    row(Disarmed, Conditions::MAINTENANCE, Maintenance, Cause::Maintenance),
    refuse(Conditions::BENCH_LOCK, Cause::BenchLock),
    refuse(Conditions::BENCH_COMMAND, Cause::BenchCommand),
    // The flight controller never reports both: without a link there is no request (`rc::Requests`). The table does not
    // rely on this.
    refuse(Conditions::RC_LOST, Cause::RcLost),
    refuse(Conditions::THROTTLE_UP, Cause::ThrottleUp),
    refuse(Conditions::IMU_LOST, Cause::ImuLost),
    refuse(Conditions::IMU_STUCK, Cause::ImuStuck),
    refuse(Conditions::NO_CALIBRATION, Cause::NoCalibration),
    refuse(Conditions::NOT_STILL, Cause::NotStill),
    refuse(Conditions::NOT_LEVEL, Cause::NotLevel),
    refuse(Conditions::BATTERY_LOW, Cause::BatteryLow),
    refuse(Conditions::OVERLOAD, Cause::Overload),
    row(Disarmed, Conditions::ARM, Arming, Cause::Pilot),
    row(Disarmed, Conditions::BENCH_COMMAND, Bench, Cause::BenchCommand)
        .unless(Conditions::BENCH_EXPIRED.union(Conditions::DISARM)),
];

/// The rows of [`ArmState::Arming`].
pub const ARMING: [Row; 14] = [
    recheck(Conditions::MAINTENANCE, Cause::Maintenance),
    recheck(Conditions::BENCH_LOCK, Cause::BenchLock),
    recheck(Conditions::BENCH_COMMAND, Cause::BenchCommand),
    recheck(Conditions::RC_LOST, Cause::RcLost),
    recheck(Conditions::THROTTLE_UP, Cause::ThrottleUp),
    recheck(Conditions::IMU_LOST, Cause::ImuLost),
    recheck(Conditions::IMU_STUCK, Cause::ImuStuck),
    recheck(Conditions::NO_CALIBRATION, Cause::NoCalibration),
    recheck(Conditions::NOT_STILL, Cause::NotStill),
    recheck(Conditions::NOT_LEVEL, Cause::NotLevel),
    recheck(Conditions::BATTERY_LOW, Cause::BatteryLow),
    recheck(Conditions::OVERLOAD, Cause::Overload),
    recheck(Conditions::DISARM, Cause::Pilot),
    row(Arming, Conditions::TIME_UP, Armed, Cause::Checked),
];

/// The rows of [`ArmState::Armed`].
pub const ARMED: [Row; 8] = [
    row(Armed, Conditions::BENCH_LOCK, Terminated, Cause::BenchLock),
    row(Armed, Conditions::IMU_LOST, Terminated, Cause::ImuLost),
    row(Armed, Conditions::IMU_STUCK, Terminated, Cause::ImuStuck),
    row(Armed, Conditions::TILT_LIMIT, Terminated, Cause::TiltLimit),
    row(Armed, Conditions::DISARM, Disarmed, Cause::Pilot).unless(Conditions::RC_LOST),
    // With the throttle low the vehicle is on the ground or just above it: no rotor may spin up.
    row(Armed, Conditions::RC_LOST, Terminated, Cause::RcLost).unless(Conditions::THROTTLE_UP),
    row(Armed, Conditions::RC_LOST, Descent, Cause::RcLost),
    row(Armed, Conditions::BATTERY_CRITICAL, Descent, Cause::BatteryCritical),
];

/// The rows of [`ArmState::Descent`].
pub const DESCENT: [Row; 7] = [
    row(Descent, Conditions::BENCH_LOCK, Terminated, Cause::BenchLock),
    row(Descent, Conditions::IMU_LOST, Terminated, Cause::ImuLost),
    row(Descent, Conditions::IMU_STUCK, Terminated, Cause::ImuStuck),
    row(Descent, Conditions::TILT_LIMIT, Terminated, Cause::TiltLimit),
    row(Descent, Conditions::DISARM, Disarmed, Cause::Pilot).unless(Conditions::RC_LOST),
    // A descent with a link has no time limit: the pilot can land and disarm.
    row(Descent, Conditions::RC_LOST.union(Conditions::TIME_UP), Terminated, Cause::DescentOver),
    row(Descent, Conditions::empty(), Armed, Cause::RcBack)
        .unless(Conditions::RC_LOST.union(Conditions::BATTERY_CRITICAL)),
];

/// The rows of [`ArmState::Terminated`].
pub const TERMINATED: [Row; 2] = [
    row(Terminated, Conditions::DISARM, Disarmed, Cause::Pilot).unless(Conditions::RC_LOST),
    row(Terminated, Conditions::ARM, Terminated, Cause::NotAcknowledged),
];

/// The rows of [`ArmState::Bench`].
pub const BENCH: [Row; 5] = [
    row(Bench, Conditions::MAINTENANCE, Disarmed, Cause::Maintenance),
    row(Bench, Conditions::DISARM, Disarmed, Cause::Pilot),
    row(Bench, Conditions::ARM, Disarmed, Cause::BenchCommand),
    row(Bench, Conditions::BENCH_EXPIRED, Disarmed, Cause::BenchExpired),
    row(Bench, Conditions::empty(), Disarmed, Cause::BenchSilent).unless(Conditions::BENCH_COMMAND),
];

/// The rows of [`ArmState::Maintenance`].
pub const MAINTENANCE: [Row; 2] = [
    row(Maintenance, Conditions::empty(), Disarmed, Cause::MaintenanceOver).unless(Conditions::MAINTENANCE),
    row(Maintenance, Conditions::ARM, Maintenance, Cause::Maintenance),
];

/// Returns the rows of a state, in order of precedence.
pub const fn rows(state: ArmState) -> &'static [Row] {
    match state {
        Disarmed => &DISARMED,
        Arming => &ARMING,
        Armed => &ARMED,
        Descent => &DESCENT,
        Terminated => &TERMINATED,
        Bench => &BENCH,
        Maintenance => &MAINTENANCE,
    }
}

/// Returns the first row of `rows` that matches the conditions `now`.
pub fn decide(rows: &[Row], now: Conditions) -> Option<&Row> {
    rows.iter().find(|row| row.matches(now))
}
