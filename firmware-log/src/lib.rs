//! Reading of the firmware's log: from the memory of a microcontroller to lines of text.
//!
//! ```text
//!  firmware: defmt ──frames──► ring in RAM (RTT) ──drain──► bytes ──Decoder::push──► lines
//!                                                                       ▲
//!                                          the image (ELF): format strings
//! ```
//! The firmware sends only numbers. Their texts are in its image, in a section that is not flashed, so the decoder needs
//! the same image as the one that runs. [`drain`] reads the bytes from any memory that can be read and written: that of QEMU
//! or of the emulator, or that of a board through a debug probe.
//!
//! ```no_run
//! # fn memory() -> impl firmware_log::Memory { struct M; impl firmware_log::Memory for M {
//! #   fn read(&mut self, _: u32, _: &mut [u8]) -> std::io::Result<()> { Ok(()) }
//! #   fn write_u32(&mut self, _: u32, _: u32) -> std::io::Result<()> { Ok(()) } } M }
//! let elf = std::fs::read("firmware")?;
//! let mut decoder = firmware_log::Decoder::new(&elf)?;
//! let control_block = firmware_log::rtt_control_block(&elf).ok_or("no log by RTT")?;
//! let mut memory = memory();
//! for line in decoder.push(&firmware_log::drain(&mut memory, control_block)?) {
//!     println!("{line}");
//! }
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Limits
//! - Lines between the last [`drain`] and a reset are lost, because the start of the firmware empties the ring.
//! - The decoder does not check the length of a list of values (`{=[?]}`) before it allocates memory for it. A damaged frame
//!   with such a list could exhaust the memory. Kestrel logs no lists.
#![forbid(unsafe_code)]
#![warn(missing_docs)]

mod decoder;
mod rtt;

pub use decoder::{Decoder, Error, Level, Line};
pub use rtt::{Memory, RttError, drain, rtt_control_block};
