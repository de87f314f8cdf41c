//! Hardware in the loop: the firmware flies, and this program is the world.
//!
//! ```text
//!  Flight ──Input──► Link ──► Faults ──frames──► Wire: two named pipes to QEMU, or a serial port
//!         ◄─Answer──      ◄─────────────────────
//! ```
//! The flight is that of [`crate::flight`], with a [`Link`] for its autopilot. In lock-step: the world stands still
//! until the firmware has answered, so a flight does not depend on how fast either side is. On QEMU it is the same,
//! bit for bit, as one in this process.
//!
//! `docs/hil.md` is the page for people.

mod image;
mod link;
#[cfg(all(target_os = "linux", feature = "firmware-log"))]
mod log;
#[cfg(unix)]
mod qemu;
mod serial;

use std::process::ExitStatus;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use crate::flight::{Flight, Observer, Outcome};
use crate::scene::Scene;

pub use hil_link::Received;
pub use image::{PIPES, USART, build, check};
pub use link::{Faults, Link, LinkError, OnTimeout, Report, Reset, Wire};
#[cfg(all(target_os = "linux", feature = "firmware-log"))]
pub use log::WithLog;
#[cfg(unix)]
pub use qemu::Qemu;
pub use serial::{BAUD, Serial};

/// How a flight over a link went.
#[derive(Debug)]
pub struct Flown {
    /// The flight up to where it ended.
    pub outcome: Outcome,
    /// Why the link ended it, if it did.
    pub ended: Result<(), LinkError>,
    /// What came over the link.
    pub report: Report,
}

/// Flies a scene by the firmware at the far end of `wire`, until its end, the crash, the link's failure or `stop`;
/// then tells the firmware that it is over.
pub fn fly(
    wire: &mut impl Wire,
    scene: &Scene,
    seed: u64,
    faults: Faults,
    stop: Arc<AtomicBool>,
    observer: &mut impl Observer,
) -> Flown {
    let mut link = Link::new(wire, scene.config, faults, stop);
    let (outcome, ended) = Flight::flown_by(&mut link, scene, seed).fly(observer);
    link.end();
    Flown { outcome, ended, report: link.into_report() }
}

/// How an emulator ended, and what it leaves.
#[derive(Clone, Debug)]
pub struct Account {
    /// How; `None` if it had to be killed.
    pub status: Option<ExitStatus>,
    /// The last lines of what the firmware and the emulator printed.
    pub last_words: Vec<String>,
    /// Accesses to what the emulator does not model, without those that are explained.
    pub unmodelled: Vec<String>,
}

impl Account {
    /// Whether it ended by itself, and well.
    pub fn is_success(&self) -> bool {
        self.status.is_some_and(|status| status.success())
    }

    /// How it ended, in words.
    pub fn how(&self) -> String {
        match self.status {
            Some(status) => format!("the emulator has ended ({status})"),
            None => "the emulator did not end, and was killed".into(),
        }
    }
}
