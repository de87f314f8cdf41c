//! The whole chain, joined: one call for each sample of the inertial sensor.

use crate::arithmetic::min;
use crate::arming::table::Conditions;
use crate::arming::{ArmState, Arming, Cause, Event};
use crate::battery::BatteryMonitor;
use crate::bench::Bench;
use crate::calibration::{Calibration, SensorFields, SensorModel};
use crate::config::Config;
use crate::control::Controller;
use crate::esc::Esc;
use crate::estimator::{Estimator, GyroZero};
use crate::geometry::{Quaternion, Vec3};
use crate::imu_check::ImuCheck;
use crate::mixer::{Mixer, Saturation, Wrench};
use crate::prefilter::{Biquad, Prefilter};
use crate::range::{ConfigError, check};
use crate::rc::request::SWITCH_OFF_TICKS;
use crate::rc::{ArmBy, FlightMode, Gesture, Link, Requests, Sticks};
use crate::sample::{ImuSample, Input, Output, RcFrame};
use crate::tilt_limit::TiltLimit;

/// Age of the last valid inertial sample at which the sensor counts as lost, µs.
pub const IMU_LOST_US: u32 = 100_000;
/// How long a missed deadline of the board's tasks stands against arming, µs.
const OVERLOAD_US: u32 = 1_000_000;
/// cos 25°: further from level than this, arming is refused.
const ARM_COS_TILT: f32 = 0.906_308;

/// The flight controller. It holds no clock: all time comes in with [`Input::time_us`].
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
    upset: TiltLimit,
    bench: Bench,
    calibrated: bool,
    descent_throttle: f32,

    /// Prefiltered body rates less the bias, learnt at rest and by the estimator, rad/s.
    rates: Vec3<f32>,
    /// A frame whose sticks are taken in the next step.
    waiting: Option<RcFrame>,
    /// The pilot's last sticks, and what else the last frame said.
    sticks: Sticks,
    gesture: Gesture,
    arm_switch: u16,
    saturation: Saturation,
    pulses_us: [f32; 4],
    time_us: Option<u64>,
    /// Time since the last valid inertial sample; the largest number before the first.
    imu_age_us: u32,
    /// Deadlines that had been missed up to the last step, and the time since the last one.
    missed_deadlines: u32,
    missed_age_us: u32,
}

impl FlightController {
    /// A disarmed flight controller.
    ///
    /// # Errors
    /// The first parameter found outside its range.
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
            upset: TiltLimit::new(p.control.max_tilt_rad),
            bench: Bench::new(&p.bench)?,
            calibrated: config.calibration.is_some(),
            descent_throttle: p.descent.throttle,
            rates: Vec3::ZERO,
            waiting: None,
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

    /// One step of the chain: takes what arrived, returns what the motors are to do.
    ///
    /// Call it once per inertial sample, and when a sample fails to come: a missing sensor stops nothing
    /// here, it ages, and until the next one the pulses stay as they are. A step whose time is not after the last
    /// one's repeats the last output; if it is before that by more than [`IMU_LOST_US`], the clock was set back,
    /// and time goes on from there.
    ///
    /// The output is finite and in range, whatever comes in: see [the crate's description](crate#any-input).
    #[inline]
    pub fn step(&mut self, input: &Input) -> Output {
        let (first, dt_us) = match self.time_us {
            Some(last) if input.time_us <= last => {
                // A few microseconds are two tasks' reading of one clock. A clock that was set back would otherwise
                // hold the motors at their last pulses until it catches up.
                if last - input.time_us > u64::from(IMU_LOST_US) {
                    self.time_us = Some(input.time_us);
                }
                return self.output(None);
            }
            // After more than a second everything is lost anyway.
            Some(last) => (false, (input.time_us - last).min(1_000_000) as u32),
            None => (true, 0),
        };
        self.time_us = Some(input.time_us);

        self.listen(input, dt_us);
        self.watch(input, dt_us);
        let fresh_s = self.estimate(input, dt_us);
        let event = self.arming.update(self.conditions(input, first), dt_us);
        if let Some(Event { to: ArmState::Descent, cause: Cause::RcLost, .. }) = event {
            // Whatever the sticks last said.
            self.waiting = None;
            self.controller.set_level(self.descent_throttle);
        }
        match self.arming.state() {
            // Between samples nothing is known that the last one has not answered. And their time is the
            // controller's: over the microseconds from a step without a sample to the late sample, a change of
            // rate would look like a blow.
            ArmState::Armed | ArmState::Descent => {
                let tilt = self.controller.holds_tilt().then(|| self.estimator.down().z);
                self.upset.update(tilt, dt_us);
                if let Some(dt_s) = fresh_s {
                    self.control(dt_s);
                }
            }
            ArmState::Bench => {
                self.rest();
                if let Some((rotor, share)) = self.bench.speed() {
                    for (index, pulse_us) in self.pulses_us.iter_mut().enumerate() {
                        if index == rotor {
                            *pulse_us = self.esc.pulse_of_share_us(share);
                        }
                    }
                }
            }
            _ => self.rest(),
        }
        self.output(event)
    }

    /// The pilot.
    #[inline(always)]
    fn listen(&mut self, input: &Input, dt_us: u32) {
        let fresh = self.link.take(input.rc.as_ref(), dt_us);
        // A step with the magnetometer is long enough: the sticks wait for the next one, once.
        let waits = input.mag.is_some() && self.waiting.is_none();
        let due = self.waiting.take();
        match fresh {
            Some(frame) if waits => self.waiting = Some(*frame),
            Some(frame) => self.take_sticks(frame),
            None => {
                if let Some(frame) = due {
                    self.take_sticks(&frame);
                }
            }
        }
        self.requests.update(self.arm_by, self.gesture, self.arm_switch, self.link.lost(), dt_us);
    }

    fn take_sticks(&mut self, frame: &RcFrame) {
        self.sticks = Sticks::from_frame(frame);
        self.gesture = self.sticks.gesture();
        self.arm_switch = frame.arm_switch;
        let descends = self.arming.state() == ArmState::Descent;
        let mode = if descends { FlightMode::Angle } else { FlightMode::from_frame(frame) };
        self.controller.set_sticks(&self.sticks, mode);
    }

    /// Supply, bench and board.
    #[inline(always)]
    fn watch(&mut self, input: &Input, dt_us: u32) {
        self.battery.update(input.battery, self.arming.state().flies(), dt_us);
        self.bench.update(input.bench.as_ref(), dt_us);
        self.missed_age_us = self.missed_age_us.saturating_add(dt_us);
        if input.health.missed_deadlines != self.missed_deadlines {
            self.missed_deadlines = input.health.missed_deadlines;
            self.missed_age_us = 0;
        }
    }

    /// Calibration, prefilter, gyro zero and estimator, for the sensors that brought something. Returns the time,
    /// s, that a new inertial sample covers; none after a gap.
    #[inline(always)]
    fn estimate(&mut self, input: &Input, dt_us: u32) -> Option<f32> {
        self.imu_age_us = self.imu_age_us.saturating_add(dt_us);
        let imu: Option<&ImuSample> = input.imu.as_ref().filter(|sample| ImuCheck::is_valid(sample));
        let gap = self.imu_age_us > IMU_LOST_US;
        if gap && imu.is_some() {
            // What was known of the attitude is too old, or there has been nothing yet: begin again.
            self.restart_estimation();
        }
        let mag = input.mag.map(|sample| self.mag_prefilter.step(self.mag_model.apply(sample.counts)));
        // A field that comes without an inertial sample has gone through its prefilter and is not missed.
        let sample = imu?;
        self.imu_check.take(sample);
        // The estimator's dt is the time since its last sample, not since the last step.
        let dt_s = if gap { 0.0 } else { self.imu_age_us as f32 * 1.0e-6 };
        self.imu_age_us = 0;

        let read = (self.gyro_model.apply(sample.gyro), self.accel_model.apply(sample.accel));
        let gyro = self.gyro_prefilter.step(read.0);
        let accel = self.accel_prefilter.step(read.1);
        if !self.arming.state().flies() {
            self.gyro_zero.learn(gyro, accel, dt_s);
            if self.zeroed_and_still() {
                self.estimator.gyro_zeroed();
            }
        }
        let zero = self.gyro_zero.bias();
        self.rates = gyro - zero;
        if self.estimator.is_a_low_pass() {
            self.estimator.update(read.0 - zero, read.1, mag, dt_s);
            self.rates = self.rates - self.estimator.gyro_bias();
        } else {
            self.estimator.update(self.rates, accel, mag, dt_s);
        }
        Some(dt_s)
    }

    /// After a gap in the samples the filters' pasts are no longer theirs.
    #[cold]
    fn restart_estimation(&mut self) {
        self.gyro_prefilter.restart();
        self.accel_prefilter.restart();
        self.mag_prefilter.restart();
        self.gyro_zero.interrupt();
        self.estimator.restart();
        if self.arming.state().flies() {
            self.estimator.gyro_zeroed();
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
            (Conditions::TILT_LIMIT, self.upset.exceeded()),
        ];
        if self.arming.state().flies() {
            // The other conditions stand in no row of a flight: `Conditions::IN_FLIGHT`.
            return Conditions::of(always);
        }
        // A tilt that is not a number is not level.
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

    /// No motor turns, and nothing is wound up.
    #[inline(always)]
    fn rest(&mut self) {
        self.saturation = Saturation::default();
        self.upset.update(None, 0);
        self.controller.rest(self.rates, self.estimator.heading());
        self.pulses_us = [self.esc.stop_us(); 4];
    }

    /// Controller, mixer and ESC map.
    #[inline(always)]
    fn control(&mut self, dt_s: f32) {
        let torque_n_m = self.controller.step(
            self.estimator.down(),
            self.estimator.heading(),
            self.rates,
            self.saturation,
            dt_s,
        );
        let descends = self.arming.state() == ArmState::Descent;
        let most = if descends { self.descent_throttle } else { 1.0 };
        let thrust_n = min(self.controller.throttle(), most) * self.mixer.max_thrust_n();
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

    /// Whether the motors may turn.
    pub fn state(&self) -> ArmState {
        self.arming.state()
    }

    /// The estimated attitude, body to world.
    pub fn attitude(&self) -> Quaternion<f32> {
        self.estimator.attitude()
    }

    /// Body rates after prefilter, gyro zero and the estimator's bias, rad/s.
    pub fn rates_rad_s(&self) -> Vec3<f32> {
        self.rates
    }

    /// The gyroscope's bias as learnt at rest, and what the estimator has found since, rad/s.
    pub fn gyro_bias_rad_s(&self) -> Vec3<f32> {
        self.gyro_zero.bias() + self.estimator.gyro_bias()
    }
}

#[cfg(all(test, not(miri)))]
// each arms a vehicle first, thousands of steps; Miri flies with `tests/any_input`
mod tests;
