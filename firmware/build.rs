//! Writes the board's wiring and the vehicle's configuration into the image, and lets the linker find the workspace's
//! memory.x from any working directory. Warns if the image will differ from another machine's.

use std::path::{Path, PathBuf};
use std::process::exit;
use std::{env, fs};

use board::Board;
use flight_core::{Config, FlightController, Params};
use stored_config::{MAX_RECORD, encode};
use vehicle::Vehicle;

const ROOT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/..");

fn main() {
    println!("cargo::rustc-link-search={ROOT}");
    println!("cargo::rerun-if-changed={ROOT}/memory.x");
    // Collects the strings of the log. It comes from defmt.
    println!("cargo::rustc-link-arg-bins=-Tdefmt.x");
    if env::var_os("CARGO_FEATURE_SIMULATED").is_some() {
        println!("cargo::rustc-env=KESTREL_BOARD_NAME=no sensors and no motors");
    } else {
        let vehicle = write_vehicle().map_err(|error| format!("KESTREL_VEHICLE: {error}"));
        let board = write_wiring().map_err(|error| format!("KESTREL_BOARD: {error}"));
        if let Err(error) = vehicle.and(board) {
            eprintln!("error: {error}");
            exit(1);
        }
    }

    // Cargo's output folder contains the name of the profile.
    let flashed = env::var("OUT_DIR").is_ok_and(|out| out.contains("/flash/"));
    if env::var_os("CARGO_FEATURE_SIMULATED").is_none() && !flashed {
        println!("cargo::warning=this is not the flash image: build that with --profile flash");
    }

    println!("cargo::rerun-if-env-changed=RUSTC");
    let compiler = env::var_os("RUSTC").and_then(|path| Path::new(&path).canonicalize().ok());
    if compiler != Path::new(ROOT).join(".cargo/rustc").canonicalize().ok() {
        println!(
            "cargo::warning=RUSTC is not .cargo/rustc: the image contains paths of this machine, and its bytes \
             differ from another machine's"
        );
    }
}

/// Returns the file or built-in name that the environment variable gives, as the loader takes it, and its display name.
/// A path is relative to the workspace's root; the display name has no folder, because the folder differs between
/// machines.
fn resolve(variable: &str, default: &str) -> (String, String) {
    println!("cargo::rerun-if-env-changed={variable}");
    let value = env::var(variable).unwrap_or_else(|_| default.into());
    if !value.ends_with(".toml") {
        return (value.clone(), value);
    }
    let path = Path::new(ROOT).join(&value);
    println!("cargo::rerun-if-changed={}", path.display());
    let name = path.file_stem().map_or(value, |stem| stem.to_string_lossy().into_owned());
    (path.display().to_string(), name)
}

fn write(name: &str, bytes: impl AsRef<[u8]>) -> Result<(), String> {
    let out = PathBuf::from(env::var_os("OUT_DIR").ok_or("no OUT_DIR")?);
    fs::write(out.join(name), bytes).map_err(|error| error.to_string())
}

/// Reads the vehicle's file and writes its configuration as a record. The firmware decodes it at start like a stored
/// record. A vehicle that the flight controller refuses makes the build fail here.
fn write_vehicle() -> Result<(), String> {
    let (source, name) = resolve("KESTREL_VEHICLE", vehicle::DEFAULT);
    let vehicle = Vehicle::load(&source).map_err(|error| error.to_string())?;
    // The firmware inserts the board's own values (sensitivities, IMU mounting) at start.
    let params = vehicle.with_mounting(vehicle.flight_params(&Params::default()));
    let config = Config { params, calibration: None };
    FlightController::new(&config).map_err(|error| format!("{source}: {error}"))?;
    let mut record = [0; MAX_RECORD];
    let record = encode(&config, &mut record).map_err(|error| error.to_string())?;
    write("vehicle.bin", record)?;
    println!("cargo::rustc-env=KESTREL_VEHICLE_NAME={name}");
    println!("cargo::rustc-env=KESTREL_VEHICLE_ESC={}", vehicle.esc.name());
    Ok(())
}

/// Reads the board's file and writes its wiring.
fn write_wiring() -> Result<(), String> {
    let (source, name) = resolve("KESTREL_BOARD", board::DEFAULT);
    let board = Board::load(&source).map_err(|error| error.to_string())?;
    write("wiring.rs", board.wiring())?;
    println!("cargo::rustc-env=KESTREL_BOARD_NAME={name}");
    Ok(())
}
