//! Progress bars, on standard error and only on a terminal.

use indicatif::ProgressBar;
pub use sim_host::command::progress_bar as bar;
use sim_host::flight::{Observer, StepView};

/// A progress bar over the simulated seconds of a flight.
pub struct FlightProgress {
    bar: ProgressBar,
    steps_to_update: u32,
}

/// Steps between two updates of the bar: 10 simulated seconds of 1000 steps.
const STEPS_PER_UPDATE: u32 = 10_000;

impl FlightProgress {
    /// Starts a bar for a flight of this length.
    pub fn new(duration_s: f64, label: &str) -> Self {
        Self { bar: bar(duration_s as u64, label), steps_to_update: STEPS_PER_UPDATE }
    }

    /// Removes the bar.
    pub fn finish(self) {
        self.bar.finish_and_clear();
    }
}

impl Observer for FlightProgress {
    #[inline(always)]
    fn step(&mut self, view: &StepView) {
        self.steps_to_update -= 1;
        if self.steps_to_update == 0 {
            self.steps_to_update = STEPS_PER_UPDATE;
            self.bar.set_position(view.time_us / 1_000_000);
        }
    }
}
