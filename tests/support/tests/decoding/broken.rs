//! Frames with something wrong, and the ones behind them.

use receiver::{Protocol, RECOVERY_FRAMES, Receiver};

use test_support::wire::{self, BOTH, Random, listening, received_us, send};

/// A broken frame, and 7 ms later a good one, which must arrive. Returns whether the broken one came through,
/// and with which channels.
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
            // With the next frame directly behind it, a flip in the length takes that frame's first bytes for the
            // rest of this one; where the checksum happens to fit, the channels are still those that were sent.
            start_us += 20_000;
            let both = [flipped, wire::crsf_channels(&next)].concat();
            for frame in send(&mut receiver, Protocol::Crsf, start_us, &both) {
                assert!(frame.channels == next || bit / 8 == 1 && frame.channels == channels, "bit {bit}");
            }
        }
    }
}

#[test]
fn a_bit_flip_in_sbus_is_caught_by_the_parity_alone() {
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

        // A port that checks the parity reports the byte as an error.
        start_us += 20_000;
        let (before, after) = (&frame[..bit / 8], &frame[bit / 8 + 1..]);
        let mut frames = send(&mut receiver, Protocol::Sbus, start_us, before);
        start_us += received_us(Protocol::Sbus, before.len());
        receiver.line_error(start_us);
        frames.extend(send(&mut receiver, Protocol::Sbus, start_us, after));
        assert_eq!(frames, []);
        assert_eq!(then_a_good_one(&mut receiver, Protocol::Sbus, start_us + 7_000, &[]), None);
    }
    // Without: each of the 176 bits of the channels gives one wrong channel.
    assert_eq!(wrong, 176);
}

#[test]
fn a_line_error_spoils_its_frame_alone() {
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
fn a_truncated_frame_is_none() {
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
fn spliced_frames() {
    let mut random = Random(3);
    for protocol in BOTH {
        let (mut spliced, mut wrong, mut last_lost, mut start_us) = (0, 0, 0, 0);
        let mut receiver = listening(protocol);
        for _ in 0..1_000 {
            let (one, two) = (random.channels(), random.channels());
            let (first, second) = (wire::channels(protocol, &one), wire::channels(protocol, &two));
            for at in 1..first.len() {
                // The beginning of one and the end of the other, and the beginning of one and the whole other.
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
            // The same header, flags and footer: SBUS cannot tell (the port can: a byte lost is an overrun).
            Protocol::Sbus => assert!(wrong > 0),
            // One of 256 has the right checksum. The frame behind the splice is lost if the bytes before it look
            // like the beginning of a longer one, at which the pause finds the decoder still waiting.
            Protocol::Crsf => {
                assert!(wrong < spliced / 256 * 5 / 4, "{wrong} of {spliced}");
                assert!(last_lost < spliced / 2 / 8, "{last_lost}");
            }
        }
    }
}

#[test]
fn the_second_good_frame_after_any_garbage_is_accepted() {
    let mut random = Random(4);
    for (protocol, period_us) in
        [(Protocol::Sbus, 7_000), (Protocol::Sbus, 14_000), (Protocol::Crsf, 4_000), (Protocol::Crsf, 40_000)]
    {
        let mut worst = 0;
        for _ in 0..20_000 {
            let mut receiver = Receiver::new(protocol);
            let mut garbage: Vec<u8> = (0..random.below(80)).map(|_| random.byte()).collect();
            // The worst that can stand at its end: the beginning of a frame.
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
fn crsf_too_fast_for_pauses_recovers_too() {
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
    println!("frames lost after garbage at 1,000 a second: {after:?}");
    let within_three: u32 = after[..4].iter().sum();
    assert!(within_three > 19_900 && after[10..].iter().sum::<u32>() == 0, "{after:?}");
}
