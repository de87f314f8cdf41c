//! Cases in which other flight stacks produce NaN, a flip or a drift: each case by its name, with the bound that must
//! hold. `docs/hard-cases.md` lists them.

// References are computed by std, an independent implementation.
#![allow(clippy::disallowed_methods)]

mod attitude;
mod control;
mod filters;
mod models;
mod sensors;
mod statistics;
mod truth;
