//! The decoders against frames made here, published frames, and garbage.

mod broken;
mod garbage;
mod timing;
mod whole;
