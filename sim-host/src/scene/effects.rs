//! `[effects.…]`: all effects that a scene can name, in the order in which they are applied.

use flight_core::imu_check::StuckCheck;
use flight_core::sample::{ImuSample, MagSample, RcFrame};
use serde::Deserialize;

use crate::effects::delivery::{BoxedDelivery, ImuEffect, Latency, Loss, MagEffect, Outage, SamplingJitter};
use crate::effects::sensor::{
    AccelBiasInstability, AccelConstantBias, AccelQuantization, AccelRateRamp, AccelRateRandomWalk,
    AccelSaturation, AccelTemperature, AccelTurnOnBias, AccelVibration, AccelWhiteNoise, Bandwidth,
    Disturbance, GSensitivity, GyroBiasInstability, GyroBiasStep, GyroConstantBias, GyroQuantization,
    GyroRateRamp, GyroRateRandomWalk, GyroSaturation, GyroTemperature, GyroTurnOnBias, GyroVibration,
    GyroWhiteNoise, HardIron, LeverArm, MagWhiteNoise, Misalignment, MotorCurrent, ScaleFactor, SoftIron,
};
use crate::effects::vehicle::{
    BatterySag, CgOffset, ConstantWind, Dryden, EscDelay, EscQuantization, GroundEffect, LinearDrag,
    MotorFailure, MotorLag, QuadraticDrag, RotorAcceleration, RotorDrag, RotorGyroscopic, VehicleEffect,
};
use crate::effects::{BoxedSensorEffect, BuildContext, EffectParams};
use crate::scene::DEFAULT_RATE_HZ;
use crate::sensors::Converter;
use input::InputError;

/// Defines a table of effects with one optional key for each. The order of the fields is the order of application.
macro_rules! effect_table {
    ($(#[$doc:meta])* $table:ident, $prefix:literal, $effect:ty { $($key:ident: $params:ty),+ $(,)? }) => {
        $(#[$doc])*
        #[derive(Clone, Debug, Default, Deserialize)]
        #[serde(deny_unknown_fields)]
        pub struct $table {
            $(pub(super) $key: Option<$params>,)+
        }

        impl $table {
            /// Returns each effect of the table and whether it is named, in the order of application.
            pub fn named(&self) -> Vec<(&'static str, bool)> {
                vec![$((concat!($prefix, ".", stringify!($key)), self.$key.is_some())),+]
            }

            /// Removes an effect. Returns whether it was named.
            pub fn remove(&mut self, name: &str) -> bool {
                $(if name == concat!($prefix, ".", stringify!($key)) {
                    return self.$key.take().is_some();
                })+
                false
            }

            /// Checks the values of the named effects.
            pub fn validate(&self) -> Result<(), InputError> {
                $(if let Some(params) = &self.$key {
                    params.validate(concat!("effects.", $prefix, ".", stringify!($key)))?;
                })+
                Ok(())
            }

            /// Returns the key and the value of the start of each named effect that has one, s.
            fn starts(&self) -> Vec<(String, f64)> {
                let starts = [$((
                    concat!("effects.", $prefix, ".", stringify!($key), ".at_s"),
                    self.$key.as_ref().and_then(EffectParams::at_s),
                )),+];
                starts.into_iter().filter_map(|(key, at_s)| Some((key.to_owned(), at_s?))).collect()
            }

            /// Builds the named effects.
            pub fn build(&self, context: BuildContext) -> Vec<(&'static str, $effect)> {
                let mut list = Vec::new();
                $(if let Some(params) = &self.$key {
                    let name = concat!($prefix, ".", stringify!($key));
                    list.push((name, params.build(&BuildContext { name, ..context }).into()));
                })+
                list
            }
        }
    };
}

/// `[effects]`
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Effects {
    #[serde(default)]
    pub wind: WindEffects,
    #[serde(default)]
    pub vehicle: VehicleEffects,
    #[serde(default)]
    pub gyro: GyroEffects,
    #[serde(default)]
    pub accel: AccelEffects,
    #[serde(default)]
    pub mag: MagEffects,
    #[serde(default)]
    pub imu: ImuEffects,
    #[serde(default)]
    pub link: LinkEffects,
}

effect_table! {
    /// `[effects.wind]`
    WindEffects, "wind", VehicleEffect {
        constant: ConstantWind,
        dryden: Dryden,
    }
}

effect_table! {
    /// `[effects.vehicle]`: effects on the ESC command, the rotor speed, the thrust and the body, in this order.
    VehicleEffects, "vehicle", VehicleEffect {
        esc_delay: EscDelay,
        esc_quantization: EscQuantization,
        battery_sag: BatterySag,
        motor_failure: MotorFailure,
        motor_lag: MotorLag,
        ground_effect: GroundEffect,
        linear_drag: LinearDrag,
        quadratic_drag: QuadraticDrag,
        rotor_drag: RotorDrag,
        rotor_gyroscopic: RotorGyroscopic,
        rotor_acceleration: RotorAcceleration,
        cg_offset: CgOffset,
    }
}

// Gyroscope and accelerometer: the order follows the signal through the chip.
//
// 1. Input of the sensing element: the motion at its position (lever_arm) and the vibration of the frame.
// 2. Bandwidth of the mechanics and the analogue part (bandwidth). The whole input passes through it.
// 3. Cross-sensitivity to acceleration (g_sensitivity): a static coupling to the true force, without vibration. A scene
//    gives the vibration of the rate to the gyroscope directly.
// 4. Gain: misalignment turns the true vector into the axes of the element, scale_factor scales each axis, and temperature
//    changes gain and bias together. Gains come before the biases, so that a bias is the reading of a sensor at rest, and
//    a constant temperature at the reference has no effect.
// 5. Bias, which no gain multiplies: from the constant to the fastest, then white_noise, which is the output noise of a
//    data sheet.
// 6. Output: saturation of the amplifier, then quantization, before the quantization of the converter.
effect_table! {
    /// `[effects.gyro]`
    GyroEffects, "gyro", BoxedSensorEffect {
        vibration: GyroVibration,
        bandwidth: Bandwidth,
        g_sensitivity: GSensitivity,
        misalignment: Misalignment,
        scale_factor: ScaleFactor,
        temperature: GyroTemperature,
        constant_bias: GyroConstantBias,
        turn_on_bias: GyroTurnOnBias,
        bias_step: GyroBiasStep,
        rate_ramp: GyroRateRamp,
        rate_random_walk: GyroRateRandomWalk,
        bias_instability: GyroBiasInstability,
        white_noise: GyroWhiteNoise,
        saturation: GyroSaturation,
        quantization: GyroQuantization,
    }
}

effect_table! {
    /// `[effects.accel]`
    AccelEffects, "accel", BoxedSensorEffect {
        lever_arm: LeverArm,
        vibration: AccelVibration,
        bandwidth: Bandwidth,
        misalignment: Misalignment,
        scale_factor: ScaleFactor,
        temperature: AccelTemperature,
        constant_bias: AccelConstantBias,
        turn_on_bias: AccelTurnOnBias,
        rate_ramp: AccelRateRamp,
        rate_random_walk: AccelRateRandomWalk,
        bias_instability: AccelBiasInstability,
        white_noise: AccelWhiteNoise,
        saturation: AccelSaturation,
        quantization: AccelQuantization,
    }
}

effect_table! {
    /// `[effects.mag]`: the ambient field, the effects of the vehicle on it, then those of the sensor.
    MagEffects, "mag", MagEffect {
        disturbance: Disturbance,
        soft_iron: SoftIron,
        motor_current: MotorCurrent,
        hard_iron: HardIron,
        white_noise: MagWhiteNoise,
        latency: Latency<MagSample>,
        dropped_samples: Loss<MagSample>,
    }
}

effect_table! {
    /// `[effects.imu]`: effects on the delivery of IMU samples. Faults come before the latency.
    ImuEffects, "imu", ImuEffect {
        sampling_jitter: SamplingJitter,
        latency: Latency<ImuSample>,
        dropped_samples: Loss<ImuSample>,
    }
}

effect_table! {
    /// `[effects.link]`: effects on the delivery of the transmitter's frames.
    LinkEffects, "link", BoxedDelivery<RcFrame> {
        latency: Latency<RcFrame>,
        loss: Loss<RcFrame>,
        outage: Outage,
    }
}

impl Effects {
    /// Returns all known effects and whether the scene names each, in the order of application.
    pub fn named(&self) -> Vec<(&'static str, bool)> {
        [
            self.link.named(),
            self.wind.named(),
            self.vehicle.named(),
            self.gyro.named(),
            self.accel.named(),
            self.mag.named(),
            self.imu.named(),
        ]
        .concat()
    }

    /// Returns the key and the value of the start of each named effect that has one, s.
    pub fn starts(&self) -> Vec<(String, f64)> {
        [
            self.link.starts(),
            self.wind.starts(),
            self.vehicle.starts(),
            self.gyro.starts(),
            self.accel.starts(),
            self.mag.starts(),
            self.imu.starts(),
        ]
        .concat()
    }

    /// Returns which sensors are checked for being stuck. A constant reading is a fault only in a sensor with enough noise:
    /// white noise of half a count or more per sample, and no quantization coarser than the chip's. A sensor without
    /// errors may stay constant.
    pub fn stuck_check(&self, converters: &[Converter; 3]) -> StuckCheck {
        let [gyro, accel, _] = converters;
        let noisy = |density: [f64; 3], converter: &Converter| {
            let min = 0.5 * converter.per_count() / f64::from(DEFAULT_RATE_HZ).sqrt();
            density.iter().all(|n| *n >= min)
        };
        let Self { gyro: of_gyro, accel: of_accel, .. } = self;
        StuckCheck {
            gyro: of_gyro.quantization.is_none()
                && of_gyro.white_noise.as_ref().is_some_and(|noise| {
                    noisy(noise.n_deg_per_sqrt_h.map(|n| (n / 60.0).to_radians()), gyro)
                }),
            accel: of_accel.quantization.is_none()
                && of_accel.white_noise.as_ref().is_some_and(|noise| noisy(noise.n_m_s2_per_sqrt_hz, accel)),
        }
    }

    /// Removes an effect. Returns whether it was named.
    pub fn remove(&mut self, name: &str) -> bool {
        self.link.remove(name)
            || self.wind.remove(name)
            || self.vehicle.remove(name)
            || self.gyro.remove(name)
            || self.accel.remove(name)
            || self.mag.remove(name)
            || self.imu.remove(name)
    }

    /// Checks the values of the named effects, and that each has the other effects that it needs.
    pub fn validate(&self) -> Result<(), InputError> {
        self.wind.validate()?;
        self.vehicle.validate()?;
        self.check_dependencies()?;
        self.gyro.validate()?;
        self.accel.validate()?;
        self.mag.validate()?;
        self.imu.validate()?;
        self.link.validate()
    }

    /// Checks that no named effect is without consequence because another one is missing.
    fn check_dependencies(&self) -> Result<(), InputError> {
        let vehicle = &self.vehicle;
        let has_drag =
            vehicle.linear_drag.is_some() || vehicle.quadratic_drag.is_some() || vehicle.rotor_drag.is_some();
        let wind = self.wind.named().into_iter().find_map(|(name, named)| named.then_some(name));
        if let Some(wind) = wind.filter(|_| !has_drag) {
            return Err(InputError::new(
                "needs vehicle.linear_drag, vehicle.quadratic_drag or vehicle.rotor_drag: wind acts only through drag",
            )
            .field(format!("effects.{wind}")));
        }
        if vehicle.rotor_acceleration.is_some() && vehicle.motor_lag.is_none() {
            return Err(InputError::new(
                "needs vehicle.motor_lag: without a lag the rotor speed changes in a step",
            )
            .field("effects.vehicle.rotor_acceleration"));
        }
        Ok(())
    }
}
