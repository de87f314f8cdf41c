//! Measures run times on this machine.

use std::time::{Duration, Instant};

use super::Options;

/// Returns the time of one run, ns, or `None` if nothing is to be timed.
///
/// It is the shortest of at least three runs, and of as many as fit into 0.1 s (0.02 s with `quick`), so that other
/// load on the machine counts as little as possible.
pub fn shortest_ns(options: &Options, mut run: impl FnMut()) -> Option<f64> {
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
