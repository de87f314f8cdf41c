//! `[effects.…]`: every effect that a scene can name, in the order in which it applies.

use serde::Deserialize;

use crate::effects::sensor::{AccelWhiteNoise, GyroWhiteNoise, HardIron, MagWhiteNoise};
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

    /// Leaves an effect out; whether it was named.
    pub fn leave_out(&mut self, name: &str) -> bool {
        self.vehicle.leave_out(name)
            || self.gyro.leave_out(name)
            || self.accel.leave_out(name)
            || self.mag.leave_out(name)
    }

    pub fn validate(&self) -> Result<(), InputError> {
        self.vehicle.validate()?;
        self.gyro.validate()?;
        self.accel.validate()?;
        self.mag.validate()
    }
}
