//! Random loss: each sample is lost with probability p, independently of the others. The number of samples
//! that are lost in a row is geometrically distributed: n or more are lost with probability p^n.

use std::marker::PhantomData;

use serde::Deserialize;

use super::{BoxedDelivery, Delivery};
use crate::effects::{BuildContext, EffectParams};
use input::InputError;
use input::check;
use random::UniformStream;

/// `[effects.imu.dropped_samples]`, `[effects.mag.dropped_samples]`, `[effects.link.loss]`
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Loss<T> {
    /// Probability p that a sample is lost, 0 to 1.
    pub probability: f64,
    #[serde(skip)]
    of: PhantomData<T>,
}

impl<T: Send + 'static> EffectParams for Loss<T> {
    type Effect = BoxedDelivery<T>;

    fn validate(&self, key: &str) -> Result<(), InputError> {
        check::key_in_range(key, "probability", self.probability, 0.0, 1.0, "")
    }

    fn build(&self, context: &BuildContext) -> BoxedDelivery<T> {
        let stream = UniformStream::new(context.seed, context.name, 0);
        Box::new(RandomLoss { probability: self.probability, stream })
    }
}

struct RandomLoss {
    probability: f64,
    stream: UniformStream,
}

impl<T> Delivery<T> for RandomLoss {
    fn pass(&mut self, sample: &mut Option<T>) {
        // The draw is in (0, 1]: p = 0 loses no sample, p = 1 loses every sample.
        if sample.is_some() && self.stream.draw() <= self.probability {
            *sample = None;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::sensor::testing::build_with;

    fn loss(name: &str, probability: f64, seed: u64) -> BoxedDelivery<u32> {
        build_with(&Loss { probability, of: PhantomData }, name, 1000.0, seed)
    }

    #[test]
    fn loss_has_its_probability_and_geometric_gaps() {
        let (p, n) = (0.1, 1_000_000);
        let mut effect = loss("imu.dropped_samples", p, 1);
        let lost: Vec<bool> = (0..n).map(|k| effect.step(Some(k)).is_none()).collect();
        let share = lost.iter().filter(|lost| **lost).count() as f64 / f64::from(n);
        // The bound is five standard errors of a share, 5 √(p (1 − p)/n) = 0.0015.
        assert!((share - p).abs() < 5.0 * (p * (1.0 - p) / f64::from(n)).sqrt(), "{share}");
        // Two samples in a row are lost with the probability p². Neighbouring pairs overlap, which adds 2 p³ (1 −
        // p) to the variance.
        let pairs = lost.windows(2).filter(|two| two[0] && two[1]).count() as f64 / f64::from(n);
        let variance = p * p * (1.0 - p * p) + 2.0 * p * p * p * (1.0 - p);
        assert!((pairs - p * p).abs() < 5.0 * (variance / f64::from(n)).sqrt(), "{pairs}");
    }

    #[test]
    fn loss_of_none_of_all_and_without_samples() {
        let (mut none, mut all) = (loss("a", 0.0, 1), loss("a", 1.0, 1));
        for k in 0..10_000 {
            assert_eq!((none.step(Some(k)), all.step(Some(k))), (Some(k), None));
        }
        // A step without a sample takes no draw, so it does not change what happens to later samples.
        let (mut dense, mut sparse) = (loss("a", 0.5, 1), loss("a", 0.5, 1));
        for k in 0..100 {
            assert_eq!(sparse.step(None), None);
            assert_eq!(dense.step(Some(k)), sparse.step(Some(k)));
        }
    }

    #[test]
    fn streams_differ_by_name_and_seed() {
        let pattern = |name, seed| {
            let mut effect = loss(name, 0.5, seed);
            (0..64).map(|k| effect.step(Some(k)).is_some()).collect::<Vec<_>>()
        };
        let first = pattern("imu.dropped_samples", 1);
        assert_eq!(first, pattern("imu.dropped_samples", 1));
        assert!(first != pattern("mag.dropped_samples", 1) && first != pattern("imu.dropped_samples", 2));
    }
}
