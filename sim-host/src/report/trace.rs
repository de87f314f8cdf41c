//! Stores several quantities over time in bounded memory.

/// Initial number of steps per bucket: 100 buckets per second at 1 kHz.
const FIRST_STEPS: u32 = 10;
/// Maximum number of buckets. At this number each two are merged into one.
pub(super) const MAX_BUCKETS: usize = 4096;

/// Lowest and highest value in a bucket, with their times, s.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Extremes {
    low: (f64, f64),
    high: (f64, f64),
}

impl Extremes {
    fn join(self, other: Self) -> Self {
        Self {
            low: if other.low.1 < self.low.1 { other.low } else { self.low },
            high: if other.high.1 > self.high.1 { other.high } else { self.high },
        }
    }
}

/// `N` quantities over time. Each bucket of steps keeps the lowest and the highest value of each quantity, with their
/// times. Buckets grow so that there are never more than [`MAX_BUCKETS`].
#[derive(Clone, Debug)]
pub(super) struct Trace<const N: usize> {
    /// The buckets; `None` if no value was finite.
    buckets: Vec<[Option<Extremes>; N]>,
    steps_per_bucket: u32,
    steps_in_last: u32,
}

impl<const N: usize> Default for Trace<N> {
    fn default() -> Self {
        Self { buckets: Vec::new(), steps_per_bucket: FIRST_STEPS, steps_in_last: FIRST_STEPS }
    }
}

impl<const N: usize> Trace<N> {
    /// Adds the values at time `time_s`, s.
    pub fn push(&mut self, time_s: f64, values: [f64; N]) {
        let now = values.map(|value| {
            value.is_finite().then_some(Extremes { low: (time_s, value), high: (time_s, value) })
        });
        if self.steps_in_last == self.steps_per_bucket {
            if self.buckets.len() == MAX_BUCKETS {
                self.halve();
            }
            self.buckets.push(now);
            self.steps_in_last = 1;
            return;
        }
        if let Some(last) = self.buckets.last_mut() {
            *last = joined(*last, now);
        }
        self.steps_in_last += 1;
    }

    /// Merges each two buckets into one. Called when the last bucket is full, so all have equal length.
    fn halve(&mut self) {
        self.buckets = self
            .buckets
            .chunks(2)
            .map(|two| two.iter().copied().reduce(joined).unwrap_or([None; N]))
            .collect();
        self.steps_per_bucket *= 2;
        self.steps_in_last = self.steps_per_bucket;
    }

    /// Returns times, s, and values of quantity `n`, in order of time. A bucket without a finite value gives NaN.
    pub fn points(&self, n: usize) -> Vec<(f64, f64)> {
        let mut out = Vec::with_capacity(2 * self.buckets.len());
        for bucket in &self.buckets {
            match bucket[n] {
                None => out.push((out.last().map_or(0.0, |&(t, _): &(f64, f64)| t), f64::NAN)),
                Some(Extremes { low, high }) if low.0 == high.0 => out.push(low),
                Some(Extremes { low, high }) if low.0 < high.0 => out.extend([low, high]),
                Some(Extremes { low, high }) => out.extend([high, low]),
            }
        }
        out
    }
}

fn joined<const N: usize>(a: [Option<Extremes>; N], b: [Option<Extremes>; N]) -> [Option<Extremes>; N] {
    std::array::from_fn(|n| match (a[n], b[n]) {
        (Some(a), Some(b)) => Some(a.join(b)),
        (one, other) => one.or(other),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a long series with one high and one low sample that an average would hide.
    fn long() -> Vec<(f64, f64)> {
        let mut all: Vec<_> =
            (0..1_000_000_u32).map(|k| (f64::from(k) * 1e-3, f64::from(k * 37 % 1000))).collect();
        all[123_456].1 = 1e6;
        all[654_321].1 = -1e6;
        all
    }

    #[test]
    fn memory_is_bounded_and_extremes_are_kept() {
        let mut trace = Trace::default();
        for (t, value) in long() {
            trace.push(t, [value, 1.0]);
            assert!(trace.buckets.len() <= MAX_BUCKETS);
        }
        let points = trace.points(0);
        assert!(points.len() <= 2 * MAX_BUCKETS && points.len() > MAX_BUCKETS / 2);
        assert!(points.contains(&(123.456, 1e6)) && points.contains(&(654.321, -1e6)));
        assert!(points.is_sorted_by(|a, b| a.0 < b.0));
        assert_eq!(trace.points(1).len(), trace.buckets.len());
        // Every bucket except the last covers the same number of steps.
        let length_s = f64::from(trace.steps_per_bucket) * 1e-3;
        assert!((points.len() as f64 * length_s / 2.0 - 1000.0).abs() < 2.0 * length_s);
    }

    #[test]
    fn short_trace_has_100_buckets_per_second() {
        let mut trace = Trace::default();
        for k in 0..2000_u32 {
            trace.push(f64::from(k) / 1e3, [f64::from(k)]);
        }
        assert_eq!(trace.buckets.len(), 200);
        assert_eq!(trace.points(0)[..3], [(0.0, 0.0), (0.009, 9.0), (0.01, 10.0)]);
    }

    #[test]
    fn non_finite_values_leave_a_gap() {
        let mut trace = Trace::default();
        for k in 0..30 {
            let value = if (8..22).contains(&k) { f64::NAN } else { 1.0 };
            trace.push(f64::from(k), [value]);
        }
        let points = trace.points(0);
        assert_eq!(points.len(), 3);
        assert!(points[0].1 == 1.0 && points[1].1.is_nan() && points[2] == (22.0, 1.0));
    }
}
