//! What other stacks turn into NaN, a flip or a drift: each case by its name, with the bound that it must keep.
//! `docs/hard-cases.md` is their list.

mod attitude;
mod control;
mod filters;
mod models;
mod sensors;
mod truth;
