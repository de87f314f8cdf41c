//! The firmware's image for QEMU: checks a given one, or builds one.

use std::fs;
use std::path::{Path, PathBuf};

use input::InputError;

use crate::image;
use crate::input_file::read_image;

/// Checks that a file is an image that QEMU can run, and returns its full path.
///
/// # Errors
/// The file cannot be read, or is not an ELF file for Arm.
pub fn check(image: &Path) -> Result<PathBuf, InputError> {
    let refused = |allowed: String| InputError::new(allowed).field("--image").value(image.display());
    let bytes = read_image(image).map_err(|error| refused(format!("cannot be read: {error}")))?;
    // The magic number at offset 0, and the machine at offset 18: 40 is EM_ARM.
    if !bytes.starts_with(b"\x7fELF") || bytes.get(18..20) != Some(&[40, 0]) {
        return Err(refused("must be an ELF image for Arm".into()));
    }
    fs::canonicalize(image).map_err(|error| refused(format!("cannot be found: {error}")))
}

/// Cargo feature of the firmware whose link is QEMU's pipes.
pub const PIPES: &str = "hil-qemu";
/// Cargo feature of the firmware whose link is USART6.
pub const USART: &str = "hil-usart";

/// Builds the image with this feature ([`image::build`]).
///
/// # Errors
/// As [`image::build`].
pub fn build(feature: &str) -> Result<PathBuf, InputError> {
    let built = image::build(&format!("hil-image/{feature}"), "--image FILE", |cargo| {
        cargo.args(["--no-default-features", "--features", feature]);
    })?;
    check(&built)
}
