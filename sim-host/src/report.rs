//! The report of a flight: one self-contained HTML file.
//!
//! The page loads nothing, runs no scripts, and contains no creation time, so the same scene and seed give the same
//! bytes. A [`Recorder`] records the flight. [`write()`] writes the recorded data, the outcome and the scene as a page
//! for screen and print.
//!
//! ```no_run
//! use sim_host::flight::Flight;
//! use sim_host::report::{self, Recorder};
//! use sim_host::scene::Scene;
//!
//! let scene = Scene::load("hover")?;
//! let mut recorder = Recorder::new();
//! let outcome = Flight::new(&scene, scene.seed).run(&mut recorder);
//! report::write("hover.html", &scene, scene.seed, &outcome, &recorder)?;
//! # Ok::<(), input::InputError>(())
//! ```

pub mod figures;
mod page;
mod recorder;
pub mod step_response;
mod trace;

use std::path::Path;

pub use page::{document, figure, page, printable};
pub use recorder::{Channel, Recorder};

use crate::flight::Outcome;
use crate::output_file;
use crate::scene::Scene;
use input::InputError;

/// Writes the page of a flight of `scene` with `seed`. The file is complete or does not exist.
///
/// # Errors
/// The file cannot be written.
pub fn write(
    path: impl AsRef<Path>,
    scene: &Scene,
    seed: u64,
    outcome: &Outcome,
    recorder: &Recorder,
) -> Result<(), InputError> {
    output_file::write(path, &page(scene, seed, outcome, recorder))
}

#[cfg(test)]
mod tests;
