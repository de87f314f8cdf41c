//! The firmware's image for QEMU: given, or built here.

use std::ffi::OsStr;
use std::fs;
use std::io::{IsTerminal as _, stderr};
use std::path::{Path, PathBuf};
use std::process::Command;

use input::InputError;

/// The microcontroller's architecture, as compilers call it.
const TARGET: &str = "thumbv7em-none-eabihf";

/// Whether the file is an image that QEMU can run; its full path.
///
/// # Errors
/// It can't be read, or is no ELF file for Arm.
pub fn check(image: &Path) -> Result<PathBuf, InputError> {
    let refused = |allowed: String| InputError::new(allowed).field("--image").value(image.display());
    let bytes = fs::read(image).map_err(|error| refused(format!("cannot be read: {error}")))?;
    // The magic number, and the machine at 18: EM_ARM.
    if !bytes.starts_with(b"\x7fELF") || bytes.get(18..20) != Some(&[40, 0]) {
        return Err(refused("must be an ELF image for Arm".into()));
    }
    fs::canonicalize(image).map_err(|error| refused(format!("cannot be found: {error}")))
}

/// The feature of the firmware that makes QEMU's pipes its link.
pub const PIPES: &str = "hil-qemu";
/// The feature that makes its USART6 the link.
pub const USART: &str = "hil-usart";

/// Builds the image with this feature, from the sources that this program was built from, in a target directory of
/// its own: an outer build's is locked.
///
/// # Errors
/// No sources, no cargo, or an image that does not build.
pub fn build(feature: &str) -> Result<PathBuf, InputError> {
    let refused =
        |what: String| InputError::new(format!("{what}: name an image by --image FILE")).file("firmware");
    let workspace = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    if !workspace.join("firmware/Cargo.toml").exists() {
        return Err(refused(format!("the sources are not in {}", workspace.display())));
    }
    let targets =
        std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| workspace.join("target"), PathBuf::from);
    let target = std::path::absolute(targets.join("hil-image").join(feature))
        .map_err(|error| refused(format!("no target directory: {error}")))?;
    let mut cargo = Command::new(std::env::var_os("CARGO").as_deref().unwrap_or(OsStr::new("cargo")));
    cargo
        .current_dir(&workspace)
        .args(["build", "--profile", "flash", "--package", "firmware", "--target", TARGET])
        .args(["--no-default-features", "--features", feature, "--target-dir"])
        .arg(&target)
        // These would replace the link arguments of .cargo/config.toml.
        .env_remove("RUSTFLAGS")
        .env_remove("CARGO_ENCODED_RUSTFLAGS");
    if !stderr().is_terminal() {
        cargo.arg("--quiet");
    }
    let status = cargo.status().map_err(|error| refused(format!("cargo does not run ({error})")))?;
    if !status.success() {
        return Err(refused("the image does not build".into()));
    }
    check(&target.join(TARGET).join("flash/firmware"))
}
