//! The firmware's log, from a microcontroller's memory to lines of text.
//!
//! ```text
//!  firmware: defmt ──frames──► ring in RAM (RTT) ──drain──► bytes ──Decoder::push──► lines
//!                                                                       ▲
//!                                          the image (ELF): format strings
//! ```
//! The firmware sends numbers only. Which text they belong to is in its image, in a section that is not flashed: so
//! the image must be the one that runs. [`drain`] takes the bytes out of any memory that can be read and written: an
//! emulator's, or a real one behind a debug probe.
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
//! - What was logged between the last [`drain`] and a reset is lost: the start of the firmware empties the ring.
//! - The decoder believes the length of a list of values (`{=[?]}`), and reserves memory for it. A damaged frame with
//!   such a list could ask for more than there is. Kestrel logs no lists.
#![forbid(unsafe_code)]
#![warn(missing_docs)]

mod decoder;
mod rtt;

pub use decoder::{Decoder, Error, Level, Line};
pub use rtt::{Memory, RttError, drain, rtt_control_block};
