//! A time window, counted in steps.

/// A range of a stream's steps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Window {
    step: u64,
    from: u64,
    to: u64,
}

impl Window {
    /// Creates a window that starts at `at_s` and lasts `for_s` (s; `None` if it lasts to the end), on a stream of
    /// `rate_hz` steps per second. The step at `at_s` is inside, the step at `at_s + for_s` is outside.
    pub fn new(at_s: f64, for_s: Option<f64>, rate_hz: f64) -> Self {
        let step = |time_s: f64| libm::round(time_s * rate_hz) as u64;
        Self { step: 0, from: step(at_s), to: for_s.map_or(u64::MAX, |for_s| step(at_s + for_s)) }
    }

    /// Returns true if the next step is inside. The first call is for time 0.
    pub fn next_is_inside(&mut self) -> bool {
        let step = self.step;
        self.step += 1;
        (self.from..self.to).contains(&step)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn window_lasts_from_its_start_to_its_end() {
        let inside = |mut window: Window| -> Vec<usize> {
            (0..20).filter(|_| window.next_is_inside()).collect::<Vec<_>>()
        };
        // The times are 0.003 s and 0.007 s at 1 kHz. Neither has an exact binary form.
        assert_eq!(inside(Window::new(0.003, Some(0.004), 1000.0)), [3, 4, 5, 6]);
        assert_eq!(inside(Window::new(0.017, None, 1000.0)), [17, 18, 19]);
        assert_eq!(inside(Window::new(0.03, Some(0.1), 100.0)).len(), 10);
    }
}
