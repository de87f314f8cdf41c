//! The whole chain, joined: one call for each sample of the inertial sensor.

use crate::arming::{ArmState, Arming, Conditions, Event, IMU_LOST_US, RC_LOST_US};
use crate::calibration::{Calibration, SensorFields, SensorModel};
use crate::config::{Config, ConfigError, check};
use crate::control::Controller;
use crate::esc::Esc;
use crate::estimator::{Estimator, EstimatorParams, GyroZero};
use crate::geometry::{Quaternion, Vec3};
use crate::mixer::{Mixer, Saturation, Wrench};
use crate::prefilter::{Biquad, Prefilter};
use crate::rc::{Gesture, Sticks};
use crate::sample::{Input, Output};

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
    estimator_params: EstimatorParams,
    estimator: Estimator,
    controller: Controller,
    mixer: Mixer,
    esc: Esc,
    arming: Arming,
    min_arm_voltage_v: f32,

    /// Prefiltered body rates less the bias, rad/s.
    rates: Vec3<f32>,
    gesture: Gesture,
    battery_low: bool,
    saturation: Saturation,
    pulses_us: [f32; 4],
    time_us: Option<u64>,
    /// Time since the last inertial sample and receiver frame; the largest number before the first.
    imu_age_us: u32,
    rc_age_us: u32,
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
            estimator_params: p.estimator,
            estimator: Estimator::new(&p.estimator)?,
            controller: Controller::new(&p.control, p.airframe.inertia_kg_m2)?,
            mixer: Mixer::new(&p.airframe)?,
            esc,
            arming: Arming::default(),
            min_arm_voltage_v: p.min_arm_voltage_v,
            rates: Vec3::ZERO,
            gesture: Gesture::None,
            battery_low: false,
            saturation: Saturation::default(),
            pulses_us: [esc.stop_us(); 4],
            time_us: None,
            imu_age_us: u32::MAX,
            rc_age_us: u32::MAX,
        })
    }

    /// One step of the chain: takes what arrived, returns what the motors are to do.
    ///
    /// Call it once per inertial sample, and when a sample fails to come: a missing sensor stops nothing
    /// here, it ages. A step whose time is not after the last one's repeats the last output.
    #[inline]
    pub fn step(&mut self, input: &Input) -> Output {
        let dt_us = match self.time_us {
            Some(last) if input.time_us <= last => return self.output(None),
            // After more than a second everything is lost anyway.
            Some(last) => (input.time_us - last).min(1_000_000) as u32,
            None => 0,
        };
        let dt_s = dt_us as f32 * 1.0e-6;
        self.time_us = Some(input.time_us);
        self.imu_age_us = self.imu_age_us.saturating_add(dt_us);
        self.rc_age_us = self.rc_age_us.saturating_add(dt_us);

        if let Some(frame) = &input.rc {
            self.rc_age_us = 0;
            let sticks = Sticks::from_frame(frame);
            self.gesture = sticks.gesture();
            self.controller.set_sticks(&sticks);
        }
        if let Some(battery) = input.battery {
            self.battery_low = battery.voltage_v < self.min_arm_voltage_v;
        }
        self.estimate(input);
        let event = self.arming.update(&self.conditions(input), dt_s);
        let output = self.output(event);
        if output.permit.is_none() {
            self.saturation = Saturation::default();
            self.controller.rest(self.rates, self.estimator.heading());
            self.pulses_us = [self.esc.stop_us(); 4];
        } else {
            self.control(dt_s);
        }
        Output { pulses_us: self.pulses_us, ..output }
    }

    /// Calibration, prefilter, gyro zero and estimator, for the sensors that brought something.
    #[inline(always)]
    fn estimate(&mut self, input: &Input) {
        let gap = self.imu_age_us > IMU_LOST_US;
        if gap && input.imu.is_some() {
            // What was known of the attitude is too old, or there has been nothing yet: begin again.
            self.restart_estimation();
        }
        let mag = input.mag.map(|sample| self.mag_prefilter.step(self.mag_model.apply(sample.counts)));
        // A field that comes without an inertial sample has gone through its prefilter and is not missed.
        let Some(sample) = &input.imu else { return };
        // The estimator's dt is the time since its last sample, not since the last step.
        let dt_s = if gap { 0.0 } else { self.imu_age_us as f32 * 1.0e-6 };
        self.imu_age_us = 0;

        let gyro = self.gyro_prefilter.step(self.gyro_model.apply(sample.gyro));
        let accel = self.accel_prefilter.step(self.accel_model.apply(sample.accel));
        if self.arming.state() == ArmState::Disarmed {
            self.gyro_zero.learn(gyro, accel, dt_s);
        }
        self.rates = gyro - self.gyro_zero.bias();
        self.estimator.update(self.rates, accel, mag, dt_s);
    }

    /// After a gap in the samples the filters' pasts are no longer theirs.
    #[cold]
    fn restart_estimation(&mut self) {
        self.gyro_prefilter.restart();
        self.accel_prefilter.restart();
        self.mag_prefilter.restart();
        self.gyro_zero.interrupt();
        if let Ok(estimator) = Estimator::new(&self.estimator_params) {
            self.estimator = estimator;
        }
    }

    #[inline(always)]
    fn conditions(&self, input: &Input) -> Conditions {
        Conditions {
            gesture: self.gesture,
            rc_lost: self.rc_age_us > RC_LOST_US,
            imu_lost: self.imu_age_us > IMU_LOST_US,
            still: self.gyro_zero.still() && self.gyro_zero.zeroed(),
            cos_tilt: self.estimator.down().z,
            battery_low: self.battery_low,
            bench_lock: input.health.bench_lock,
        }
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
        let thrust_n = self.controller.throttle() * self.mixer.max_thrust_n();
        let (squares, saturation) = self.mixer.mix(&Wrench { thrust_n, torque_n_m });
        self.saturation = saturation;
        self.pulses_us = Mixer::speeds(squares).map(|speed| self.esc.pulse_us(speed));
    }

    fn output(&self, event: Option<Event>) -> Output {
        Output { permit: self.arming.permit(), pulses_us: self.pulses_us, state: self.arming.state(), event }
    }

    /// Whether the motors may turn.
    pub fn state(&self) -> ArmState {
        self.arming.state()
    }

    /// The estimated attitude, body to world.
    pub fn attitude(&self) -> Quaternion<f32> {
        self.estimator.attitude()
    }

    /// Body rates after prefilter and gyro zero, rad/s.
    pub fn rates_rad_s(&self) -> Vec3<f32> {
        self.rates
    }

    /// The gyroscope's bias as learnt at rest, rad/s.
    pub fn gyro_bias_rad_s(&self) -> Vec3<f32> {
        self.gyro_zero.bias()
    }
}
