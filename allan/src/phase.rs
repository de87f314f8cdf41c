//! The running sums of a signal. All statistics are differences of these sums.
//!
//! # Precision
//! A sensor at rest reads a large constant (1 g, or an offset in counts) with small noise, and the sum of a long record
//! exceeds the resolution of a double: 10⁸ samples with a mean of 10⁶ σ have the sum 10¹⁴ σ, at which a double has steps
//! of 0.02 σ. Therefore the mean is subtracted first, so that the sums stay within about √n σ. The sums are computed in
//! blocks, whose starts are added with compensation (Neumaier 1974): the error of each sum is little more than half a unit
//! in its last place. The mean does not change a statistic: a constant rate is a straight line in the sums, and the second
//! difference of a straight line is zero.

/// Samples in a block of plain summation.
const BLOCK: usize = 4096;

/// The sums x\[k\] of the first k samples without their mean. There is one more sum than samples.
#[derive(Clone, Debug)]
pub struct Phase {
    x: Vec<f64>,
    interval_s: f64,
}

impl Phase {
    /// Computes the sums of samples of a rate, in place.
    pub fn of_rate(mut samples: Vec<f64>, interval_s: f64) -> Self {
        let mean = mean(&samples);
        let mut start = Compensated::default();
        for block in samples.chunks_mut(BLOCK) {
            let from = start.total();
            let mut sum = 0.0;
            for sample in block.iter_mut() {
                let deviation = *sample - mean;
                *sample = from + sum;
                sum += deviation;
            }
            start.add(sum);
        }
        samples.push(start.total());
        Self { x: samples, interval_s }
    }

    /// Computes the sums from samples of an angle (or velocity, or phase), which is already a sum.
    pub fn of_angle(mut samples: Vec<f64>, interval_s: f64) -> Self {
        let (first, last) = match samples.as_slice() {
            [first, .., last] => (*first, *last),
            _ => (0.0, 0.0),
        };
        let slope = (last - first) / (samples.len().max(2) - 1) as f64;
        for (k, x) in samples.iter_mut().enumerate() {
            // A sum of samples has the unit of the rate; an angle is the sum times the interval.
            *x = ((*x - first) - slope * k as f64) / interval_s;
        }
        Self { x: samples, interval_s }
    }

    /// Returns the sums.
    pub fn sums(&self) -> &[f64] {
        &self.x
    }

    /// Returns the number of samples of the rate.
    pub fn samples(&self) -> usize {
        self.x.len().saturating_sub(1)
    }

    /// Returns the time between samples, s.
    pub fn interval_s(&self) -> f64 {
        self.interval_s
    }

    /// Returns the length of the record, s.
    pub fn length_s(&self) -> f64 {
        self.samples() as f64 * self.interval_s
    }

    /// Returns whether the rate rises over the record: whether its second half is at least its first half.
    pub fn rises(&self) -> bool {
        let half = self.samples() / 2;
        self.x[2 * half] - self.x[half] >= self.x[half] - self.x[0]
    }
}

/// Returns the mean of the samples, with the precision of a double.
fn mean(samples: &[f64]) -> f64 {
    let Some(&origin) = samples.first() else { return 0.0 };
    let mut total = Compensated::default();
    for block in samples.chunks(BLOCK) {
        let (wide, rest) = block.as_chunks::<8>();
        let mut lanes = [0.0; 8];
        for samples in wide {
            for (lane, sample) in lanes.iter_mut().zip(samples) {
                *lane += sample - origin;
            }
        }
        total.add(lanes.iter().sum::<f64>() + rest.iter().map(|sample| sample - origin).sum::<f64>());
    }
    origin + total.total() / samples.len() as f64
}

/// A sum with the compensation of its rounding errors.
#[derive(Clone, Copy, Debug, Default)]
struct Compensated {
    sum: f64,
    lost: f64,
}

impl Compensated {
    fn add(&mut self, x: f64) {
        let sum = self.sum + x;
        self.lost += if self.sum.abs() >= x.abs() { (self.sum - sum) + x } else { (x - sum) + self.sum };
        self.sum = sum;
    }

    fn total(self) -> f64 {
        self.sum + self.lost
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sums_are_of_deviations_from_the_mean() {
        let phase = Phase::of_rate(vec![1.0, 2.0, 6.0], 0.5);
        assert_eq!(phase.sums(), [0.0, -2.0, -3.0, 0.0]);
        assert_eq!((phase.samples(), phase.length_s(), phase.rises()), (3, 1.5, true));
    }

    #[test]
    fn angle_gives_the_same_sums_as_its_rate() {
        let rate = [3.0, -1.0, 4.0, 1.0, -5.0];
        let mut angle = vec![7.0];
        for y in rate {
            angle.push(angle[angle.len() - 1] + y * 0.25);
        }
        let (a, b) = (Phase::of_rate(rate.to_vec(), 0.25), Phase::of_angle(angle, 0.25));
        for (a, b) in a.sums().iter().zip(b.sums()) {
            assert!((a - b).abs() < 1e-12, "{a} {b}");
        }
    }

    #[test]
    fn compensated_sum_keeps_rounding_errors() {
        let mut sum = Compensated::default();
        [1e16, 1.0, 1.0, -1e16].into_iter().for_each(|x| sum.add(x));
        assert_eq!(sum.total(), 2.0);
    }
}
