//! Campaigns: many flights of one scene, each with its own seed.
//!
//! ```text
//!  scene ──► run 0, 1, … N−1 ──► seed = first seed + run ──► vehicle and noise of that run ──► flight ──► results
//!               └── shard I of N: consecutive runs, on any machine; `merge` merges the files of all shards
//! ```
//!
//! A run depends only on its seed: not on earlier runs, on the number of runs in parallel or on the machine. So a campaign
//! gives the same bytes in any split, and `fly SCENE --seed S` repeats any run of it.

mod results;
mod summary;

use std::fmt;
use std::num::NonZeroUsize;
use std::ops::Range;
use std::str::FromStr;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use crate::flight::{Flight, Outcome};
use crate::scene::{Drawn, Scene};

pub use results::{merge, merge_with, to_csv, write};
pub use summary::Summary;

/// Largest number of runs of a campaign.
pub const MAX_RUNS: u64 = 1_000_000;

/// Identity of a campaign: in equal campaigns, runs with the same number are the same flight.
#[derive(Clone, Debug, PartialEq)]
pub struct Campaign {
    /// Name of the scene, as on the command line.
    pub scene: String,
    /// Hash of the texts of the scene, the scenes that it includes, its vehicle and its IMU preset.
    pub scene_hash: u64,
    /// Version of the program.
    pub version: String,
    /// Length of each flight, s.
    pub duration_s: f64,
    /// Seed of run 0.
    pub first_seed: u64,
    /// Number of runs of the whole campaign.
    pub runs: u64,
}

impl Campaign {
    /// Creates a campaign of `runs` runs of this scene. The first has the scene's seed, and each further one the next seed.
    pub fn new(scene: &Scene, runs: u64) -> Self {
        Self {
            scene: scene.name.clone(),
            scene_hash: scene.text_hash,
            version: env!("CARGO_PKG_VERSION").into(),
            duration_s: scene.duration_s,
            first_seed: scene.seed,
            runs,
        }
    }

    /// Returns the seed of a run.
    pub fn seed(&self, run: u64) -> u64 {
        self.first_seed.wrapping_add(run)
    }
}

/// One flight of a campaign.
#[derive(Clone, Debug, PartialEq)]
pub struct Run {
    /// Number of the run, counted from 0.
    pub number: u64,
    /// Result of the flight.
    pub outcome: Outcome,
    /// Values that the scene's tolerances have drawn for it.
    pub drawn: Drawn,
}

/// Shard I of N of a campaign's runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shard {
    /// Number of the shard, counted from 1.
    part: u64,
    parts: u64,
}

impl Shard {
    /// The whole campaign as one shard.
    pub const ALL: Self = Self { part: 1, parts: 1 };

    /// Returns the number of shards.
    pub fn parts(&self) -> u64 {
        self.parts
    }

    /// Returns the runs of this shard, out of `runs`. The sizes of shards differ by at most one run.
    pub fn runs(&self, runs: u64) -> Range<u64> {
        let end = |part: u64| (u128::from(runs) * u128::from(part) / u128::from(self.parts)) as u64;
        end(self.part - 1)..end(self.part)
    }
}

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.part, self.parts)
    }
}

impl FromStr for Shard {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        const ALLOWED: &str = "must be I/M, such as 1/8 to 8/8";
        let (part, parts) = text.split_once('/').ok_or(ALLOWED)?;
        let number = |text: &str| text.parse::<u64>().map_err(|_| ALLOWED);
        let (part, parts) = (number(part)?, number(parts)?);
        if part == 0 || part > parts { Err(ALLOWED) } else { Ok(Self { part, parts }) }
    }
}

/// Flies these runs, `jobs` of them in parallel, and returns them in order.
///
/// Calls `flown` after each run. Once `stop` is set, no further run starts, so the list is shorter.
pub fn fly(
    scene: &Scene,
    campaign: &Campaign,
    runs: Range<u64>,
    jobs: NonZeroUsize,
    stop: &AtomicBool,
    flown: &(dyn Fn() + Sync),
) -> Vec<Run> {
    let next = AtomicU64::new(runs.start);
    let worker = || {
        let mut own = Vec::new();
        while !stop.load(Ordering::Relaxed) {
            let number = next.fetch_add(1, Ordering::Relaxed);
            if number >= runs.end {
                break;
            }
            let seed = campaign.seed(number);
            let outcome = Flight::new(scene, seed).run(&mut ());
            own.push(Run { number, outcome, drawn: scene.for_run(seed).1 });
            flown();
        }
        own
    };
    let mut all: Vec<Run> = std::thread::scope(|scope| {
        let parallel = jobs.get().min(usize::try_from(runs.end - runs.start).unwrap_or(usize::MAX));
        let workers: Vec<_> = (0..parallel).map(|_| scope.spawn(worker)).collect();
        workers.into_iter().flat_map(|w| w.join().expect("a flight does not panic")).collect()
    });
    all.sort_by_key(|run| run.number);
    all
}

#[cfg(test)]
mod tests;
