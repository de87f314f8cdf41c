//! What other stacks turn into NaN, a flip or a drift: each case by its name, with the bound that it must keep.
//! `docs/hard-cases.md` is their list.

// References are computed by std, an independent implementation.
#![allow(clippy::disallowed_methods)]

mod attitude;
mod control;
mod filters;
mod models;
mod sensors;
mod statistics;
mod truth;
