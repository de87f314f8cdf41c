//! The content of a permit is private: code cannot distinguish or change what it allows.
use flight_core::arming::Allowed;

fn main() {
    let _ = Allowed::Flight;
}
