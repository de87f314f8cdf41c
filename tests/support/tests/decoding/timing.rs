//! The decoders with bytes fetched at any interval that the firmware may use.

use receiver::{Frame, GAP_US, Protocol, Receiver};

use test_support::wire::{self, BOTH, Random, received_us, send};

/// Returns two seconds of bytes from a receiver that sends every `period_us`, with link statistics behind every fifth
/// frame.
fn stream(protocol: Protocol, period_us: u64, random: &mut Random) -> Vec<(u8, u64)> {
    let mut bytes = vec![];
    for n in 0..2_000_000 / period_us {
        let mut frame = wire::channels(protocol, &random.channels());
        if protocol == Protocol::Crsf && n % 5 == 0 {
            frame.extend(wire::crsf_quality(random.below(101) as u8));
        }
        let start_us = 10_000 + n * period_us;
        bytes.extend(frame.iter().zip(0..).map(|(byte, at)| (*byte, start_us + received_us(protocol, at))));
    }
    bytes
}

fn receive(protocol: Protocol, bytes: impl Iterator<Item = (u8, u64)>) -> Vec<Frame> {
    let mut receiver = Receiver::new(protocol);
    // A first byte, so that a pause precedes the first frame.
    receiver.push(0, 0);
    bytes.filter_map(|(byte, time_us)| receiver.push(byte, time_us)).collect()
}

#[test]
fn chunks_of_any_size_give_the_same_frames() {
    let mut random = Random(6);
    let (sbus, crsf) = (Protocol::Sbus, Protocol::Crsf);
    for (protocol, period_us) in [
        (sbus, 7_000),
        (sbus, 9_000),
        (sbus, 14_000),
        (crsf, 1_000),
        (crsf, 2_000),
        (crsf, 4_000),
        (crsf, 20_000),
    ] {
        let bytes = stream(protocol, period_us, &mut random);
        let expected = receive(protocol, bytes.iter().copied());
        assert_eq!(expected.len() as u64, 2_000_000 / period_us);
        // A task fetches the bytes, every `every_us` on average. The time of a byte is the time at which it is fetched.
        for every_us in [20, 100, 500, 1_000] {
            for _ in 0..20 {
                let mut fetched_us = random.below(1_000);
                let fetched = bytes.iter().map(|&(byte, time_us)| {
                    while fetched_us < time_us {
                        fetched_us += if every_us == 1_000 { 1_000 } else { 1 + random.below(2 * every_us) };
                    }
                    (byte, fetched_us)
                });
                let same = receive(protocol, fetched) == expected;
                assert!(same, "{protocol:?} every {period_us}, {every_us}");
            }
        }
    }
}

#[test]
fn gap_threshold_separates_bytes_from_frames() {
    let byte_us = received_us(Protocol::Sbus, 0);
    let frame_us = received_us(Protocol::Sbus, 24);
    for late_us in [0, 1_000, 1_879] {
        assert!(byte_us + late_us < GAP_US && GAP_US < 7_000 - frame_us + byte_us - late_us);
    }
}

#[test]
fn sbus_needs_a_pause_before_each_frame() {
    let frame = wire::sbus(&[992; 16], 0, 0);
    let mut receiver = Receiver::new(Protocol::Sbus);
    assert_eq!(send(&mut receiver, Protocol::Sbus, 10_000, &frame.repeat(50)), []);
    // The frame behind the pause is decoded; those that follow it without a pause are not.
    assert_eq!(send(&mut receiver, Protocol::Sbus, 500_000, &frame.repeat(3)).len(), 1);
}

#[test]
fn clock_that_stops_or_steps_back_is_harmless() {
    for protocol in BOTH {
        let frame = wire::channels(protocol, &[700; 16]);
        let mut receiver = Receiver::new(protocol);
        receiver.push(0, u64::MAX);
        for time_us in [u64::MAX, 5, 5, 0] {
            for byte in &frame {
                receiver.push(*byte, time_us);
            }
        }
        assert_eq!(send(&mut receiver, protocol, 10_000, &frame).len(), 1);
    }
}
