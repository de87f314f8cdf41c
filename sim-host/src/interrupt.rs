//! Ctrl-C (SIGINT), a request to terminate (SIGTERM) and the end of the terminal (SIGHUP): the program ends and leaves no
//! temporary file.

use std::sync::atomic::{AtomicBool, AtomicU8, Ordering};
use std::sync::{Arc, OnceLock};

use crate::output_file;

/// Number of SIGINT.
const SIGINT: u8 = 2;

/// The flag that a signal sets, once [`stop_flag`] has been called.
static STOP: OnceLock<Arc<AtomicBool>> = OnceLock::new();

/// Number of the last signal.
static SIGNAL: AtomicU8 = AtomicU8::new(SIGINT);

/// Installs the handler: a signal ends the program and removes its temporary files.
///
/// After [`stop_flag`] the first signal only sets the flag.
pub fn install_handler() {
    // An error is ignored: without a handler a signal still ends the program.
    let _ = on_signal(|signal| {
        SIGNAL.store(signal, Ordering::Relaxed);
        // The holder of the flag ends the program. A second signal ends it at once.
        if STOP.get().is_some_and(|stop| !stop.swap(true, Ordering::Relaxed)) {
            return;
        }
        output_file::remove_unfinished();
        std::process::exit(code().into());
    });
}

#[cfg(unix)]
fn on_signal(handler: impl Fn(u8) + Send + 'static) -> std::io::Result<()> {
    use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
    let mut signals = signal_hook::iterator::Signals::new([SIGINT, SIGTERM])?;
    // `nohup` starts the program with SIGHUP ignored.
    if !is_ignored(SIGHUP) {
        signals.add_signal(SIGHUP)?;
    }
    std::thread::spawn(move || signals.forever().for_each(|signal| handler(signal as u8)));
    Ok(())
}

/// Returns whether the program was started with this signal ignored. Only Linux tells it.
#[cfg(unix)]
fn is_ignored(signal: i32) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok())
        .is_some_and(|mask| mask >> (signal - 1) & 1 == 1)
}

#[cfg(not(unix))]
fn on_signal(handler: impl Fn(u8) + Send + 'static) -> Result<(), ctrlc::Error> {
    ctrlc::set_handler(move || handler(SIGINT))
}

/// Returns the exit code after a signal, as in shells: 128 and the signal's number. 130 after Ctrl-C.
pub fn code() -> u8 {
    128 + SIGNAL.load(Ordering::Relaxed)
}

/// Prints a message on standard error, removes temporary files and ends the program with the exit code of the signal.
pub fn exit(message: &str) -> ! {
    output_file::print_note(message);
    output_file::remove_unfinished();
    std::process::exit(code().into());
}

/// Returns whether the flag of [`stop_flag`] is set.
pub fn requested() -> bool {
    STOP.get().is_some_and(|stop| stop.load(Ordering::Relaxed))
}

/// Returns the flag that the first signal sets from now on, instead of ending the program.
pub fn stop_flag() -> Arc<AtomicBool> {
    STOP.get_or_init(Arc::default).clone()
}
