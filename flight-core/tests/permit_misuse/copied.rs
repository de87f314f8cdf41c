//! A permit cannot be copied or cloned.
use flight_core::MotorPermit;

fn two(permit: &MotorPermit) -> (MotorPermit, MotorPermit) {
    (permit.clone(), *permit)
}

fn main() {}
