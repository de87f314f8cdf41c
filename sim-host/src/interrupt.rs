//! Ctrl-C, and a request to terminate: the program ends without a temporary file left behind.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};

use crate::output_file;

/// Exit code after Ctrl-C, as shells have it: 128 + SIGINT.
const INTERRUPTED: i32 = 130;

/// Set by Ctrl-C, if somebody has asked for it.
static STOP: OnceLock<Arc<AtomicBool>> = OnceLock::new();

/// Ends the program at Ctrl-C, without a temporary file left behind.
pub fn listen() {
    // Without a handler Ctrl-C still ends the program.
    let _ = ctrlc::set_handler(|| {
        // Who has asked for the flag ends by it; a second Ctrl-C says that it takes too long.
        if STOP.get().is_some_and(|stop| !stop.swap(true, Ordering::Relaxed)) {
            return;
        }
        output_file::remove_unfinished();
        std::process::exit(INTERRUPTED);
    });
}

/// Ends the program after Ctrl-C, having said what has become of its work.
pub fn end(said: &str) -> ! {
    eprintln!("{said}");
    output_file::remove_unfinished();
    std::process::exit(INTERRUPTED);
}

/// From now on Ctrl-C sets this flag.
pub fn flag() -> Arc<AtomicBool> {
    STOP.get_or_init(Arc::default).clone()
}
