//! A permit can be used only once: `apply` consumes it.
use flight_core::MotorPermit;

fn drive(permit: MotorPermit) {
    let _first = permit.apply([1_500.0; 4], 1_000.0);
    let _second = permit.apply([1_500.0; 4], 1_000.0);
}

fn main() {}
