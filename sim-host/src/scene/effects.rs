//! `[effects.…]`: every effect that a scene can name, in the order in which it applies.

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
use crate::effects::{BoxedSensorEffect, Build, Recipe};
use crate::scene::DEFAULT_RATE_HZ;
use crate::sensors::Converter;
use input::InputError;

/// A table of effects: one optional key each. The order of the fields is the order of application.
macro_rules! effect_table {
    ($(#[$doc:meta])* $table:ident, $prefix:literal, $effect:ty { $($key:ident: $recipe:ty),+ $(,)? }) => {
        $(#[$doc])*
        #[derive(Clone, Debug, Default, Deserialize)]
        #[serde(deny_unknown_fields)]
        pub struct $table {
            $(pub(super) $key: Option<$recipe>,)+
        }

        impl $table {
            /// Every effect of the table, and whether it is named, in the order of application.
            pub fn named(&self) -> Vec<(&'static str, bool)> {
                vec![$((concat!($prefix, ".", stringify!($key)), self.$key.is_some())),+]
            }

            /// Leaves an effect out; whether it was named.
            pub fn leave_out(&mut self, name: &str) -> bool {
                $(if name == concat!($prefix, ".", stringify!($key)) {
                    return self.$key.take().is_some();
                })+
                false
            }

            pub fn validate(&self) -> Result<(), InputError> {
                $(if let Some(recipe) = &self.$key {
                    recipe.validate(concat!("effects.", $prefix, ".", stringify!($key)))?;
                })+
                Ok(())
            }

            /// Builds what is named.
            pub fn build(&self, with: Build) -> Vec<(&'static str, $effect)> {
                let mut list = Vec::new();
                $(if let Some(recipe) = &self.$key {
                    let name = concat!($prefix, ".", stringify!($key));
                    list.push((name, recipe.build(&Build { name, ..with }).into()));
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
    /// `[effects.vehicle]`: command, rotor speed, thrust, body.
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

// Gyroscope and accelerometer: the order is the way of the signal through the chip.
//
// 1. What the element really feels: the motion where it sits (lever_arm), and the frame's vibration.
// 2. What its mechanics and analogue part pass: bandwidth. All that is felt goes through it.
// 3. What it takes for a rate: g_sensitivity. It is a static coupling by the true force, whose own vibration a
//    scene gives to the gyroscope directly.
// 4. Its gain: misalignment turns the true vector into the element's axes, scale_factor is each axis's own, and
//    temperature changes gain and zero together. Gains come before the biases, so that a bias is what a sensor
//    at rest shows, and a temperature that stays at its reference changes nothing.
// 5. Its zero, which no gain multiplies: biases from the constant to the fastest, then white_noise, which
//    is the noise that a datasheet gives for the output.
// 6. Its number: saturation of the amplifier and then quantization, before the converter's own.
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
    /// `[effects.mag]`: the ambient field, what the vehicle makes of it and adds to it, the sensor.
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
    /// `[effects.imu]`: the samples of gyroscope and accelerometer. Faults come before the latency.
    ImuEffects, "imu", ImuEffect {
        sampling_jitter: SamplingJitter,
        latency: Latency<ImuSample>,
        dropped_samples: Loss<ImuSample>,
    }
}

effect_table! {
    /// `[effects.link]`: the frames from the transmitter.
    LinkEffects, "link", BoxedDelivery<RcFrame> {
        latency: Latency<RcFrame>,
        loss: Loss<RcFrame>,
        outage: Outage,
    }
}

impl Effects {
    /// Every effect there is, and whether the scene names it, in the order of application.
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

    /// Which sensors are noisy enough that one which stands still must be stuck: half a count of white noise, and
    /// no coarser steps than the chip's own. A sensor without errors may stand still for ever.
    pub fn stuck_check(&self, converters: &[Converter; 3]) -> StuckCheck {
        let [gyro, accel, _] = converters;
        let noisy = |density: [f64; 3], converter: &Converter| {
            let least = 0.5 * converter.per_count() / f64::from(DEFAULT_RATE_HZ).sqrt();
            density.iter().all(|n| *n >= least)
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

    /// Leaves an effect out; whether it was named.
    pub fn leave_out(&mut self, name: &str) -> bool {
        self.link.leave_out(name)
            || self.wind.leave_out(name)
            || self.vehicle.leave_out(name)
            || self.gyro.leave_out(name)
            || self.accel.leave_out(name)
            || self.mag.leave_out(name)
            || self.imu.leave_out(name)
    }

    pub fn validate(&self) -> Result<(), InputError> {
        self.wind.validate()?;
        self.vehicle.validate()?;
        self.nothing_in_vain()?;
        self.gyro.validate()?;
        self.accel.validate()?;
        self.mag.validate()?;
        self.imu.validate()?;
        self.link.validate()
    }

    /// Refuses what would do nothing for want of another effect.
    fn nothing_in_vain(&self) -> Result<(), InputError> {
        let vehicle = &self.vehicle;
        let has_drag =
            vehicle.linear_drag.is_some() || vehicle.quadratic_drag.is_some() || vehicle.rotor_drag.is_some();
        let wind = self.wind.named().into_iter().find_map(|(name, named)| named.then_some(name));
        if let Some(wind) = wind.filter(|_| !has_drag) {
            return Err(InputError::new(
                "a wind acts by drag alone: name vehicle.linear_drag, vehicle.quadratic_drag or vehicle.rotor_drag",
            )
            .field(format!("effects.{wind}")));
        }
        if vehicle.rotor_acceleration.is_some() && vehicle.motor_lag.is_none() {
            return Err(InputError::new(
                "without a lag rotors have no acceleration, their speeds jump: name vehicle.motor_lag",
            )
            .field("effects.vehicle.rotor_acceleration"));
        }
        Ok(())
    }
}
