//! ESC pulses as timer counts.

use flight_core::esc::EscParams;

/// The stop pulse, µs.
pub const STOP_US: f32 = EscParams::STANDARD.stop_us;
/// The longest pulse, µs.
pub const FULL_US: f32 = EscParams::STANDARD.full_us;

/// A pulse of `us` in counts of a timer with `per_us` counts a microsecond, to the nearest one.
///
/// Whatever comes in, what goes out is a pulse that an ESC understands: values out of range go to the range's
/// ends, and NaN, which is not above the stop pulse, to that.
pub fn counts(us: f32, per_us: f32) -> u16 {
    let at_least_stop = if us > STOP_US { us } else { STOP_US };
    let within = if at_least_stop < FULL_US { at_least_stop } else { FULL_US };
    (within * per_us + 0.5) as u16
}
