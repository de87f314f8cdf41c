//! Reading of what users write: TOML files in layers ([`layers`]), checks of their values ([`check`]), mountings in
//! quarter turns ([`axes`]), and the one error type for bad input ([`InputError`]).
#![forbid(unsafe_code)]
#![warn(missing_docs)]

pub mod axes;
pub mod check;
mod error;
mod expected;
pub mod layers;
mod values;

pub use error::{InputError, is_control};
