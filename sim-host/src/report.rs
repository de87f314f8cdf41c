//! The report of a flight: one HTML file with everything in it.
//!
//! It loads nothing, runs nothing, and does not say when it was made: the same scene and seed give the same
//! bytes. A [`Recorder`] watches the flight; [`write()`] puts what it saw, the outcome and the scene on a page
//! that can be read on a screen and printed.
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

/// Writes the page of a flight of `scene` with `seed`: complete, or not at all.
///
/// # Errors
/// A place that cannot be written.
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
