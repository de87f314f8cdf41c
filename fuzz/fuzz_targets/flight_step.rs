//! `FlightController::step` with any configuration and any input: what `flight-core/tests/any_input` flies at random,
//! flown by what finds new paths.
//!
//! No NaN and no infinity leaves, or stays inside; no motor turns without a permit; and the rest that
//! `any_input/promise.rs` checks in every step.
#![no_main]

#[path = "../../flight-core/tests/any_input/promise.rs"]
mod promise;
#[allow(dead_code)] // lists for a test that counts them through
#[path = "../../flight-core/tests/any_input/script.rs"]
mod script;

use libfuzzer_sys::fuzz_target;
use promise::Watched;
use script::{Bytes, Script};

fuzz_target!(|bytes: &[u8]| {
    let script = Script::read(&mut Bytes::new(bytes));
    if let Some(mut watched) = Watched::new(&script.config) {
        script.fly(&mut watched);
    }
});
