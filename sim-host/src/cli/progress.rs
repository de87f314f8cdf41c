//! Progress bars, on standard error and only on a terminal.

use indicatif::ProgressBar;
pub use sim_host::command::progress_bar as bar;
use sim_host::flight::{Observer, StepView};

/// A bar over the seconds of a flight.
pub struct FlightProgress {
    bar: ProgressBar,
    steps_to_next: u32,
}

/// Steps between two looks at the terminal: 10 simulated seconds.
const STEPS_PER_LOOK: u32 = 10_000;

impl FlightProgress {
    /// For a flight of this length.
    pub fn new(duration_s: f64, what: &str) -> Self {
        Self { bar: bar(duration_s as u64, what), steps_to_next: STEPS_PER_LOOK }
    }

    /// Takes the bar away.
    pub fn finish(self) {
        self.bar.finish_and_clear();
    }
}

impl Observer for FlightProgress {
    #[inline(always)]
    fn step(&mut self, view: &StepView) {
        self.steps_to_next -= 1;
        if self.steps_to_next == 0 {
            self.steps_to_next = STEPS_PER_LOOK;
            self.bar.set_position(view.time_us / 1_000_000);
        }
    }
}
