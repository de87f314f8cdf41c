//! IMU presets: the converters of the chips, and the values of their errors.
//!
//! A preset gives values, and a scene names effects. `imu = "paper"` alone adds no error: it sets the converters. An
//! effect that the scene names without values takes those of the preset.

use std::path::Path;

use serde::Deserialize;
use toml::de::{DeTable, DeValue};

use super::effects::Effects;
use crate::sensors::Converter;
use input::InputError;
use input::check;
use input::layers::{Layers, ReadText, built_in_or_file};

macro_rules! presets {
    ($($name:literal),+ $(,)?) => {
        &[$(($name, include_str!(concat!("../../imus/", $name, ".toml")))),+]
    };
}

/// Name and text of the built-in presets.
pub const PRESETS: &[(&str, &str)] = presets!["paper", "icm-42688-p", "mpu-6050", "bmi088", "adis16448"];

/// Returns name and text of a built-in preset, or of a preset file whose path is relative to the scene.
pub fn find(imu: &str, scene: &Path, read: ReadText) -> Result<(String, String), InputError> {
    built_in_or_file("imu", PRESETS, imu, scene, read)
        .map_err(|(path, error)| {
            InputError::new(format!("cannot be read: {error}")).field("scene.imu").value(path.display())
        })?
        .ok_or_else(|| {
            check::unknown("scene.imu", imu, PRESETS.iter().map(|preset| preset.0))
                .also("; or the path of a preset file, which ends in .toml")
        })
}

/// A parsed preset file.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ImuPreset {
    gyro: GyroChip,
    accel: AccelChip,
    mag: MagChip,
    /// Values for the effects that a scene may name. They are checked even if the scene names none.
    #[serde(default)]
    effects: Effects,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct GyroChip {
    lsb_per_deg_s: f64,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct AccelChip {
    lsb_per_g: f64,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct MagChip {
    lsb_per_gauss: f64,
}

impl ImuPreset {
    /// Parses and checks a preset. Returns it with the table of its effects.
    pub fn read<'a>(
        layers: &mut Layers<'a>,
        name: &str,
        text: &'a str,
    ) -> Result<(Self, DeTable<'a>), InputError> {
        let table = layers.add(name, text)?;
        let located = |error| {
            let error = layers.locate(error, &table);
            if error.has_file() { error } else { error.file(name) }
        };
        let preset: Self = layers.read(&table).map_err(located)?;
        for (field, value) in [
            ("gyro.lsb_per_deg_s", preset.gyro.lsb_per_deg_s),
            ("accel.lsb_per_g", preset.accel.lsb_per_g),
            ("mag.lsb_per_gauss", preset.mag.lsb_per_gauss),
        ] {
            check::in_range(field, value, 0.1, 1e6, "counts").map_err(located)?;
        }
        preset.effects.validate().map_err(located)?;
        let effects = match table.get("effects").map(|effects| effects.get_ref()) {
            Some(DeValue::Table(effects)) => effects.clone(),
            _ => DeTable::new(),
        };
        Ok((preset, effects))
    }

    /// Returns the converters of gyroscope (rad/s), accelerometer (m/s²) and magnetometer (µT; 1 G is 100 µT).
    pub fn converters(&self) -> [Converter; 3] {
        [
            Converter::new(std::f64::consts::PI / 180.0 / self.gyro.lsb_per_deg_s),
            Converter::new(crate::dynamics::GRAVITY / self.accel.lsb_per_g),
            Converter::new(100.0 / self.mag.lsb_per_gauss),
        ]
    }
}
