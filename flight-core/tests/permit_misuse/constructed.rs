//! A permit cannot be constructed: its field is private, and it has no constructor and no default.
use flight_core::MotorPermit;

fn main() {
    let _tuple = MotorPermit(Default::default());
    let _default = MotorPermit::default();
}
