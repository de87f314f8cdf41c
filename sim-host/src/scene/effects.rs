//! `[effects.…]`: every effect that a scene can name, in the order in which it applies.

use serde::Deserialize;

use crate::effects::sensor::{
    AccelBiasInstability, AccelConstantBias, AccelQuantization, AccelRateRamp, AccelRateRandomWalk,
    AccelSaturation, AccelTemperature, AccelTurnOnBias, AccelVibration, AccelWhiteNoise, Bandwidth,
    GSensitivity, GyroBiasInstability, GyroConstantBias, GyroQuantization, GyroRateRamp, GyroRateRandomWalk,
    GyroSaturation, GyroTemperature, GyroTurnOnBias, GyroVibration, GyroWhiteNoise, HardIron, LeverArm,
    MagWhiteNoise, Misalignment, ScaleFactor,
};
use crate::effects::vehicle::{LinearDrag, MotorLag, RotorGyroscopic, VehicleEffect};
use crate::effects::{BoxedSensorEffect, Build, Recipe};
use crate::input_error::InputError;

/// A table of effects: one optional key each. The order of the fields is the order of application.
macro_rules! effect_table {
    ($(#[$doc:meta])* $table:ident, $prefix:literal, $effect:ty { $($key:ident: $recipe:ty),+ $(,)? }) => {
        $(#[$doc])*
        #[derive(Clone, Debug, Default, Deserialize)]
        #[serde(deny_unknown_fields)]
        pub struct $table {
            $($key: Option<$recipe>,)+
        }

        impl $table {
            /// Every effect of the table, and whether it is named, in the order of application.
            pub fn named(&self) -> Vec<(&'static str, bool)> {
                vec![$((concat!($prefix, ".", stringify!($key)), self.$key.is_some())),+]
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
                    list.push((name, recipe.build(&Build { name, ..with })));
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
    pub vehicle: VehicleEffects,
    #[serde(default)]
    pub gyro: GyroEffects,
    #[serde(default)]
    pub accel: AccelEffects,
    #[serde(default)]
    pub mag: MagEffects,
}

effect_table! {
    /// `[effects.vehicle]`
    VehicleEffects, "vehicle", VehicleEffect {
        motor_lag: MotorLag,
        linear_drag: LinearDrag,
        rotor_gyroscopic: RotorGyroscopic,
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
    /// `[effects.mag]`
    MagEffects, "mag", BoxedSensorEffect {
        hard_iron: HardIron,
        white_noise: MagWhiteNoise,
    }
}

impl Effects {
    /// Every effect there is, and whether the scene names it, in the order of application.
    pub fn named(&self) -> Vec<(&'static str, bool)> {
        [self.vehicle.named(), self.gyro.named(), self.accel.named(), self.mag.named()].concat()
    }

    pub fn validate(&self) -> Result<(), InputError> {
        self.vehicle.validate()?;
        self.gyro.validate()?;
        self.accel.validate()?;
        self.mag.validate()
    }
}
