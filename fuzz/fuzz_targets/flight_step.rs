//! `FlightController::step` with any configuration and any input: what `tests/support/tests/any_input` flies at random,
//! flown by what finds new paths.
//!
//! No NaN and no infinity leaves, or stays inside; no motor turns without a permit; and the rest that
//! `test_support::invariants` checks in every step.
#![no_main]

use libfuzzer_sys::fuzz_target;
use test_support::invariants::CheckedController;
use test_support::script::{Bytes, Script};

fuzz_target!(|bytes: &[u8]| {
    let script = Script::read(&mut Bytes::new(bytes));
    if let Some(mut watched) = CheckedController::new(&script.config) {
        script.fly(&mut watched);
    }
});
