//! Ctrl-C and a request to terminate (SIGTERM): the program ends and leaves no temporary file.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};

use crate::output_file;

/// Exit code after Ctrl-C, as in shells: 128 + 2 (SIGINT).
pub const INTERRUPTED: u8 = 130;

/// The flag that Ctrl-C sets, once [`stop_flag`] has been called.
static STOP: OnceLock<Arc<AtomicBool>> = OnceLock::new();

/// Installs the handler: Ctrl-C ends the program and removes its temporary files.
///
/// After [`stop_flag`] the first Ctrl-C only sets the flag.
pub fn install_handler() {
    // An error is ignored: without a handler Ctrl-C still ends the program.
    let _ = ctrlc::set_handler(|| {
        // The holder of the flag ends the program. A second Ctrl-C ends it at once.
        if STOP.get().is_some_and(|stop| !stop.swap(true, Ordering::Relaxed)) {
            return;
        }
        output_file::remove_unfinished();
        std::process::exit(INTERRUPTED.into());
    });
}

/// Prints a message on standard error, removes temporary files and ends the program with the exit code of Ctrl-C.
pub fn exit(message: &str) -> ! {
    eprintln!("{message}");
    output_file::remove_unfinished();
    std::process::exit(INTERRUPTED.into());
}

/// Returns whether the flag of [`stop_flag`] is set.
pub fn requested() -> bool {
    STOP.get().is_some_and(|stop| stop.load(Ordering::Relaxed))
}

/// Returns the flag that the first Ctrl-C sets from now on, instead of ending the program.
pub fn stop_flag() -> Arc<AtomicBool> {
    STOP.get_or_init(Arc::default).clone()
}
