//! The image: an ELF file that is checked before the emulation.

use std::fs;
use std::path::{Path, PathBuf};

use input::InputError;
use object::{Architecture, Object as _, ObjectSegment as _, ObjectSymbol as _};
use rigless::image::Image;
use sim_host::image::{self, image_sha256};

/// Address of the stored configuration: sector 1 (memory.x).
pub const CONFIGURATION: u64 = 0x0800_4000;

/// Maximum size of a file that is read, bytes. An image with debug information has a few MiB.
const MAX_FILE_BYTES: u64 = 256 << 20;

const SRAM: std::ops::Range<u64> = 0x2000_0000..0x2002_0000;
const CCM: std::ops::Range<u64> = 0x1000_0000..0x1001_0000;
const FLASH: std::ops::Range<u64> = 0x0800_0000..0x0810_0000;
const CONFIGURATION_SECTORS: std::ops::Range<u64> = CONFIGURATION..0x0800_c000;

/// A firmware's image.
#[derive(Debug)]
pub struct Firmware {
    path: PathBuf,
    elf: Vec<u8>,
    symbols: Vec<(String, u64)>,
    vectors: Vec<u32>,
    sha256: String,
}

impl Firmware {
    /// Builds the image from the sources of this workspace, as `cargo flash-fw` does with these variables (docs/hardware.md):
    /// `KESTREL_BOARD`, `KESTREL_VEHICLE`, `KESTREL_ESC`. Variables that are not given are removed from the environment of
    /// the build.
    ///
    /// # Errors
    /// The sources are missing, or the build fails.
    pub fn build(variables: &[(&str, &str)]) -> Result<Self, InputError> {
        let kind = match variables {
            [] => "board".into(),
            _ => variables.iter().map(|(_, value)| value.replace('/', "-")).collect::<Vec<_>>().join(","),
        };
        let built = image::build(&format!("flash-image/{kind}"), "--image ELF", |cargo| {
            cargo.env_remove("KESTREL_BOARD").env_remove("KESTREL_ESC").env_remove("KESTREL_VEHICLE");
            cargo.envs(variables.iter().copied());
        })?;
        Self::read(&built)
    }

    /// Reads an image from a file.
    ///
    /// # Errors
    /// The file cannot be read, or is not a flight image for the STM32F405.
    pub fn read(path: &Path) -> Result<Self, InputError> {
        let unreadable = |error: std::io::Error| refused(path, format!("cannot be read: {error}"));
        let found = fs::metadata(path).map_err(unreadable)?;
        if !found.is_file() || found.len() > MAX_FILE_BYTES {
            return Err(refused(path, format!("must be a file of at most {} MiB", MAX_FILE_BYTES >> 20)));
        }
        Self::parse(path, fs::read(path).map_err(unreadable)?)
    }

    /// Parses an image from its bytes. Errors name `path`.
    ///
    /// # Errors
    /// The bytes are not a flight image for the STM32F405.
    pub fn parse(path: &Path, elf: Vec<u8>) -> Result<Self, InputError> {
        let refused = |reason: String| refused(path, reason);
        match &elf[..] {
            [] => return Err(refused("is empty: must be an ELF image".into())),
            [0x7f, b'E', b'L', b'F', ..] => {}
            _ => return Err(refused("must be an ELF image: the ELF signature is missing".into())),
        }
        let file = object::File::parse(&*elf).map_err(|error| {
            refused(format!("must be an ELF image: it is truncated or damaged ({error})"))
        })?;
        if file.architecture() != Architecture::Arm {
            return Err(refused(format!("must be an image for Arm, and is for {:?}", file.architecture())));
        }
        let mut vector_table = None;
        for segment in file.segments() {
            let data = segment.data().map_err(|error| refused(format!("is truncated: {error}")))?;
            if data.is_empty() {
                continue;
            }
            let from = physical(&file, &segment);
            let to = from + data.len() as u64;
            if !FLASH.contains(&from) || to > FLASH.end {
                return Err(refused(format!(
                    "has {} bytes at {from:#010x}: must be in the STM32F405RG's flash, {:#010x} to {:#010x}",
                    data.len(),
                    FLASH.start,
                    FLASH.end - 1
                )));
            }
            if from < CONFIGURATION_SECTORS.end && to > CONFIGURATION_SECTORS.start {
                return Err(refused(format!(
                    "must not overwrite the configuration sectors at {CONFIGURATION:#010x}"
                )));
            }
            if from == FLASH.start {
                vector_table = Some(data.to_vec());
            }
        }
        let table = vector_table.ok_or_else(|| refused("must have a vector table at 0x08000000".into()))?;
        let vectors = table.as_chunks().0.iter().map(|word| u32::from_le_bytes(*word)).collect();
        let symbols = file
            .symbols()
            .filter_map(|symbol| Some((symbol.name().ok()?.to_owned(), symbol.address())))
            .filter(|(name, _)| !name.is_empty() && !name.starts_with('$'))
            .collect();
        let sha256 = image_sha256(&elf)?;
        let firmware = Self { path: path.to_owned(), elf, symbols, vectors, sha256 };
        firmware.check_kind()?;
        Ok(firmware)
    }

    /// Checks that this is a flight image: the name in its flash is a board's name, without ", bench".
    fn check_kind(&self) -> Result<(), InputError> {
        let Some(kind) = self.text_at("KESTREL_IMAGE") else {
            return Err(refused(
                &self.path,
                "must be an image of Kestrel's firmware, with its symbols".into(),
            ));
        };
        if kind.ends_with(", bench") || kind.contains(' ') {
            return Err(refused(
                &self.path,
                format!("must be the flight image of a board, and is the image of {kind}"),
            ));
        }
        for symbol in ["FLIGHT_RECORD", "_SEGGER_RTT"] {
            match self.symbol(symbol) {
                None => return Err(refused(&self.path, format!("must have the symbol {symbol}"))),
                Some(address) if !SRAM.contains(&address) => {
                    return Err(refused(
                        &self.path,
                        format!("has {symbol} at {address:#010x}: must be in SRAM"),
                    ));
                }
                Some(_) => {}
            }
        }
        // The initial stack pointer may be the address after the end of a memory. A handler is Thumb code in flash.
        let [stack, reset] = [0, 1].map(|n| self.vectors.get(n).copied().map_or(0, u64::from));
        if ![SRAM, CCM].iter().any(|memory| memory.contains(&(stack.wrapping_sub(4)))) {
            return Err(refused(
                &self.path,
                format!("has its initial stack pointer at {stack:#010x}: must be in RAM"),
            ));
        }
        if !FLASH.contains(&reset) || reset & 1 == 0 {
            return Err(refused(
                &self.path,
                format!("has its reset handler at {reset:#010x}: must be Thumb code in flash"),
            ));
        }
        Ok(())
    }

    /// Returns the name of the image's board.
    pub fn board(&self) -> String {
        self.text_at("KESTREL_IMAGE").unwrap_or_default()
    }

    /// Returns the configuration of the vehicle for which the image was built.
    ///
    /// # Errors
    /// The configuration is missing or invalid, or has another version.
    pub fn vehicle(&self) -> Result<flight_core::Config, InputError> {
        let bytes = self.bytes_at("KESTREL_VEHICLE");
        let bytes =
            bytes.ok_or_else(|| refused(&self.path, "must have the symbol KESTREL_VEHICLE".into()))?;
        stored_config::decode(&bytes)
            .map_err(|error| refused(&self.path, format!("has an invalid vehicle configuration: {error}")))
    }

    /// Returns the zero-terminated text at a symbol in flash, at most 64 bytes.
    fn text_at(&self, symbol: &str) -> Option<String> {
        let data = self.bytes_at(symbol)?;
        let text = data.split(|&byte| byte == 0).next()?;
        String::from_utf8(text.get(..text.len().min(64))?.to_vec()).ok()
    }

    /// Returns the bytes from a symbol in flash to the end of its segment.
    fn bytes_at(&self, symbol: &str) -> Option<Vec<u8>> {
        let address = self.symbol(symbol)?;
        let file = object::File::parse(&*self.elf).ok()?;
        let segment = file.segments().find(|segment| {
            segment.data().is_ok_and(|data| {
                (segment.address()..segment.address() + data.len() as u64).contains(&address)
            })
        })?;
        Some(segment.data().ok()?.get((address - segment.address()) as usize..)?.to_vec())
    }

    /// Returns the file's path, for messages.
    pub fn name(&self) -> String {
        self.path.display().to_string()
    }

    /// Returns the bytes of the ELF file.
    pub fn elf(&self) -> &[u8] {
        &self.elf
    }

    /// Returns the SHA-256 of the programmed bytes: see [`sim_host::image`].
    pub fn sha256(&self) -> &str {
        &self.sha256
    }

    /// Converts to an image of `rigless`.
    ///
    /// # Errors
    /// `rigless` rejects the file.
    pub fn image(&self) -> Result<Image, InputError> {
        Image::new(&self.path, self.elf.clone(), None).map_err(|error| refused(&self.path, error.to_string()))
    }

    /// Returns the address of a symbol. The address of a function is without the Thumb bit.
    pub fn symbol(&self, name: &str) -> Option<u64> {
        self.symbols.iter().find(|(found, _)| found == name).map(|(_, address)| address & !1)
    }

    /// Returns the demangled names and the addresses of all symbols.
    pub fn demangled(&self) -> Vec<(String, u64)> {
        let symbols = self.symbols.iter();
        symbols.map(|(name, at)| (format!("{:#}", rustc_demangle::demangle(name)), at & !1)).collect()
    }

    /// Returns the address of the record of the last step.
    pub fn record_address(&self) -> u64 {
        self.symbol("FLIGHT_RECORD").expect("checked when it was read")
    }

    /// Returns the address of the handler of exception `number`; interrupts begin at 16.
    pub fn handler(&self, number: u16) -> Option<u64> {
        self.vectors.get(usize::from(number)).map(|&address| u64::from(address & !1))
    }

    /// Returns the addresses of the return instructions in the handler of exception `number`: `bx lr`, and `pop` with the
    /// program counter in its list.
    pub fn return_addresses(&self, number: u16) -> Vec<u64> {
        let (Some(entry), Ok(file)) = (self.handler(number), object::File::parse(&*self.elf)) else {
            return Vec::new();
        };
        let size =
            file.symbols().filter(|symbol| symbol.address() & !1 == entry).map(|symbol| symbol.size()).max();
        let found = file.segments().find_map(|segment| {
            let from = entry.checked_sub(segment.address())? as usize;
            segment.data().ok()?.get(from..from + size? as usize)
        });
        let halves: Vec<u16> =
            found.unwrap_or_default().as_chunks().0.iter().map(|half| u16::from_le_bytes(*half)).collect();
        let is_return = |at: usize| {
            let next = halves.get(at + 1).copied().unwrap_or(0);
            halves[at] == 0x4770
                || halves[at] & 0xff00 == 0xbd00
                || (halves[at] == 0xe8bd && next & 0x8000 != 0)
        };
        (0..halves.len()).filter(|&at| is_return(at)).map(|at| entry + 2 * at as u64).collect()
    }

    /// Returns the addresses at which the core can go to sleep: all positions with the bytes of `wfi`.
    pub fn sleep_addresses(&self) -> Vec<u64> {
        let Ok(file) = object::File::parse(&*self.elf) else { return Vec::new() };
        let mut found = Vec::new();
        for segment in file.segments() {
            let Ok(data) = segment.data() else { continue };
            let halves = data.as_chunks::<2>().0.iter().zip((segment.address()..).step_by(2));
            found.extend(halves.filter(|(half, _)| **half == [0x30, 0xbf]).map(|(_, address)| address));
        }
        found
    }
}

/// Returns the physical address of a segment, at which it is programmed. It differs from the virtual address for the initial
/// values of variables.
fn physical<'a>(file: &object::File<'a>, segment: &object::Segment<'a, '_>) -> u64 {
    use object::read::elf::ProgramHeader as _;
    if let object::File::Elf32(elf) = file {
        let endian = elf.endian();
        let headers = elf.elf_program_headers().iter();
        let mut found = headers.filter(|header| {
            u64::from(header.p_vaddr(endian)) == segment.address()
                && u64::from(header.p_filesz(endian)) == segment.file_range().1
        });
        if let Some(header) = found.next() {
            return u64::from(header.p_paddr(endian));
        }
    }
    segment.address()
}

/// Returns an error about an image. The path is the error's file and not its value, because long values are cut.
fn refused(path: &Path, reason: String) -> InputError {
    InputError::new(reason).file(path)
}
