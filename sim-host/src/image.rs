//! The bytes of an ELF image that are flashed, and their SHA-256.
//!
//! An ELF image also contains data that is not written to the chip: symbols, debug information, the text of log messages.
//! The flashed bytes are those of the loadable segments (`PT_LOAD`), each at its physical address. The SHA-256 is computed
//! over these bytes from the lowest address to the highest, with zeros in gaps, so it equals that of the file that
//! `objcopy -O binary` writes. `docs/hardware.md` has the commands that compute it without this program.

use std::env;
use std::ffi::OsStr;
use std::io::{IsTerminal as _, stderr};
use std::path::{Path, PathBuf};
use std::process::Command;

use elf::ElfBytes;
use elf::abi::{EM_ARM, PT_LOAD};
use elf::endian::LittleEndian;
use elf::file::Class;

use input::InputError;

/// Largest distance from the lowest to the highest flashed address, bytes: 16 MiB, more than the flash of any
/// microcontroller.
const MAX_SPAN: u64 = 1 << 24;

/// Returns the address of the first flashed byte, and the flashed bytes.
///
/// # Errors
/// The file is not a 32-bit ELF image for Arm, has no bytes to flash, or has segments that overlap, end beyond the end of
/// the file or lie too far apart.
pub fn flashed_bytes(elf: &[u8]) -> Result<(u32, Vec<u8>), InputError> {
    let refused = |what: String| InputError::new(what).field("image");
    let unreadable = |error: elf::ParseError| refused(format!("must be an ELF image for Arm: {error}"));
    let file = ElfBytes::<LittleEndian>::minimal_parse(elf).map_err(unreadable)?;
    if file.ehdr.class != Class::ELF32 || file.ehdr.e_machine != EM_ARM {
        return Err(refused("must be a 32-bit ELF image for Arm".into()));
    }
    let headers = file.segments().into_iter().flatten();
    let mut segments = Vec::new();
    for header in headers.filter(|header| header.p_type == PT_LOAD && header.p_filesz > 0) {
        segments.push((header.p_paddr, file.segment_data(&header).map_err(unreadable)?));
    }
    segments.sort_unstable_by_key(|&(address, _)| address);

    let Some(&(start, _)) = segments.first() else {
        return Err(refused("has no bytes to flash".into()));
    };
    let mut bytes = Vec::new();
    for (address, data) in segments {
        let at = address - start;
        if at < bytes.len() as u64 {
            return Err(refused(format!("has segments that overlap at {address:#010x}")));
        }
        if at + data.len() as u64 > MAX_SPAN {
            return Err(refused(format!(
                "extends from {start:#010x} to {address:#010x}: no flash is that large"
            )));
        }
        bytes.resize(at as usize, 0);
        bytes.extend_from_slice(data);
    }
    let start = u32::try_from(start).map_err(|_| refused(format!("has no 32-bit address: {start:#x}")))?;
    Ok((start, bytes))
}

/// Returns the SHA-256 of the flashed bytes, as 64 hexadecimal digits.
///
/// # Errors
/// As [`flashed_bytes`].
pub fn image_sha256(elf: &[u8]) -> Result<String, InputError> {
    let (_, bytes) = flashed_bytes(elf)?;
    Ok(hmac_sha256::Hash::hash(&bytes).iter().map(|byte| format!("{byte:02x}")).collect())
}

/// Rust target of the firmware.
const TARGET: &str = "thumbv7em-none-eabihf";

/// Builds an image of the firmware from the sources that this program was built from, and returns its path.
///
/// The build has its own directory `folder` in the target directory, because cargo locks that of an outer build.
/// `set_up` adds the arguments that this image needs. `option` is the option that names an image instead, for errors.
///
/// # Errors
/// The sources or cargo are missing, or the build fails.
pub fn build(folder: &str, option: &str, set_up: impl FnOnce(&mut Command)) -> Result<PathBuf, InputError> {
    let refused =
        |what: String| InputError::new(format!("{what}: give an image by {option}")).file("firmware");
    let workspace = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap_or(Path::new("/"));
    if !workspace.join("firmware/Cargo.toml").exists() {
        return Err(refused(format!("the sources are missing in {}", workspace.display())));
    }
    let targets = env::var_os("CARGO_TARGET_DIR").map_or_else(|| workspace.join("target"), PathBuf::from);
    let target = std::path::absolute(targets.join(folder))
        .map_err(|error| refused(format!("no target directory: {error}")))?;
    let mut cargo = Command::new(env::var_os("CARGO").as_deref().unwrap_or(OsStr::new("cargo")));
    cargo
        .current_dir(workspace)
        // The build is that of the alias flash-fw in .cargo/config.toml, with `build` instead of `run`.
        .args(["build", "--profile", "flash", "--package", "firmware", "--target", TARGET, "--target-dir"])
        .arg(&target)
        // These would replace the link arguments of .cargo/config.toml.
        .env_remove("RUSTFLAGS")
        .env_remove("CARGO_ENCODED_RUSTFLAGS");
    set_up(&mut cargo);
    if !stderr().is_terminal() {
        cargo.arg("--quiet");
    }
    let status = cargo.status().map_err(|error| refused(format!("cargo does not start ({error})")))?;
    if !status.success() {
        return Err(refused("the build failed".into()));
    }
    Ok(target.join(TARGET).join("flash/firmware"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Returns a 32-bit ELF image without sections, with these segments: type, physical address and bytes.
    fn image(segments: &[(u32, u32, &[u8])]) -> Vec<u8> {
        const HEADER: u32 = 52;
        const SEGMENT: u32 = 32;
        let mut file = b"\x7fELF\x01\x01\x01\0\0\0\0\0\0\0\0\0\x02\0\x28\0\x01\0\0\0".to_vec();
        let words = [0x0801_0001, HEADER, 0, 0x0500_0000];
        file.extend(words.iter().flat_map(|word: &u32| word.to_le_bytes()));
        let halves = [HEADER as u16, SEGMENT as u16, segments.len() as u16, 40, 0, 0];
        file.extend(halves.iter().flat_map(|half| half.to_le_bytes()));
        let mut offset = HEADER + SEGMENT * segments.len() as u32;
        for &(kind, address, bytes) in segments {
            let size = bytes.len() as u32;
            let words = [kind, offset, 0x2000_0000, address, size, size + 4, 5, 4];
            file.extend(words.iter().flat_map(|word| word.to_le_bytes()));
            offset += size;
        }
        segments.iter().for_each(|(_, _, bytes)| file.extend(*bytes));
        file
    }

    fn refused(elf: &[u8]) -> String {
        flashed_bytes(elf).unwrap_err().to_string()
    }

    #[test]
    fn segments_are_placed_at_their_physical_addresses() {
        // The second has the lowest address; the third has no bytes; the fourth is not loaded.
        let elf = image(&[
            (PT_LOAD, 0x0800_0006, b"code"),
            (PT_LOAD, 0x0800_0000, b"vec"),
            (PT_LOAD, 0x2000_0000, b""),
            (4, 0x0900_0000, b"note"),
        ]);
        assert_eq!(flashed_bytes(&elf).unwrap(), (0x0800_0000, b"vec\0\0\0code".to_vec()));
    }

    #[test]
    fn sha256_is_that_of_the_flashed_bytes() {
        // FIPS 180-2, appendix B.1.
        let elf = image(&[(PT_LOAD, 0x0800_0000, b"ab"), (PT_LOAD, 0x0800_0002, b"c")]);
        assert_eq!(
            image_sha256(&elf).unwrap(),
            "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
        );
    }

    #[test]
    fn unusable_images_are_refused() {
        assert!(refused(b"no image").contains("must be an ELF image for Arm"));
        let mut other_machine = image(&[(PT_LOAD, 0, b"x")]);
        other_machine[18] = 62;
        assert!(refused(&other_machine).contains("32-bit ELF image for Arm"));
        assert!(refused(&image(&[])).contains("no bytes to flash"));
        let overlap = image(&[(PT_LOAD, 0x0800_0000, b"abc"), (PT_LOAD, 0x0800_0002, b"d")]);
        assert!(refused(&overlap).contains("overlap at 0x08000002"));
        let far = image(&[(PT_LOAD, 0x0800_0000, b"abc"), (PT_LOAD, 0xffff_0000, b"d")]);
        assert!(refused(&far).contains("no flash is that large"));
        let cut = image(&[(PT_LOAD, 0x0800_0000, b"abc")]);
        assert!(refused(&cut[..cut.len() - 1]).contains("must be an ELF image for Arm"));
    }

    proptest! {
        #[test]
        fn any_header_gives_bytes_or_an_error(at in 0_usize..148, byte: u8, length in 0_usize..160) {
            let mut elf = image(&[(PT_LOAD, 0x0800_0000, b"abc"), (PT_LOAD, 0x0800_0100, b"def")]);
            elf[at.min(121)] = byte;
            elf.truncate(length);
            if let Ok((_, bytes)) = flashed_bytes(&elf) {
                prop_assert!(bytes.len() as u64 <= MAX_SPAN);
            }
        }
    }
}
