//! Latency: what enters at t leaves at t + τ, in the same order.
//!
//! τ is rounded to whole steps of the stream. In flight a step is 1 ms for the IMU samples and the link. The
//! magnetometer's stream has one step for each of its samples, so there a step is 10 ms.

use std::marker::PhantomData;

use serde::Deserialize;

use super::{BoxedDelivery, Delivery};
use crate::effects::{BuildContext, EffectParams};
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

impl<T: Send + 'static> EffectParams for Latency<T> {
    type Effect = BoxedDelivery<T>;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        check::key_in_range(key, "latency_s", self.latency_s, 0.0, 10.0, "s")
    }

    fn build(&self, context: &BuildContext) -> BoxedDelivery<T> {
        let steps = libm::round(self.latency_s * context.rate_hz) as usize;
        Box::new(DelayLine { in_transit: (0..steps).map(|_| None).collect(), next: 0 })
    }
}

struct DelayLine<T> {
    /// The inputs of the last steps: a ring, as long as the latency.
    in_transit: Box<[Option<T>]>,
    /// Index of the oldest input, which the newest replaces.
    next: usize,
}

impl<T: Send> Delivery<T> for DelayLine<T> {
    fn pass(&mut self, sample: &mut Option<T>) {
        // A ring of length 0 means no latency.
        if let Some(oldest) = self.in_transit.get_mut(self.next) {
            std::mem::swap(sample, oldest);
            self.next = if self.next + 1 == self.in_transit.len() { 0 } else { self.next + 1 };
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
    fn samples_are_delayed_by_the_latency() {
        for (latency_s, steps) in [(0.0, 0), (0.003, 3), (0.025, 25)] {
            let mut effect = latency(latency_s);
            for k in 0..200_u32 {
                // There is a sample at every fourth step, as from a slower sensor.
                let sent = (k % 4 == 0).then_some(k);
                let wanted = k.checked_sub(steps).filter(|sent| sent % 4 == 0);
                assert_eq!(effect.step(sent), wanted, "step {k} at {latency_s} s");
            }
        }
    }
}
