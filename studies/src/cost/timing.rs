//! Times on this machine.

use std::time::{Duration, Instant};

use super::Options;

/// Time of one run, ns: the quickest of at least three, and of as many as a tenth of a second holds (a
/// fiftieth if it is to be quick), so that what else the machine does counts as little as it can. `None` if
/// nothing is to be timed.
pub fn quickest(options: &Options, mut run: impl FnMut()) -> Option<f64> {
    if !options.timed {
        return None;
    }
    let until = Instant::now() + Duration::from_millis(if options.quick { 20 } else { 100 });
    let mut best = f64::INFINITY;
    let mut runs = 0;
    while runs < 3 || Instant::now() < until {
        let start = Instant::now();
        run();
        best = best.min(start.elapsed().as_nanos() as f64);
        runs += 1;
    }
    Some(best)
}
