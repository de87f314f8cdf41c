//! Puts the board's wiring and the vehicle into the image; lets the linker find the top-level memory.x, from whichever directory the build is
//! started; and says so if the image will not be the same as another machine's.

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
    if env::var_os("CARGO_FEATURE_UNWIRED").is_some() {
        println!("cargo::rustc-env=KESTREL_BOARD_NAME=no sensors and no motors");
    } else {
        let vehicle = put_vehicle_into_image().map_err(|error| format!("KESTREL_VEHICLE: {error}"));
        let board = put_board_into_image().map_err(|error| format!("KESTREL_BOARD: {error}"));
        if let Err(error) = vehicle.and(board) {
            eprintln!("error: {error}");
            exit(1);
        }
    }

    // The folder of a build is that of its profile.
    let flashed = env::var("OUT_DIR").is_ok_and(|out| out.contains("/flash/"));
    if env::var_os("CARGO_FEATURE_UNWIRED").is_none() && !flashed {
        println!("cargo::warning=this is not the image that is flashed, which is built with --profile flash");
    }

    println!("cargo::rerun-if-env-changed=RUSTC");
    let compiler = env::var_os("RUSTC").and_then(|path| Path::new(&path).canonicalize().ok());
    if compiler != Path::new(ROOT).join(".cargo/rustc").canonicalize().ok() {
        println!(
            "cargo::warning=RUSTC is not .cargo/rustc: paths of this machine get into the image, and its bytes cannot \
             be compared with another machine's"
        );
    }
}

/// What the variable names, a built-in thing or a path from the workspace's root: as the loader takes it, and its name for
/// people, without its folder, which is this machine's.
fn named(variable: &str, default: &str) -> (String, String) {
    println!("cargo::rerun-if-env-changed={variable}");
    let named = env::var(variable).unwrap_or_else(|_| default.into());
    if !named.ends_with(".toml") {
        return (named.clone(), named);
    }
    let path = Path::new(ROOT).join(&named);
    println!("cargo::rerun-if-changed={}", path.display());
    let name = path.file_stem().map_or(named, |stem| stem.to_string_lossy().into_owned());
    (path.display().to_string(), name)
}

fn write(name: &str, bytes: impl AsRef<[u8]>) -> Result<(), String> {
    let out = PathBuf::from(env::var_os("OUT_DIR").ok_or("no OUT_DIR")?);
    fs::write(out.join(name), bytes).map_err(|error| error.to_string())
}

/// Reads the vehicle's file, and writes its configuration as a record, which the board decodes at start as it does a stored
/// one. A vehicle that the flight controller does not take fails here.
fn put_vehicle_into_image() -> Result<(), String> {
    let (place, name) = named("KESTREL_VEHICLE", vehicle::DEFAULT);
    let vehicle = Vehicle::load(&place).map_err(|error| error.to_string())?;
    // What the board has is put in at start.
    let params = vehicle.mounted(vehicle.flight_params(&Params::default()));
    let config = Config { params, calibration: None };
    FlightController::new(&config).map_err(|error| format!("{place}: {error}"))?;
    let mut record = [0; MAX_RECORD];
    let record = encode(&config, &mut record).map_err(|error| error.to_string())?;
    write("vehicle.bin", record)?;
    println!("cargo::rustc-env=KESTREL_VEHICLE_NAME={name}");
    println!("cargo::rustc-env=KESTREL_VEHICLE_ESC={}", vehicle.esc.name());
    Ok(())
}

/// Reads the board's file, and writes its wiring.
fn put_board_into_image() -> Result<(), String> {
    let (place, name) = named("KESTREL_BOARD", board::DEFAULT);
    let board = Board::load(&place).map_err(|error| error.to_string())?;
    write("wiring.rs", board.wiring())?;
    println!("cargo::rustc-env=KESTREL_BOARD_NAME={name}");
    Ok(())
}
