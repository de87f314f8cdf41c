//! The part of the firmware that needs no board: the extension of the microsecond counter.

#[path = "../../firmware/src/clock.rs"]
mod clock;

#[test]
fn the_clock_goes_on_where_its_counter_wraps() {
    let mut clock = clock::Clock::default();
    assert_eq!(clock.extend(5), 5);
    assert_eq!(clock.extend(5), 5);
    assert_eq!(clock.extend(u32::MAX), u64::from(u32::MAX));
    assert_eq!(clock.extend(0), 1 << 32);
    assert_eq!(clock.extend(1_000), (1 << 32) + 1_000);
}
