//! The command `config`: a scene's configuration as the record that the flight board reads from its flash.

use std::io::Write as _;
use std::path::Path;

use flight_core::Config;
use flight_core::calibration::{Calibration, SensorCalibration};
use input::InputError;
use serde_json::json;
use sim_host::output_file::{OutputFile, spare};
use stored_config::{MAX_RECORD, VERSION, encode};

use super::{Answer, ConfigArguments, load};

/// Where the flight board looks for the record: `STORED_CONFIG` in `memory.x`.
const ADDRESS: u32 = 0x0800_4000;
const CHIP: &str = "STM32F405RGTx";

/// Ends of the names of effects that a calibration takes out.
const TAKEN_OUT: [&str; 5] = ["bias", "scale_factor", "misalignment", "hard_iron", "soft_iron"];

pub fn run(arguments: &ConfigArguments) -> Result<Answer, InputError> {
    let scene = load(&arguments.scene, arguments.vehicle.as_deref(), None, None)?;
    spare(&scene.inputs(), &[("--out", Some(&arguments.out))])?;
    let mut buffer = [0; MAX_RECORD];
    // With how board and magnetometer lie in the vehicle, which the board takes from the record.
    let record = encode(&scene.board_config(), &mut buffer)
        .map_err(|error| InputError::new(error.to_string()).field("SCENE").value(&arguments.scene))?;
    write(&arguments.out, record)?;

    let file = arguments.out.display();
    let Config { params, calibration } = &scene.config;
    // Errors that only a calibration takes out: one of a scene that simulates them is that of the simulated sensors.
    let simulated: Vec<String> = scene
        .effects()
        .into_iter()
        .filter(|name| TAKEN_OUT.iter().any(|taken_out| name.ends_with(taken_out)))
        .map(|name| name.to_string())
        .collect();
    let calibration = match calibration {
        Some(calibration) if *calibration == Calibration::NONE => {
            "none measured: the datasheets' figures".into()
        }
        Some(_) if !simulated.is_empty() => {
            format!("of the scene's SIMULATED sensors ({}), not of yours", simulated.join(", "))
        }
        Some(calibration) => {
            let sensors = [("gyroscope", &calibration.gyro), ("accelerometer", &calibration.accel)];
            let sensors = sensors.into_iter().chain([("magnetometer", &calibration.mag)]);
            let (taken, measured): (Vec<_>, Vec<_>) =
                sensors.partition(|(_, sensor)| **sensor == SensorCalibration::NONE);
            let names =
                |list: Vec<(&str, _)>| list.iter().map(|(name, _)| *name).collect::<Vec<_>>().join(", ");
            match taken.len() {
                0 => "measured".to_owned(),
                _ => format!("measured: {}; the datasheet's figures: {}", names(measured), names(taken)),
            }
        }
        None => "missing: the board refuses to arm".into(),
    };
    let declination_deg = f64::from(params.estimator.declination_rad).to_degrees();
    let stuck_check = match (params.stuck_check.gyro, params.stuck_check.accel) {
        (true, true) => "gyroscope and accelerometer",
        (true, false) => "gyroscope only",
        (false, true) => "accelerometer only",
        (false, false) => "off: the scene's sensors have no noise, and the board's have",
    };
    let command =
        format!("probe-rs download --binary-format bin --base-address {ADDRESS:#010x} --chip {CHIP} {file}");
    let text = format!(
        "{}: configuration of the flight controller, {} bytes, version {VERSION}: {file}\n\n  \
         vehicle                  {}\n  \
         declination              {declination_deg:.3}° east\n  \
         inertial samples         {} Hz\n  \
         calibration              {calibration}\n  \
         stuck sensors looked for {stuck_check}\n\n\
         The flight board reads it at start from {ADDRESS:#010x}:\n  {command}",
        scene.name,
        record.len(),
        scene.vehicle_place,
        params.imu_rate_hz,
    );
    Ok(Answer {
        json: json!({
            "scene": scene.name,
            "file": file.to_string(),
            "bytes": record.len(),
            "version": VERSION,
            "vehicle": scene.vehicle_place,
            "declination_deg": declination_deg,
            "address": ADDRESS,
            "calibration": calibration,
            "stuck_check": stuck_check,
            "command": command,
        }),
        text,
        failed: false,
    })
}

fn write(path: &Path, record: &[u8]) -> Result<(), InputError> {
    let mut file = OutputFile::create(path)?;
    file.write_all(record).map_err(|error| file.error(&error))?;
    file.finish()
}

#[cfg(test)]
mod tests {
    #[test]
    fn the_address_is_that_of_the_memory_map() {
        let map = include_str!("../../../memory.x");
        let line = format!("STORED_CONFIG = {:#010x};", super::ADDRESS);
        assert!(map.lines().any(|of_map| of_map == line), "memory.x has no line {line}");
    }
}
