//! The arming table: which state follows from which, and why. Nothing else decides that.

use bitflags::bitflags;

use super::{ArmState, Cause};

bitflags! {
    /// What holds in a step, each a yes or no.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub struct Conditions: u32 {
        /// The pilot asks for the motors: the arm gesture held for 1 s, or the arm switch. Set until the asking is
        /// answered; then the pilot must let go before asking again.
        const ARM = 1 << 0;
        /// The pilot asks for the motors to stop: the disarm gesture held for 0.5 s, or the arm switch off for 0.1 s.
        const DISARM = 1 << 1;
        /// No frame from the receiver for 0.5 s, or the receiver itself says that its link is lost, or it has
        /// not been back for 0.5 s yet.
        const RC_LOST = 1 << 2;
        /// The last throttle of the pilot was 5 % or more.
        const THROTTLE_UP = 1 << 3;
        /// No valid inertial sample for 0.1 s: none at all, or the sensor's code for "invalid".
        const IMU_LOST = 1 << 4;
        /// An axis of the inertial sensor has read the same for 0.1 s, without being at the end of its range.
        const IMU_STUCK = 1 << 5;
        /// The vehicle has not lain still for 1 s, so that the gyroscope is not zeroed.
        const NOT_STILL = 1 << 6;
        /// More than 25° from level.
        const NOT_LEVEL = 1 << 7;
        /// The sensors of this vehicle have not been calibrated.
        const NO_CALIBRATION = 1 << 8;
        /// The battery is below the voltage at which a flight may start, or has not been measured for 2 s.
        const BATTERY_LOW = 1 << 9;
        /// The battery has been below the voltage at which a flight must end for 3 s; once set, until disarmed.
        const BATTERY_CRITICAL = 1 << 10;
        /// A task of the board has missed its deadline in the last second.
        const OVERLOAD = 1 << 11;
        /// USB is plugged in: people are about.
        const BENCH_LOCK = 1 << 12;
        /// A bench command is in force: its last heartbeat is no older than 0.25 s.
        const BENCH_COMMAND = 1 << 13;
        /// Bench commands have gone on for longer than one may.
        const BENCH_EXPIRED = 1 << 14;
        /// Somebody wants to erase flash, which stops the processor for up to half a second.
        const MAINTENANCE = 1 << 15;
        /// The watchdog has reset the board. Set in the first step only.
        const WATCHDOG_RESET = 1 << 16;
        /// The present state has lasted as long as it may: `Arming` 0.5 s, `Descent` as configured.
        const TIME_UP = 1 << 17;
        /// In angle mode the vehicle has been tilted by 20° more than the sticks can ask for, for half a second: a
        /// rotor is gone, or it lies on its back.
        const TILT_LIMIT = 1 << 18;
    }
}

impl Conditions {
    /// Those that stand in the rows of [`ArmState::Armed`] and [`ArmState::Descent`].
    pub const IN_FLIGHT: Self = Self::DISARM
        .union(Self::RC_LOST)
        .union(Self::THROTTLE_UP)
        .union(Self::IMU_LOST)
        .union(Self::IMU_STUCK)
        .union(Self::BATTERY_CRITICAL)
        .union(Self::BENCH_LOCK)
        .union(Self::TIME_UP)
        .union(Self::TILT_LIMIT);

    /// Those that hold.
    #[inline(always)]
    pub(crate) fn of<const N: usize>(list: [(Self, bool); N]) -> Self {
        // Without a branch: the condition times one or zero.
        let bits =
            list.into_iter().fold(0, |all, (condition, holds)| all | (condition.bits() * u32::from(holds)));
        Self::from_bits_retain(bits)
    }
}

/// A row: in state `from`, if all of `when` hold and none of `unless`, go to `to`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Row {
    /// The state that the row is for.
    pub from: ArmState,
    /// All of these hold.
    pub when: Conditions,
    /// None of these holds.
    pub unless: Conditions,
    /// The state that follows. The same one: a request is refused.
    pub to: ArmState,
    /// The reason that a person is told.
    pub cause: Cause,
}

impl Row {
    fn fits(&self, now: Conditions) -> bool {
        // No condition stands in both, so one comparison says it for all.
        now.intersection(self.when.union(self.unless)) == self.when
    }
}

const fn row(from: ArmState, when: Conditions, to: ArmState, cause: Cause) -> Row {
    Row { from, when, unless: Conditions::empty(), to, cause }
}

/// A request for the motors that finds `obstacle` is refused.
const fn refuse(obstacle: Conditions, cause: Cause) -> Row {
    row(ArmState::Disarmed, Conditions::ARM.union(obstacle), ArmState::Disarmed, cause)
}

/// An obstacle that comes up before the motors turn takes the arming back.
const fn recheck(obstacle: Conditions, cause: Cause) -> Row {
    row(ArmState::Arming, obstacle, ArmState::Disarmed, cause)
}

impl Row {
    const fn unless(self, unless: Conditions) -> Self {
        Self { unless, ..self }
    }
}

use ArmState::{Armed, Arming, Bench, Descent, Disarmed, Maintenance, Terminated};

/// The rows of [`ArmState::Disarmed`], the first that fits decides; none: nothing changes. Likewise below.
pub const DISARMED: [Row; 15] = [
    row(Disarmed, Conditions::WATCHDOG_RESET, Terminated, Cause::WatchdogReset),
    row(Disarmed, Conditions::MAINTENANCE, Maintenance, Cause::Maintenance),
    refuse(Conditions::BENCH_LOCK, Cause::BenchLock),
    refuse(Conditions::BENCH_COMMAND, Cause::BenchCommand),
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
    // Throttle low: on the ground, or as good as there. Nothing may spin up.
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
    // With a pilot on the link, who can land and disarm, there is no limit.
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

/// The rows of a state, in order.
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

/// The row of `rows` that decides under these conditions, if any does.
pub fn decide(rows: &[Row], now: Conditions) -> Option<&Row> {
    rows.iter().find(|row| row.fits(now))
}
