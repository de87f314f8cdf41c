//! A sensor's errors, from a recording of it at rest.
//!
//! A team leaves its sensor lying still for an hour, and gets back the figures of its model:
//!
//! ```text
//!  log.csv ──recording──► samples ──crate allan──► σ(τ) with bounds ──► N, B, K … or why not
//!     gaps, uneven stamps                             │                        │
//!     and steps are seen                              ▼                        ▼
//!                                                 plot.svg           my-imu.toml, imu.yaml: model
//! ```

pub mod model;
pub mod plot;
pub mod recording;
