//! Outage of the radio link: for some time, no frame arrives.

use flight_core::sample::RcFrame;
use serde::Deserialize;

use super::{BoxedDelivery, Dead, Window};
use crate::effects::{BuildContext, EffectParams};
use input::InputError;
use input::check;

/// `[effects.link.outage]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Outage {
    /// Start of the outage, s.
    pub at_s: f64,
    /// Duration, s; without it the outage never ends.
    pub for_s: Option<f64>,
}

impl EffectParams for Outage {
    type Effect = BoxedDelivery<RcFrame>;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        check::key_in_range(key, "at_s", self.at_s, 0.0, 1e6, "s")?;
        self.for_s.map_or(Ok(()), |for_s| check::key_in_range(key, "for_s", for_s, 1e-3, 1e6, "s"))
    }

    fn at_s(&self) -> Option<f64> {
        Some(self.at_s)
    }

    fn build(&self, context: &BuildContext) -> BoxedDelivery<RcFrame> {
        Box::new(Dead(Window::new(self.at_s, self.for_s, context.rate_hz)))
    }
}
