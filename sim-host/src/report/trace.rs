//! A record of several numbers over time in bounded memory.

/// Steps that go into a bucket at first: 100 buckets a second at 1 kHz.
const FIRST_STEPS: u32 = 10;
/// When there are this many buckets, each two become one.
pub(super) const MAX_BUCKETS: usize = 4096;

/// What a number did during a bucket.
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

/// `N` numbers over time. Of every bucket of steps the lowest and the highest value of each number are kept,
/// with their times; buckets grow so that there are never more than [`MAX_BUCKETS`].
#[derive(Clone, Debug)]
pub(super) struct Trace<const N: usize> {
    /// `None` where no value was finite.
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
    /// Takes the values at time `time_s`, s.
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

    /// Makes one bucket of each two. Called when the last one is full, so all stay equally long.
    fn halve(&mut self) {
        self.buckets = self
            .buckets
            .chunks(2)
            .map(|two| two.iter().copied().reduce(joined).unwrap_or([None; N]))
            .collect();
        self.steps_per_bucket *= 2;
        self.steps_in_last = self.steps_per_bucket;
    }

    /// Times, s, and values of number `n`, in the order of time; where nothing was finite, NaN.
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

    /// Wanders, with one high and one low sample that no average would show.
    fn long() -> Vec<(f64, f64)> {
        let mut all: Vec<_> =
            (0..1_000_000_u32).map(|k| (f64::from(k) * 1e-3, f64::from(k * 37 % 1000))).collect();
        all[123_456].1 = 1e6;
        all[654_321].1 = -1e6;
        all
    }

    #[test]
    fn memory_is_bounded_and_extremes_stay() {
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
        // Every bucket but the last stands for equally many steps.
        let length_s = f64::from(trace.steps_per_bucket) * 1e-3;
        assert!((points.len() as f64 * length_s / 2.0 - 1000.0).abs() < 2.0 * length_s);
    }

    #[test]
    fn a_short_record_is_taken_a_hundred_times_a_second() {
        let mut trace = Trace::default();
        for k in 0..2000_u32 {
            trace.push(f64::from(k) / 1e3, [f64::from(k)]);
        }
        assert_eq!(trace.buckets.len(), 200);
        assert_eq!(trace.points(0)[..3], [(0.0, 0.0), (0.009, 9.0), (0.01, 10.0)]);
    }

    #[test]
    fn what_is_not_finite_leaves_a_gap_and_spoils_nothing() {
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
