//! Feeds the decoders with a million random bytes.

use receiver::{Frame, Protocol, Receiver};

use test_support::wire::{self, BOTH, Random, received_us};

const BYTES: u64 = 1_000_000;

/// Returns the longest time that an uninterrupted run of frames spans, µs. In a run, frames are at most `joined_us`
/// apart. A run of one frame spans 0.
pub fn longest_run_us(frames: &[(u64, Frame)], joined_us: u64) -> u64 {
    let mut longest_us = 0;
    let mut run: Option<(u64, u64)> = None;
    for &(time_us, _) in frames {
        let start_us = match run {
            Some((start_us, last_us)) if time_us - last_us <= joined_us => start_us,
            _ => time_us,
        };
        run = Some((start_us, time_us));
        longest_us = longest_us.max(time_us - start_us);
    }
    longest_us
}

/// The time from one byte to the next, µs.
type Pattern = fn(Protocol, u64, &mut Random) -> u64;

const PATTERNS: [(&str, Pattern); 6] = [
    ("without a pause", |protocol, _, _| received_us(protocol, 0)),
    ("fetched every millisecond", |_, n, _| if n.is_multiple_of(9) { 1_000 } else { 0 }),
    ("all at once", |_, _, _| 0),
    ("a pause before every byte", |_, _, _| 2_000),
    ("bursts of 25", |protocol, n, _| if n.is_multiple_of(25) { 4_000 } else { received_us(protocol, 0) }),
    (
        "pauses at random",
        |protocol, _, random| {
            if random.below(25) == 0 { 4_000 } else { received_us(protocol, 0) }
        },
    ),
];

/// Returns all frames found in `bytes`. Each byte comes with the time since the one before, µs.
fn found(protocol: Protocol, bytes: impl Iterator<Item = (u8, u64)>) -> Vec<(u64, Frame)> {
    let mut receiver = Receiver::new(protocol);
    let mut time_us = 0;
    let mut frames = vec![];
    for (byte, since_us) in bytes {
        time_us += since_us;
        frames.extend(receiver.push(byte, time_us).map(|frame| (time_us, frame)));
    }
    assert_eq!(receiver.counts().good as usize, frames.len());
    frames
}

/// Expected number of frames in a million bytes:
/// - SBUS looks for a frame behind each of p·10⁶ pauses and needs 24 bytes without a pause, so that it finds
///   10⁶ · p · (1 − p)²⁴ · 1/256 · 1/16 · 5/256 frames: 0.07 with p = 1/25. Bursts of 25 bytes make
///   40,000 tries and 0.19 frames. Without any pause, or with a pause before every byte, there are none.
/// - CRSF: 10⁶ · 1/256 · 39/256 · 1/256 · 1/256 = 0.009.
#[test]
fn random_bytes_give_no_run_of_frames() {
    let mut total = 0;
    for protocol in BOTH {
        for (name, pattern) in PATTERNS {
            let mut random = Random(7);
            let bytes = (0..BYTES).map(|n| (random.byte(), pattern(protocol, n, &mut random)));
            let frames = found(protocol, bytes);
            println!("{protocol:?}, {name}: {} frames", frames.len());
            // 0.19 frames are expected. The probability of four or more is 1 in 20,000.
            assert!(frames.len() < 4, "{protocol:?}, {name}: {}", frames.len());
            assert_eq!(longest_run_us(&frames, 1_000_000), 0);
            total += frames.len();
        }
    }
    assert!(total < 4);
}

/// Frames that are valid except for the checked bytes, which are random. They measure the probabilities above: SBUS
/// bursts with the header in place pass with 1/16 · 5/256 (1 of 819), CRSF frames with a random checksum pass with
/// 1/256.
#[test]
fn malicious_frames_pass_at_the_computed_rate() {
    let frames = BYTES / 25;
    for (protocol, odds) in [(Protocol::Sbus, 16.0 * 256.0 / 5.0), (Protocol::Crsf, 256.0)] {
        let mut random = Random(8);
        let burst_us = 7_000;
        let bytes = (0..frames).flat_map(|_| {
            let mut burst: Vec<u8> = wire::channels(protocol, &random.channels());
            let checked = match protocol {
                Protocol::Sbus => 23..25,
                Protocol::Crsf => 25..26,
            };
            burst[checked].fill_with(|| random.byte());
            let byte_us = received_us(protocol, 0);
            let pause_us = burst_us - byte_us * (burst.len() as u64 - 1);
            burst
                .into_iter()
                .zip(std::iter::once(pause_us).chain(std::iter::repeat(byte_us)))
                .collect::<Vec<_>>()
        });
        let found = found(protocol, bytes);
        let expected = frames as f64 / odds;
        println!(
            "{protocol:?}: {} of {frames} malicious frames, {expected:.1} expected; longest run {} ms",
            found.len(),
            longest_run_us(&found, 1_000_000) / 1_000,
        );
        // The bound is four standard deviations of a Poisson distribution.
        assert!((found.len() as f64 - expected).abs() < 4.0 * expected.sqrt());
    }
}

#[test]
fn longest_run_is_measured() {
    let frame = Frame { channels: [0; 16], failsafe: false, frame_lost: false, link_quality: None };
    let at = |times: &[u64]| times.iter().map(|time_us| (*time_us, frame)).collect::<Vec<_>>();
    assert_eq!(longest_run_us(&[], 10), 0);
    assert_eq!(longest_run_us(&at(&[5]), 10), 0);
    assert_eq!(longest_run_us(&at(&[0, 11, 21, 31, 42, 50]), 10), 20);
}
