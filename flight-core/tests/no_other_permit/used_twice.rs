//! A permit is used up by what it permits.
use flight_core::MotorPermit;

fn drive(permit: MotorPermit) {
    let _first = permit.apply([1_500.0; 4], 1_000.0);
    let _second = permit.apply([1_500.0; 4], 1_000.0);
}

fn main() {}
