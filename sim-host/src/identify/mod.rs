//! Identifies a sensor's errors from a recording at rest.
//!
//! A recording of a sensor at rest, for example for an hour, gives the parameters of its error model:
//!
//! ```text
//!  log.csv ──recording──► samples ──crate allan──► σ(τ) with bounds ──► N, B, K … or a reason
//!     gaps and uneven                                 │                        │
//!     stamps are errors                               ▼                        ▼
//!                                                 plot.svg           my-imu.toml, imu.yaml: model
//! ```

pub mod model;
pub mod plot;
pub mod recording;
