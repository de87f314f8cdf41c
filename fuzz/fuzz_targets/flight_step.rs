//! Fuzzes `FlightController::step` with any configuration and any input. The scripts are those that
//! `tests/support/tests/any_input` generates at random; here libFuzzer searches for new paths.
//!
//! Checks the invariants of `test_support::invariants` in every step: among others, no output or state is NaN or
//! infinite, and no motor turns without a permit.
#![no_main]

use libfuzzer_sys::fuzz_target;
use test_support::invariants::CheckedController;
use test_support::script::{Bytes, Script};

fuzz_target!(|bytes: &[u8]| {
    let script = Script::read(&mut Bytes::new(bytes));
    if let Some(mut controller) = CheckedController::new(&script.config) {
        script.fly(&mut controller);
    }
});
