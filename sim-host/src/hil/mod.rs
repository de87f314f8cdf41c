//! Hardware in the loop: the firmware flies, and this program simulates vehicle, sensors and pilot.
//!
//! ```text
//!  Flight ──Input──► Link ──► Faults ──frames──► Wire: two named pipes to QEMU, or a serial port
//!         ◄─Answer──      ◄─────────────────────
//! ```
//! The flight is that of [`crate::flight`], with a [`Link`] as its autopilot. Both sides run in lock-step: the
//! simulation waits until the firmware has answered, so the flight does not depend on the speed of either side. On QEMU
//! it equals, bit for bit, the flight in this process.
//!
//! `docs/hil.md` describes the use.

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

/// Result of a flight over a link.
#[derive(Debug)]
pub struct Flown {
    /// The flight up to its end.
    pub outcome: Outcome,
    /// `Err` if the link ended the flight, with the reason.
    pub ended: Result<(), LinkError>,
    /// Counters of the link.
    pub report: Report,
}

/// Flies a scene with the firmware at the far end of `wire`, until the scene ends, the vehicle crashes, the link fails
/// or `stop` is set. Then tells the firmware that the flight is over.
pub fn fly(
    wire: &mut impl Wire,
    scene: &Scene,
    seed: u64,
    faults: Faults,
    stop: Arc<AtomicBool>,
    observer: &mut impl Observer,
) -> Flown {
    let mut link = Link::new(wire, scene.config, faults, stop);
    let (outcome, ended) = Flight::with_autopilot(&mut link, scene, seed).fly(observer);
    link.end();
    Flown { outcome, ended, report: link.into_report() }
}

/// How QEMU ended, and what it printed.
#[derive(Clone, Debug)]
pub struct QemuExit {
    /// Exit status; `None` if QEMU had to be killed.
    pub status: Option<ExitStatus>,
    /// Last lines that the firmware and QEMU printed.
    pub output_tail: Vec<String>,
    /// Accesses to hardware that QEMU does not model, without those that `unmodelled.txt` explains.
    pub unmodelled: Vec<String>,
}

impl QemuExit {
    /// Whether QEMU ended by itself with exit code 0.
    pub fn is_success(&self) -> bool {
        self.status.is_some_and(|status| status.success())
    }

    /// Describes how QEMU ended.
    pub fn description(&self) -> String {
        match self.status {
            Some(status) => format!("QEMU has ended ({status})"),
            None => "QEMU did not end and was killed".into(),
        }
    }
}
