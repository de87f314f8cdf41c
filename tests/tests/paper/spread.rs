//! Mean and standard deviation of a long record, with a check within their standard errors.

/// Sums over a record whose mean is not much larger than its deviation.
#[derive(Clone, Copy, Debug, Default)]
pub struct Spread {
    count: f64,
    sum: f64,
    squares: f64,
}

impl Spread {
    pub fn add(&mut self, x: f64) {
        self.count += 1.0;
        self.sum += x;
        self.squares += x * x;
    }

    pub fn count(&self) -> f64 {
        self.count
    }

    pub fn mean(&self) -> f64 {
        self.sum / self.count
    }

    pub fn deviation(&self) -> f64 {
        let mean = self.mean();
        libm::sqrt(self.squares / self.count - mean * mean)
    }

    /// Asserts that the deviation is `expected` within five standard errors.
    ///
    /// A deviation from n independent normal numbers has the relative standard error 1/√(2n). A record with
    /// the autocorrelation ρ counts as n/Σρ² of them; `per_independent` is that sum, 1 for white noise.
    #[track_caller]
    pub fn assert_deviation(&self, expected: f64, per_independent: f64) {
        let error = 1.0 / libm::sqrt(2.0 * self.count / per_independent);
        let ratio = self.deviation() / expected;
        println!(
            "deviation {:.6e}, expected {expected:.6e}, ratio {ratio:.5} ± {error:.5}",
            self.deviation()
        );
        assert!((ratio - 1.0).abs() < 5.0 * error, "{ratio} ± {error}");
    }
}
