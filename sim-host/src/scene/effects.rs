//! `[effects.…]`: every effect that a scene can name, in the order in which it applies.

use flight_core::sample::{ImuSample, MagSample, RcFrame};
use serde::Deserialize;

use crate::effects::delivery::{BoxedDelivery, ImuEffect, Latency, Loss, MagEffect, Outage, SamplingJitter};
use crate::effects::sensor::{
    AccelWhiteNoise, Disturbance, GyroWhiteNoise, HardIron, MagWhiteNoise, MotorCurrent, SoftIron,
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
    /// `[effects.vehicle]`
    VehicleEffects, "vehicle", VehicleEffect {
        motor_lag: MotorLag,
        linear_drag: LinearDrag,
        rotor_gyroscopic: RotorGyroscopic,
    }
}

effect_table! {
    /// `[effects.gyro]`
    GyroEffects, "gyro", BoxedSensorEffect {
        white_noise: GyroWhiteNoise,
    }
}

effect_table! {
    /// `[effects.accel]`
    AccelEffects, "accel", BoxedSensorEffect {
        white_noise: AccelWhiteNoise,
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
            self.vehicle.named(),
            self.gyro.named(),
            self.accel.named(),
            self.mag.named(),
            self.imu.named(),
        ]
        .concat()
    }

    pub fn validate(&self) -> Result<(), InputError> {
        self.vehicle.validate()?;
        self.gyro.validate()?;
        self.accel.validate()?;
        self.mag.validate()?;
        self.imu.validate()?;
        self.link.validate()
    }
}
