//! The firmware's image for QEMU: given, or built here.

use std::fs;
use std::path::{Path, PathBuf};

use input::InputError;

use crate::image;

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

/// Builds the image with this feature ([`image::build`]).
///
/// # Errors
/// No sources, no cargo, or an image that does not build.
pub fn build(feature: &str) -> Result<PathBuf, InputError> {
    let built = image::build(&format!("hil-image/{feature}"), "--image FILE", |cargo| {
        cargo.args(["--no-default-features", "--features", feature]);
    })?;
    check(&built)
}
