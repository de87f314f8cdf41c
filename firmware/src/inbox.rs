//! What the slow tasks have for the next step.

use flight_core::sample::{Battery, MagSample, RcFrame};

/// The newest of each; a step takes all that there is.
#[derive(Clone, Copy, Default)]
pub struct Inbox {
    /// From the receiver.
    pub rc: Option<RcFrame>,
    /// From the magnetometer.
    pub mag: Option<MagSample>,
    /// The supply.
    pub battery: Option<Battery>,
}
