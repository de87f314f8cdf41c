//! The complete control chain. Each call of [`FlightController::step`] processes one sample of the IMU.

use crate::arithmetic::min;
use crate::arming::table::Conditions;
use crate::arming::{ArmState, Arming, Cause, Event};
use crate::battery::BatteryMonitor;
use crate::bench::Bench;
use crate::calibration::{Calibration, SensorFields, SensorModel};
use crate::config::Config;
use crate::control::Controller;
use crate::esc::Esc;
use crate::estimator::{Estimator, FilterInput, GyroZero};
use crate::geometry::{Quaternion, Vec3};
use crate::imu_check::ImuCheck;
use crate::mixer::{Mixer, Saturation, Wrench};
use crate::prefilter::{Biquad, Prefilter};
use crate::range::{ConfigError, check};
use crate::rc::request::SWITCH_OFF_TICKS;
use crate::rc::{ArmBy, FlightMode, Gesture, Link, Requests, Sticks};
use crate::sample::{ImuSample, Input, Output, RcFrame};
use crate::tilt_limit::TiltLimit;

/// The IMU counts as lost if its last valid sample is older than this, µs.
pub const IMU_LOST_US: u32 = 100_000;
/// Time for which a missed deadline of the tasks prevents arming, µs.
const OVERLOAD_US: u32 = 1_000_000;
/// cos 25°. Arming is refused at a larger tilt.
const ARM_COS_TILT: f32 = 0.906_308;

/// The flight controller. It reads no clock: all time comes from [`Input::time_us`].
#[derive(Clone, Debug)]
pub struct FlightController {
    gyro_model: SensorModel,
    accel_model: SensorModel,
    mag_model: SensorModel,
    gyro_prefilter: Prefilter,
    accel_prefilter: Prefilter,
    mag_prefilter: Prefilter,
    gyro_zero: GyroZero,
    estimator: Estimator,
    controller: Controller,
    mixer: Mixer,
    esc: Esc,
    arming: Arming,
    link: Link,
    requests: Requests,
    arm_by: ArmBy,
    imu_check: ImuCheck,
    battery: BatteryMonitor,
    tilt_limit: TiltLimit,
    bench: Bench,
    calibrated: bool,
    descent_throttle: f32,

    /// Body rates after the prefilter, minus the bias learnt at rest and the bias learnt by the estimator, rad/s.
    rates: Vec3<f32>,
    /// A frame whose sticks are applied in the next step.
    pending_frame: Option<RcFrame>,
    /// Sticks, gesture and arm switch (ticks) of the last frame.
    sticks: Sticks,
    gesture: Gesture,
    arm_switch: u16,
    saturation: Saturation,
    pulses_us: [f32; 4],
    time_us: Option<u64>,
    /// Time since the last valid IMU sample, µs; `u32::MAX` before the first one.
    imu_age_us: u32,
    /// Number of missed deadlines at the last step, and time since that number last changed, µs.
    missed_deadlines: u32,
    missed_age_us: u32,
}

impl FlightController {
    /// Creates a disarmed flight controller.
    ///
    /// # Errors
    /// Returns the first parameter found outside its range, with its value and the range.
    pub fn new(config: &Config) -> Result<Self, ConfigError> {
        let p = &config.params;
        let calibration = config.calibration.unwrap_or(Calibration::NONE);
        check("imu_rate_hz", p.imu_rate_hz, 10.0, 32_000.0)?;
        check("mag_rate_hz", p.mag_rate_hz, 1.0, p.imu_rate_hz)?;
        check("min_arm_voltage_v", p.min_arm_voltage_v, 0.0, 100.0)?;
        check("critical_voltage_v", p.critical_voltage_v, 0.0, p.min_arm_voltage_v)?;
        check("descent.throttle", p.descent.throttle, 0.0, 1.0)?;
        check("descent.seconds", p.descent.seconds, 0.1, 600.0)?;
        p.channels.validate()?;
        let design = |rate_hz| {
            let section = p.prefilter_cutoff_hz.map(|cutoff_hz| Biquad::butterworth(cutoff_hz, rate_hz));
            Ok::<_, ConfigError>(Prefilter::new(section.transpose()?))
        };
        let esc = Esc::new(&p.esc, p.airframe.idle_rad_s, p.airframe.max_rad_s)?;
        Ok(Self {
            gyro_model: SensorModel::new(SensorFields::GYRO, p.gyro, calibration.gyro)?,
            accel_model: SensorModel::new(SensorFields::ACCEL, p.accel, calibration.accel)?,
            mag_model: SensorModel::new(SensorFields::MAG, p.mag, calibration.mag)?,
            gyro_prefilter: design(p.imu_rate_hz)?,
            accel_prefilter: design(p.imu_rate_hz)?,
            mag_prefilter: design(p.mag_rate_hz)?,
            gyro_zero: GyroZero::default(),
            estimator: Estimator::new(&p.estimator)?,
            controller: Controller::new(&p.control, p.airframe.inertia_kg_m2)?,
            mixer: Mixer::new(&p.airframe)?,
            esc,
            arming: Arming::new((p.descent.seconds * 1.0e6) as u32),
            link: Link::default(),
            requests: Requests::default(),
            arm_by: p.arm_by,
            imu_check: ImuCheck::new(p.stuck_check, p.imu_rate_hz),
            battery: BatteryMonitor::new(p.min_arm_voltage_v, p.critical_voltage_v),
            tilt_limit: TiltLimit::new(p.control.max_tilt_rad),
            bench: Bench::new(&p.bench)?,
            calibrated: config.calibration.is_some(),
            descent_throttle: p.descent.throttle,
            rates: Vec3::ZERO,
            pending_frame: None,
            sticks: Sticks::default(),
            gesture: Gesture::None,
            arm_switch: SWITCH_OFF_TICKS,
            saturation: Saturation::default(),
            pulses_us: [esc.stop_us(); 4],
            time_us: None,
            imu_age_us: u32::MAX,
            missed_deadlines: 0,
            missed_age_us: u32::MAX,
        })
    }

    /// Runs one step of the chain: processes the new inputs and returns the motor commands.
    ///
    /// Call it once per IMU sample, and also when a sample is overdue. A missing sample does not stop the flight
    /// controller: the age of the last sample grows, and the pulses stay as they are until the next sample.
    ///
    /// A step whose time is not later than that of the last step returns the last output again, without an event. If
    /// its time is earlier by more than [`IMU_LOST_US`], the clock was set back: the next step is measured from the
    /// new time.
    ///
    /// The output is finite and in range for any input: see [the crate documentation](crate#invalid-input).
    #[inline]
    pub fn step(&mut self, input: &Input) -> Output {
        let (first, dt_us) = match self.time_us {
            Some(last) if input.time_us <= last => {
                // A difference of a few microseconds occurs when two tasks read one clock. If the clock was set back,
                // waiting for it to catch up would hold the motors at their last pulses.
                if last - input.time_us > u64::from(IMU_LOST_US) {
                    self.time_us = Some(input.time_us);
                }
                return self.output(None);
            }
            // A longer time makes no difference: the IMU and the link are lost after less than one
            // second.
            Some(last) => (false, (input.time_us - last).min(1_000_000) as u32),
            None => (true, 0),
        };
        self.time_us = Some(input.time_us);

        self.update_pilot(input, dt_us);
        self.update_monitors(input, dt_us);
        let fresh_s = self.estimate(input, dt_us);
        let event = self.arming.update(self.conditions(input, first), dt_us);
        if let Some(Event { to: ArmState::Descent, cause: Cause::RcLost, .. }) = event {
            // Discards the last sticks.
            self.pending_frame = None;
            self.controller.set_level(self.descent_throttle);
        }
        match self.arming.state() {
            // Between samples the controller has no new information. The time of such a step belongs to the next
            // sample: a rate divided by the few microseconds between a step without a sample and the late sample
            // would look like a shock.
            ArmState::Armed | ArmState::Descent => {
                let tilt = self.controller.holds_tilt().then(|| self.estimator.down().z);
                self.tilt_limit.update(tilt, dt_us);
                if let Some(dt_s) = fresh_s {
                    self.control(dt_s);
                }
            }
            ArmState::Bench => {
                self.stop_motors();
                if let Some((rotor, share)) = self.bench.speed() {
                    for (index, pulse_us) in self.pulses_us.iter_mut().enumerate() {
                        if index == rotor {
                            *pulse_us = self.esc.pulse_of_share_us(share);
                        }
                    }
                }
            }
            _ => self.stop_motors(),
        }
        self.output(event)
    }

    /// Updates the link, the sticks and the requests of the pilot.
    #[inline(always)]
    fn update_pilot(&mut self, input: &Input, dt_us: u32) {
        let fresh = self.link.update(input.rc.as_ref(), dt_us);
        // A step with a magnetometer sample is already long: the sticks wait until the next step, once.
        let defer = input.mag.is_some() && self.pending_frame.is_none();
        let due = self.pending_frame.take();
        match fresh {
            Some(frame) if defer => self.pending_frame = Some(*frame),
            Some(frame) => self.apply_sticks(frame),
            None => {
                if let Some(frame) = due {
                    self.apply_sticks(&frame);
                }
            }
        }
        self.requests.update(self.arm_by, self.gesture, self.arm_switch, self.link.lost(), dt_us);
    }

    fn apply_sticks(&mut self, frame: &RcFrame) {
        self.sticks = Sticks::from_frame(frame);
        self.gesture = self.sticks.gesture();
        self.arm_switch = frame.arm_switch;
        let in_descent = self.arming.state() == ArmState::Descent;
        let mode = if in_descent { FlightMode::Angle } else { FlightMode::from_frame(frame) };
        self.controller.set_sticks(&self.sticks, mode);
    }

    /// Updates the monitors of battery, bench commands and missed deadlines.
    #[inline(always)]
    fn update_monitors(&mut self, input: &Input, dt_us: u32) {
        self.battery.update(input.battery, self.arming.state().flies(), dt_us);
        self.bench.update(input.bench.as_ref(), dt_us);
        self.missed_age_us = self.missed_age_us.saturating_add(dt_us);
        if input.health.missed_deadlines != self.missed_deadlines {
            self.missed_deadlines = input.health.missed_deadlines;
            self.missed_age_us = 0;
        }
    }

    /// Runs calibration, prefilter, gyro zero and estimator on the sensors that have new samples. Returns the time
    /// that a new IMU sample covers, s: 0 after a gap, and `None` without a new sample.
    #[inline(always)]
    fn estimate(&mut self, input: &Input, dt_us: u32) -> Option<f32> {
        self.imu_age_us = self.imu_age_us.saturating_add(dt_us);
        let imu: Option<&ImuSample> = input.imu.as_ref().filter(|sample| ImuCheck::is_valid(sample));
        let gap = self.imu_age_us > IMU_LOST_US;
        if gap && imu.is_some() {
            // The attitude is too old, or there has been no sample yet: the estimation starts again.
            self.restart_estimation();
        }
        let takes = self.estimator.input();
        let mag = input.mag.map(|sample| {
            let calibrated = self.mag_model.apply(sample.counts);
            let filtered = self.mag_prefilter.step(calibrated);
            if takes == FilterInput::Calibrated { calibrated } else { filtered }
        });
        // A magnetometer sample without an IMU sample passes its prefilter; the estimator does not need it.
        let sample = imu?;
        self.imu_check.update(sample);
        // The time step of the estimator is the time since its last sample, not since the last step.
        let dt_s = if gap { 0.0 } else { self.imu_age_us as f32 * 1.0e-6 };
        self.imu_age_us = 0;

        let calibrated = (self.gyro_model.apply(sample.gyro), self.accel_model.apply(sample.accel));
        let gyro = self.gyro_prefilter.step(calibrated.0);
        let accel = self.accel_prefilter.step(calibrated.1);
        if !self.arming.state().flies() {
            self.gyro_zero.learn(gyro, accel, dt_s);
            if self.zeroed_and_still() {
                self.estimator.on_gyro_zeroed();
            }
        }
        let zero = self.gyro_zero.bias();
        self.rates = gyro - zero;
        match takes {
            FilterInput::Prefiltered => self.estimator.update(self.rates, accel, mag, dt_s),
            FilterInput::Calibrated => {
                self.estimator.update(calibrated.0 - zero, calibrated.1, mag, dt_s);
                self.rates = self.rates - self.estimator.gyro_bias();
            }
        }
        Some(dt_s)
    }

    /// Resets all filters after a gap in the samples: their states belong to the time before the gap.
    #[cold]
    fn restart_estimation(&mut self) {
        self.gyro_prefilter.restart();
        self.accel_prefilter.restart();
        self.mag_prefilter.restart();
        self.gyro_zero.interrupt();
        self.estimator.restart();
        if self.arming.state().flies() {
            self.estimator.on_gyro_zeroed();
        }
    }

    fn zeroed_and_still(&self) -> bool {
        self.gyro_zero.still() && self.gyro_zero.zeroed()
    }

    #[inline(always)]
    fn conditions(&self, input: &Input, first: bool) -> Conditions {
        let health = &input.health;
        let always = [
            (Conditions::ARM, self.requests.arm()),
            (Conditions::DISARM, self.requests.disarm(self.arm_by)),
            (Conditions::RC_LOST, self.link.lost()),
            (Conditions::THROTTLE_UP, !self.sticks.throttle_is_low()),
            (Conditions::IMU_LOST, self.imu_age_us > IMU_LOST_US),
            (Conditions::IMU_STUCK, self.imu_check.stuck()),
            (Conditions::BATTERY_CRITICAL, self.battery.critical()),
            (Conditions::BENCH_LOCK, health.usb),
            (Conditions::TILT_LIMIT, self.tilt_limit.exceeded()),
        ];
        if self.arming.state().flies() {
            // The other conditions appear in no row of these states: `Conditions::IN_FLIGHT`.
            return Conditions::of(always);
        }
        // If the tilt is NaN, the vehicle does not count as level.
        let level = self.estimator.down().z >= ARM_COS_TILT;
        let on_the_ground = [
            (Conditions::NOT_STILL, !self.zeroed_and_still()),
            (Conditions::NOT_LEVEL, !level),
            (Conditions::NO_CALIBRATION, !self.calibrated),
            (Conditions::BATTERY_LOW, self.battery.low()),
            (Conditions::OVERLOAD, self.missed_age_us <= OVERLOAD_US),
            (Conditions::BENCH_COMMAND, self.bench.commanded()),
            (Conditions::BENCH_EXPIRED, self.bench.expired()),
            (Conditions::MAINTENANCE, health.maintenance),
            (Conditions::WATCHDOG_RESET, first && health.watchdog_reset),
        ];
        Conditions::of(always) | Conditions::of(on_the_ground)
    }

    /// Sets the stop pulses and resets controller, saturation and tilt limit.
    #[inline(always)]
    fn stop_motors(&mut self) {
        self.saturation = Saturation::default();
        self.tilt_limit.update(None, 0);
        self.controller.reset(self.rates, self.estimator.heading());
        self.pulses_us = [self.esc.stop_us(); 4];
    }

    /// Runs controller, mixer and ESC map.
    #[inline(always)]
    fn control(&mut self, dt_s: f32) {
        let torque_n_m = self.controller.step(
            self.estimator.down(),
            self.estimator.heading(),
            self.rates,
            self.saturation,
            dt_s,
        );
        let in_descent = self.arming.state() == ArmState::Descent;
        let max_throttle = if in_descent { self.descent_throttle } else { 1.0 };
        let thrust_n = min(self.controller.throttle(), max_throttle) * self.mixer.max_thrust_n();
        let (squares, saturation) = self.mixer.mix(&Wrench { thrust_n, torque_n_m });
        self.saturation = saturation;
        self.pulses_us = Mixer::speeds(squares).map(|speed| self.esc.pulse_us(speed));
    }

    fn output(&self, event: Option<Event>) -> Output {
        let bench = || self.bench.motor(|share| self.esc.pulse_of_share_us(share));
        Output {
            permit: self.arming.permit(bench),
            pulses_us: self.pulses_us,
            state: self.arming.state(),
            event,
        }
    }

    /// Returns the arm state.
    pub fn state(&self) -> ArmState {
        self.arming.state()
    }

    /// Returns the estimated attitude as a unit quaternion, body to world.
    pub fn attitude(&self) -> Quaternion<f32> {
        self.estimator.attitude()
    }

    /// Returns the body rates about x, y, z, rad/s: after the prefilter, minus gyro zero and the estimator's bias.
    pub fn rates_rad_s(&self) -> Vec3<f32> {
        self.rates
    }

    /// Returns the bias of the gyroscope, rad/s, body axes: the bias learnt at rest plus the bias learnt by the
    /// estimator.
    pub fn gyro_bias_rad_s(&self) -> Vec3<f32> {
        self.gyro_zero.bias() + self.estimator.gyro_bias()
    }
}

#[cfg(all(test, not(miri)))]
// each test first arms a vehicle, which takes thousands of steps; Miri runs `tests/any_input` instead
mod tests;
