//! The decoders of the receiver protocols with generated frames, published frames, and garbage.

mod broken;
mod garbage;
mod timing;
mod whole;
