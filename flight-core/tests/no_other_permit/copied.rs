//! A permit cannot be duplicated.
use flight_core::MotorPermit;

fn two(permit: &MotorPermit) -> (MotorPermit, MotorPermit) {
    (permit.clone(), *permit)
}

fn main() {}
