//! Puts the vehicle into the image; lets the linker find the top-level memory.x, from whichever directory the build is
//! started; and says so if the image will not be the same as another machine's.

use std::path::{Path, PathBuf};
use std::process::exit;
use std::{env, fs};

use flight_core::{Config, FlightController, Params};
use stored_config::{MAX_RECORD, encode};
use vehicle::Vehicle;

const ROOT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/..");

/// The vehicle of an image that is built without saying which.
const DEFAULT_VEHICLE: &str = "os4";

fn main() {
    println!("cargo::rustc-link-search={ROOT}");
    println!("cargo::rerun-if-changed={ROOT}/memory.x");
    if env::var_os("CARGO_FEATURE_UNWIRED").is_none()
        && let Err(error) = put_vehicle_into_image()
    {
        eprintln!("error: KESTREL_VEHICLE: {error}");
        exit(1);
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

/// Reads the vehicle file that `KESTREL_VEHICLE` names (a built-in vehicle, or a path from the workspace's root), and
/// writes its configuration as a record, which the board decodes at start as it does a stored one. A vehicle that the
/// flight controller does not take fails here.
fn put_vehicle_into_image() -> Result<(), String> {
    println!("cargo::rerun-if-env-changed=KESTREL_VEHICLE");
    let named = env::var("KESTREL_VEHICLE").unwrap_or_else(|_| DEFAULT_VEHICLE.into());
    let path = Path::new(ROOT).join(&named);
    let place = if named.ends_with(".toml") {
        println!("cargo::rerun-if-changed={}", path.display());
        path.display().to_string()
    } else {
        named.clone()
    };
    let vehicle = Vehicle::load(&place).map_err(|error| error.to_string())?;
    // What the board has is put in at start.
    let config = Config { params: vehicle.flight_params(&Params::default()), calibration: None };
    FlightController::new(&config).map_err(|error| format!("{place}: {error}"))?;
    let mut record = [0; MAX_RECORD];
    let record = encode(&config, &mut record).map_err(|error| error.to_string())?;
    let out = PathBuf::from(env::var_os("OUT_DIR").ok_or("no OUT_DIR")?);
    fs::write(out.join("vehicle.bin"), record).map_err(|error| error.to_string())?;
    // Without its folder, which is this machine's.
    let name =
        Path::new(&named).file_stem().map_or(named.clone(), |stem| stem.to_string_lossy().into_owned());
    println!("cargo::rustc-env=KESTREL_VEHICLE_NAME={name}");
    println!("cargo::rustc-env=KESTREL_VEHICLE_ESC={}", vehicle.esc.name());
    Ok(())
}
