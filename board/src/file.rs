//! The tables and keys of a board file.

use std::collections::BTreeMap;

use serde::Deserialize;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct File {
    pub title: String,
    #[serde(default)]
    pub sources: Vec<String>,
    pub mcu: String,
    pub crystal_mhz: u32,
    pub imu: Imu,
    pub magnetometer: Magnetometer,
    pub receiver: Receiver,
    pub battery: Battery,
    pub led: Option<Led>,
    pub motors: BTreeMap<String, Motor>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Imu {
    pub chip: String,
    pub spi: String,
    pub sck: String,
    pub miso: String,
    pub mosi: String,
    pub select: String,
    #[serde(default)]
    pub deselect: Vec<String>,
    pub ready: String,
    pub axes: [String; 3],
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Magnetometer {
    pub i2c: String,
    pub scl: String,
    pub sda: String,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Receiver {
    pub serial: String,
    pub rx: String,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Battery {
    pub pin: String,
    pub ratio: f64,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Led {
    pub pin: String,
    pub on_level: OnLevel,
}

/// The level at which the LED lights.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "kebab-case")]
pub enum OnLevel {
    /// The LED lights at a low level.
    Low,
    /// The LED lights at a high level.
    High,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Motor {
    pub pin: String,
    pub timer: String,
    pub rotor: String,
}
