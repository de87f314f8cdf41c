//! Latency: what comes at t goes on at t + τ, in the same order.
//!
//! τ is rounded to whole steps of the stream: in flight 1 ms for the inertial samples and the link, and for
//! the magnetometer, whose stream has a step for each of its samples, 10 ms.

use std::marker::PhantomData;

use serde::Deserialize;

use super::{BoxedDelivery, Delivery};
use crate::effects::{Build, Recipe};
use input::InputError;
use input::check;

/// `[effects.imu.latency]`, `[effects.mag.latency]`, `[effects.link.latency]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Latency<T> {
    /// τ, s.
    pub latency_s: f64,
    #[serde(skip)]
    of: PhantomData<T>,
}

impl<T: Send + 'static> Recipe for Latency<T> {
    type Effect = BoxedDelivery<T>;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        check::key_in_range(key, "latency_s", self.latency_s, 0.0, 10.0, "s")
    }

    fn build(&self, with: &Build) -> BoxedDelivery<T> {
        let steps = libm::round(self.latency_s * with.rate_hz) as usize;
        Box::new(Ring { under_way: (0..steps).map(|_| None).collect(), next: 0 })
    }
}

struct Ring<T> {
    /// What came in the last steps, as many as the latency is long.
    under_way: Box<[Option<T>]>,
    /// Where the oldest is, and the newest goes.
    next: usize,
}

impl<T: Send> Delivery<T> for Ring<T> {
    fn pass(&mut self, sample: &mut Option<T>) {
        // Without a place there is no latency.
        if let Some(oldest) = self.under_way.get_mut(self.next) {
            std::mem::swap(sample, oldest);
            self.next = if self.next + 1 == self.under_way.len() { 0 } else { self.next + 1 };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::sensor::testing::build_with;

    fn latency(latency_s: f64) -> BoxedDelivery<u32> {
        build_with(&Latency { latency_s, of: PhantomData }, "imu.latency", 1000.0, 1)
    }

    #[test]
    fn everything_comes_exactly_so_much_later() {
        for (latency_s, steps) in [(0.0, 0), (0.003, 3), (0.025, 25)] {
            let mut effect = latency(latency_s);
            for k in 0..200_u32 {
                // Every fourth step brings something, as a slower sensor does.
                let sent = (k % 4 == 0).then_some(k);
                let wanted = k.checked_sub(steps).filter(|sent| sent % 4 == 0);
                assert_eq!(effect.step(sent), wanted, "step {k} at {latency_s} s");
            }
        }
    }
}
