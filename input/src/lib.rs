//! What people write for Kestrel, read: files of TOML in layers ([`layers`]), checks of what they say ([`check`]),
//! mountings in quarter turns ([`axes`]), and the one error that bad input ends in ([`InputError`]).
#![forbid(unsafe_code)]
#![warn(missing_docs)]

pub mod axes;
pub mod check;
mod error;
pub mod layers;

pub use error::InputError;
