//! Feeds the decoders with broken frames, each followed by valid frames.

use receiver::{Protocol, RECOVERY_FRAMES, Receiver};

use test_support::wire::{self, BOTH, Random, listening, received_us, send};

/// Sends a broken frame and, 7 ms later, a valid one, which must be decoded. Returns the channels of the broken frame
/// if it was decoded.
fn then_a_good_one(
    receiver: &mut Receiver,
    protocol: Protocol,
    start_us: u64,
    broken: &[u8],
) -> Option<[u16; 16]> {
    let frames = send(receiver, protocol, start_us, broken);
    let good = [1_234; 16];
    let after = send(receiver, protocol, start_us + 7_000, &wire::channels(protocol, &good));
    assert_eq!(after.iter().map(|frame| frame.channels).collect::<Vec<_>>(), [good]);
    assert!(frames.len() <= 1);
    frames.first().map(|frame| frame.channels)
}

#[test]
fn no_single_bit_flip_gives_a_wrong_crsf_frame() {
    let mut random = Random(1);
    let mut receiver = listening(Protocol::Crsf);
    let mut start_us = 0;
    for _ in 0..500 {
        let (channels, next) = (random.channels(), random.channels());
        let frame = wire::crsf_channels(&channels);
        for bit in 0..8 * frame.len() {
            let mut flipped = frame.clone();
            flipped[bit / 8] ^= 1 << (bit % 8);
            start_us += 20_000;
            assert_eq!(then_a_good_one(&mut receiver, Protocol::Crsf, start_us, &flipped), None, "bit {bit}");
            // If the next frame follows directly, a flipped bit in the length makes the first bytes of that frame the
            // rest of this one. If the checksum then happens to match, the channels are still those that were sent.
            start_us += 20_000;
            let both = [flipped, wire::crsf_channels(&next)].concat();
            for frame in send(&mut receiver, Protocol::Crsf, start_us, &both) {
                assert!(frame.channels == next || bit / 8 == 1 && frame.channels == channels, "bit {bit}");
            }
        }
    }
}

#[test]
fn sbus_bit_flip_is_detected_only_by_parity() {
    let mut random = Random(2);
    let mut start_us = 0;
    let channels = random.channels();
    let frame = wire::sbus(&channels, 0, 0);
    let mut wrong = 0;
    for bit in 0..8 * frame.len() {
        let mut flipped = frame.clone();
        flipped[bit / 8] ^= 1 << (bit % 8);
        let mut receiver = listening(Protocol::Sbus);
        start_us += 20_000;
        let taken = then_a_good_one(&mut receiver, Protocol::Sbus, start_us, &flipped);
        wrong += u32::from(taken.is_some_and(|taken| taken != channels));

        // A port with parity check reports the byte as a line error.
        start_us += 20_000;
        let (before, after) = (&frame[..bit / 8], &frame[bit / 8 + 1..]);
        let mut frames = send(&mut receiver, Protocol::Sbus, start_us, before);
        start_us += received_us(Protocol::Sbus, before.len());
        receiver.line_error(start_us);
        frames.extend(send(&mut receiver, Protocol::Sbus, start_us, after));
        assert_eq!(frames, []);
        assert_eq!(then_a_good_one(&mut receiver, Protocol::Sbus, start_us + 7_000, &[]), None);
    }
    // Without the parity check, each of the 176 channel bits gives one wrong channel.
    assert_eq!(wrong, 176);
}

#[test]
fn line_error_drops_only_its_frame() {
    for protocol in BOTH {
        let frame = wire::channels(protocol, &[500; 16]);
        for at in 0..frame.len() {
            let mut receiver = listening(protocol);
            let mut frames = send(&mut receiver, protocol, 10_000, &frame[..at]);
            receiver.line_error(10_000 + received_us(protocol, at));
            frames.extend(send(
                &mut receiver,
                protocol,
                10_000 + received_us(protocol, at),
                &frame[at + 1..],
            ));
            assert_eq!(frames, [], "byte {at}");
            assert_eq!(receiver.counts().bad, 1, "byte {at}");
            assert_eq!(then_a_good_one(&mut receiver, protocol, 20_000, &[]), None);
        }
    }
}

#[test]
fn truncated_frames_are_dropped() {
    for protocol in BOTH {
        let frame = wire::channels(protocol, &[500; 16]);
        for length in 0..frame.len() {
            for cut in [&frame[..length], &frame[frame.len() - length..]] {
                let mut receiver = listening(protocol);
                assert_eq!(then_a_good_one(&mut receiver, protocol, 10_000, cut), None);
            }
        }
    }
}

#[test]
fn spliced_frames_are_caught_by_the_crsf_checksum() {
    let mut random = Random(3);
    for protocol in BOTH {
        let (mut spliced, mut wrong, mut last_lost, mut start_us) = (0, 0, 0, 0);
        let mut receiver = listening(protocol);
        for _ in 0..1_000 {
            let (one, two) = (random.channels(), random.channels());
            let (first, second) = (wire::channels(protocol, &one), wire::channels(protocol, &two));
            for at in 1..first.len() {
                // The line has the start of one frame with the end of another, or the start of one with another
                // whole frame.
                let ended = [&first[..at], &second[at..]].concat();
                start_us += 20_000;
                let taken = then_a_good_one(&mut receiver, protocol, start_us, &ended);
                let begun = [&first[..at], &second].concat();
                start_us += 20_000;
                let frames = send(&mut receiver, protocol, start_us, &begun);
                let taken_too = frames.first().map(|frame| frame.channels);
                let is_wrong = |channels| channels != one && channels != two;
                spliced += 2;
                wrong += u32::from(taken.is_some_and(is_wrong)) + u32::from(taken_too.is_some_and(is_wrong));
                last_lost += u32::from(frames.last().is_none_or(|frame| frame.channels != two));
            }
        }
        println!(
            "{protocol:?}: {wrong} wrong frames of {spliced} spliced ones, {last_lost} of the last lost"
        );
        match protocol {
            // Header, flags and footer are unchanged, so SBUS cannot detect the loss. The port can, because a lost byte
            // is an overrun.
            Protocol::Sbus => assert!(wrong > 0),
            // One of 256 has a matching checksum. The frame behind the splice is lost if the bytes before it look like
            // the start of a longer frame, for which the decoder still waits when the pause comes.
            Protocol::Crsf => {
                assert!(wrong < spliced / 256 * 5 / 4, "{wrong} of {spliced}");
                assert!(last_lost < spliced / 2 / 8, "{last_lost}");
            }
        }
    }
}

#[test]
fn second_good_frame_after_any_garbage_is_accepted() {
    let mut random = Random(4);
    for (protocol, period_us) in
        [(Protocol::Sbus, 7_000), (Protocol::Sbus, 14_000), (Protocol::Crsf, 4_000), (Protocol::Crsf, 40_000)]
    {
        let mut worst = 0;
        for _ in 0..20_000 {
            let mut receiver = Receiver::new(protocol);
            let mut garbage: Vec<u8> = (0..random.below(80)).map(|_| random.byte()).collect();
            // The worst case is garbage that ends with the start of a frame.
            let beginning = wire::channels(protocol, &random.channels());
            garbage.extend(&beginning[..random.below(beginning.len() as u64) as usize]);
            send(&mut receiver, protocol, 10_000, &garbage);
            let start_us = 10_000 + received_us(protocol, garbage.len());
            let accepted = (1..).find(|n| {
                let channels = random.channels();
                let frame = wire::channels(protocol, &channels);
                let frames = send(&mut receiver, protocol, start_us + (n - 1) * period_us, &frame);
                frames.last().is_some_and(|frame| frame.channels == channels)
            });
            worst = worst.max(accepted.unwrap());
        }
        assert_eq!(worst as usize, RECOVERY_FRAMES, "{protocol:?} every {period_us} µs");
    }
}

#[test]
fn crsf_without_pauses_recovers_within_ten_frames() {
    let mut random = Random(5);
    let mut after = [0; 16];
    for _ in 0..20_000 {
        let mut receiver = Receiver::new(Protocol::Crsf);
        let garbage: Vec<u8> = (0..random.below(80)).map(|_| random.byte()).collect();
        send(&mut receiver, Protocol::Crsf, 10_000, &garbage);
        let start_us = 10_000 + received_us(Protocol::Crsf, garbage.len());
        let accepted = (0..16).find(|n| {
            let channels = random.channels();
            let frames =
                send(&mut receiver, Protocol::Crsf, start_us + n * 1_000, &wire::crsf_channels(&channels));
            frames.last().is_some_and(|frame| frame.channels == channels)
        });
        after[accepted.unwrap() as usize] += 1;
    }
    println!("count by frames lost after garbage, at 1,000 frames a second: {after:?}");
    let within_three: u32 = after[..4].iter().sum();
    assert!(within_three > 19_900 && after[10..].iter().sum::<u32>() == 0, "{after:?}");
}
