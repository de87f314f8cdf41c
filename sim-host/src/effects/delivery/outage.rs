//! The radio link breaks off for a while: no frame arrives.

use flight_core::sample::RcFrame;
use serde::Deserialize;

use super::{BoxedDelivery, Dead, Window};
use crate::effects::{Build, Recipe};
use input::InputError;
use input::check;

/// `[effects.link.outage]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Outage {
    /// The first moment at which nothing arrives, s.
    pub at_s: f64,
    /// For how long, s; without it for good.
    pub for_s: Option<f64>,
}

impl Recipe for Outage {
    type Effect = BoxedDelivery<RcFrame>;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        check::key_in_range(key, "at_s", self.at_s, 0.0, 1e6, "s")?;
        self.for_s.map_or(Ok(()), |for_s| check::key_in_range(key, "for_s", for_s, 1e-3, 1e6, "s"))
    }

    fn build(&self, with: &Build) -> BoxedDelivery<RcFrame> {
        Box::new(Dead(Window::new(self.at_s, self.for_s, with.rate_hz)))
    }
}
