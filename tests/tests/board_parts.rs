//! The parts of the firmware that need no board: the extension of the microsecond counter, and the conversion
//! of pulses.

#[path = "../../firmware/src/clock.rs"]
mod clock;
#[path = "../../firmware/src/pulse.rs"]
mod pulse;

#[test]
fn the_clock_goes_on_where_its_counter_wraps() {
    let mut clock = clock::Clock::default();
    assert_eq!(clock.extend(5), 5);
    assert_eq!(clock.extend(5), 5);
    assert_eq!(clock.extend(u32::MAX), u64::from(u32::MAX));
    assert_eq!(clock.extend(0), 1 << 32);
    assert_eq!(clock.extend(1_000), (1 << 32) + 1_000);
}

#[test]
fn a_pulse_is_one_that_an_esc_understands() {
    let counts = |us| pulse::counts(us, 21.0);
    assert_eq!(counts(1_500.0), 31_500);
    assert_eq!(counts(1_234.56), 25_926);
    for (us, end) in [
        (f32::NAN, pulse::STOP_US),
        (f32::NEG_INFINITY, pulse::STOP_US),
        (0.0, pulse::STOP_US),
        (999.9, pulse::STOP_US),
        (2_000.1, pulse::FULL_US),
        (f32::INFINITY, pulse::FULL_US),
    ] {
        assert_eq!(f32::from(counts(us)), 21.0 * end, "{us}");
    }
}
