//! Campaigns: a scene flown many times, each time with another seed.
//!
//! ```text
//!  scene ──► run 0, 1, … N−1 ──► seed = first seed + run ──► vehicle and noise of that run ──► flight ──► results
//!               └── shard I of N: a stretch of the runs, on whatever machine; `merge` puts the files together
//! ```
//!
//! A run depends on its seed alone: not on the runs before it, not on how many are flown at a time, not on where.
//! So a campaign gives the same bytes however it is split, and `fly SCENE --seed S` flies any run of it again.

mod results;
mod summary;

use std::num::NonZeroUsize;
use std::ops::Range;
use std::str::FromStr;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use crate::flight::{Flight, Outcome};
use crate::scene::{Drawn, Scene};

pub use results::{merge, merge_with, to_csv, write};
pub use summary::Summary;

/// What makes two runs of the same number the same flight.
#[derive(Clone, Debug, PartialEq)]
pub struct Campaign {
    /// Name of the scene, as on the command line.
    pub scene: String,
    /// Hash of the scene's text, of what it includes and of its sensors' preset.
    pub scene_hash: u64,
    /// Version of the program.
    pub version: String,
    /// Length of a flight, s.
    pub duration_s: f64,
    /// Seed of run 0.
    pub first_seed: u64,
    /// Runs of the whole campaign.
    pub runs: u64,
}

impl Campaign {
    /// So many runs of this scene, with seeds counting up from its own.
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

    /// Seed of a run.
    pub fn seed(&self, run: u64) -> u64 {
        self.first_seed.wrapping_add(run)
    }
}

/// One flight of a campaign.
#[derive(Clone, Debug, PartialEq)]
pub struct Run {
    /// Counted from 0.
    pub number: u64,
    /// How it went.
    pub outcome: Outcome,
    /// What the scene's tolerances have drawn for it.
    pub drawn: Drawn,
}

/// Part I of N of a campaign's runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shard {
    /// Counted from 1.
    part: u64,
    parts: u64,
}

impl Shard {
    /// The one part that is the whole.
    pub const WHOLE: Self = Self { part: 1, parts: 1 };

    /// Number of parts.
    pub fn parts(&self) -> u64 {
        self.parts
    }

    /// The runs of this part, of so many. Parts differ by one run at most.
    pub fn runs(&self, runs: u64) -> Range<u64> {
        let end = |part: u64| (u128::from(runs) * u128::from(part) / u128::from(self.parts)) as u64;
        end(self.part - 1)..end(self.part)
    }
}

impl FromStr for Shard {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        const SAID: &str = "must be I/N, such as 1/8 to 8/8";
        let (part, parts) = text.split_once('/').ok_or(SAID)?;
        let number = |text: &str| text.parse::<u64>().map_err(|_| SAID);
        let (part, parts) = (number(part)?, number(parts)?);
        if part == 0 || part > parts { Err(SAID) } else { Ok(Self { part, parts }) }
    }
}

/// Flies these runs, so many at a time, and returns them in order. `flown` is told of each; once `stop` is set
/// no further one is begun, and there are fewer.
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
        let mut mine = Vec::new();
        while !stop.load(Ordering::Relaxed) {
            let number = next.fetch_add(1, Ordering::Relaxed);
            if number >= runs.end {
                break;
            }
            let seed = campaign.seed(number);
            let outcome = Flight::new(scene, seed).run(&mut ());
            mine.push(Run { number, outcome, drawn: scene.of_run(seed).1 });
            flown();
        }
        mine
    };
    let mut all: Vec<Run> = std::thread::scope(|scope| {
        let at_a_time = jobs.get().min(usize::try_from(runs.end - runs.start).unwrap_or(usize::MAX));
        let workers: Vec<_> = (0..at_a_time).map(|_| scope.spawn(worker)).collect();
        workers.into_iter().flat_map(|w| w.join().expect("a flight does not panic")).collect()
    });
    all.sort_by_key(|run| run.number);
    all
}

#[cfg(test)]
mod tests;
