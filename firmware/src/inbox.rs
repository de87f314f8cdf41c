//! Inputs from the slow tasks for the next step.

use flight_core::sample::{Battery, MagSample, RcFrame};

/// The newest input of each kind; each step takes all of them.
#[derive(Clone, Copy, Default)]
pub struct Inbox {
    /// The newest receiver frame.
    pub rc: Option<RcFrame>,
    /// The newest magnetometer sample.
    pub mag: Option<MagSample>,
    /// The newest battery voltage.
    pub battery: Option<Battery>,
}
