//! Latency: what comes at t goes on at t + τ, in the same order. τ is rounded to whole steps (1 ms in flight).

use std::collections::VecDeque;
use std::marker::PhantomData;

use serde::Deserialize;

use super::{BoxedDelivery, Delivery};
use crate::effects::{Build, Recipe};
use crate::input_error::InputError;
use crate::scene::check;

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
        check::one(key, "latency_s", self.latency_s, 0.0, 10.0, "s")
    }

    fn build(&self, with: &Build) -> BoxedDelivery<T> {
        let steps = libm::round(self.latency_s * with.rate_hz) as u64;
        Box::new(Queue { steps, step: 0, waiting: VecDeque::new() })
    }
}

struct Queue<T> {
    steps: u64,
    step: u64,
    /// What has come, and the step at which it goes on.
    waiting: VecDeque<(u64, T)>,
}

impl<T: Send> Delivery<T> for Queue<T> {
    fn pass(&mut self, sample: &mut Option<T>) {
        let now = self.step;
        self.step += 1;
        if let Some(sample) = sample.take() {
            self.waiting.push_back((now + self.steps, sample));
        }
        // One comes in a step at most, so one goes out at most.
        *sample = self.waiting.pop_front_if(|(due, _)| *due <= now).map(|(_, sample)| sample);
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
