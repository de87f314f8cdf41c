//! The health line of the log, once a second.

use tasks::tally::TALLY;

/// Writes it, and begins to count anew. `missed`: deadlines missed since start.
pub fn log(missed: u32) {
    defmt::info!(
        "imu lost {=u32} polled {=u32} late {=u32} repeated {=u32} invalid {=u32} unreadable {=u32}, flight {=u32} us, \
         outputs dropped {=u32} recovered {=u32}, mag {=u32} errors {=u32}, rc {=u32} bad {=u32}, \
         battery {=u32} mV, delayed {=u32} missed {=u32}",
        TALLY.lost.take(),
        TALLY.polled.take(),
        TALLY.late.take(),
        TALLY.repeated.take(),
        TALLY.invalid.take(),
        TALLY.unreadable.take(),
        TALLY.longest_us.take(),
        TALLY.outputs_dropped.take(),
        TALLY.outputs_recovered.take(),
        TALLY.mag.take(),
        TALLY.mag_errors.take(),
        TALLY.rc.take(),
        TALLY.rc_bad.take(),
        TALLY.battery_mv.take(),
        TALLY.delayed.take(),
        missed,
    );
}
