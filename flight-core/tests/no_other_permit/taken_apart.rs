//! A flight's permit cannot be told from the bench's, or made into one: what it allows is private.
use flight_core::arming::Allowed;

fn main() {
    let _ = Allowed::Flight;
}
