//! The log's health line, written once a second.

use tasks::counters::COUNTERS;

/// Logs the counters and resets them. `missed` is the number of deadlines missed since start.
pub fn log(missed: u32) {
    defmt::info!(
        "imu lost {=u32} polled {=u32} late {=u32} repeated {=u32} invalid {=u32} unreadable {=u32}, step {=u32} us, \
         outputs dropped {=u32} recovered {=u32}, mag {=u32} errors {=u32}, rc {=u32} bad {=u32}, \
         battery {=u32} mV, delayed {=u32} missed {=u32}",
        COUNTERS.lost.take(),
        COUNTERS.polled.take(),
        COUNTERS.late.take(),
        COUNTERS.repeated.take(),
        COUNTERS.invalid.take(),
        COUNTERS.unreadable.take(),
        COUNTERS.longest_us.take(),
        COUNTERS.outputs_dropped.take(),
        COUNTERS.outputs_recovered.take(),
        COUNTERS.mag.take(),
        COUNTERS.mag_errors.take(),
        COUNTERS.rc.take(),
        COUNTERS.rc_bad.take(),
        COUNTERS.battery_mv.take(),
        COUNTERS.delayed.take(),
        missed,
    );
}
