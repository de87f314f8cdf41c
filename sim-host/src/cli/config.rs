//! The command `config`: writes a scene's configuration as the record that the board reads from its flash.

use std::io::Write as _;
use std::path::Path;

use flight_core::Config;
use flight_core::calibration::{Calibration, SensorCalibration};
use input::InputError;
use serde_json::json;
use sim_host::output_file::{OutputFile, check_outputs};
use stored_config::{MAX_RECORD, VERSION, encode};

use super::{Answer, ConfigArguments, load};

/// Address in flash where the board reads the record: `STORED_CONFIG` in `memory.x`.
const ADDRESS: u32 = 0x0800_4000;
/// Name of the chip for probe-rs.
const CHIP: &str = "STM32F405RGTx";

/// Suffixes of the names of effects that a calibration corrects.
const CORRECTED: [&str; 5] = ["bias", "scale_factor", "misalignment", "hard_iron", "soft_iron"];

pub fn run(arguments: &ConfigArguments) -> Result<Answer, InputError> {
    let scene = load(&arguments.scene, arguments.vehicle.as_deref(), None, None)?;
    check_outputs(&scene.inputs(), &[("--out", Some(&arguments.out))])?;
    let mut buffer = [0; MAX_RECORD];
    // The record includes the mounting of board and magnetometer in the vehicle.
    let record = encode(&scene.board_config(), &mut buffer)
        .map_err(|error| InputError::new(error.to_string()).field("SCENE").value(&arguments.scene))?;
    write(&arguments.out, record)?;

    let file = arguments.out.display();
    let Config { params, calibration } = &scene.config;
    // If the scene simulates errors that a calibration corrects, its calibration is that of the simulated sensors.
    let simulated: Vec<String> = scene
        .effects()
        .into_iter()
        .filter(|name| CORRECTED.iter().any(|suffix| name.ends_with(suffix)))
        .map(|name| name.to_string())
        .collect();
    let calibration = match calibration {
        Some(calibration) if *calibration == Calibration::NONE => {
            "not measured: nominal values of the data sheets".into()
        }
        Some(_) if !simulated.is_empty() => {
            format!("of the scene's SIMULATED sensors ({}), not of real ones", simulated.join(", "))
        }
        Some(calibration) => {
            let sensors = [("gyroscope", &calibration.gyro), ("accelerometer", &calibration.accel)];
            let sensors = sensors.into_iter().chain([("magnetometer", &calibration.mag)]);
            let (nominal, measured): (Vec<_>, Vec<_>) =
                sensors.partition(|(_, sensor)| **sensor == SensorCalibration::NONE);
            let names =
                |list: Vec<(&str, _)>| list.iter().map(|(name, _)| *name).collect::<Vec<_>>().join(", ");
            match nominal.len() {
                0 => "measured".to_owned(),
                _ => format!(
                    "measured: {}; nominal values of the data sheets: {}",
                    names(measured),
                    names(nominal)
                ),
            }
        }
        None => "missing: the board refuses to arm".into(),
    };
    let declination_deg = f64::from(params.estimator.declination_rad).to_degrees();
    let stuck_check = match (params.stuck_check.gyro, params.stuck_check.accel) {
        (true, true) => "gyroscope and accelerometer",
        (true, false) => "gyroscope only",
        (false, true) => "accelerometer only",
        (false, false) => {
            "off: the scene's sensors have no noise, so the check would stop them; real sensors have noise"
        }
    };
    let command =
        format!("probe-rs download --binary-format bin --base-address {ADDRESS:#010x} --chip {CHIP} {file}");
    let text = format!(
        "{}: configuration of the flight controller, {} bytes, version {VERSION}: {file}\n\n  \
         vehicle                  {}\n  \
         declination              {declination_deg:.3}° east\n  \
         IMU samples              {} Hz\n  \
         calibration              {calibration}\n  \
         stuck-sensor check       {stuck_check}\n\n\
         The board reads the record at start from {ADDRESS:#010x}. To write it there:\n  {command}",
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
    fn address_equals_that_of_the_memory_map() {
        let map = include_str!("../../../memory.x");
        let line = format!("STORED_CONFIG = {:#010x};", super::ADDRESS);
        assert!(map.lines().any(|map_line| map_line == line), "memory.x has no line {line}");
    }
}
