//! The decoders with valid frames.

use receiver::{Counts, Frame, Protocol};

use test_support::wire::{self, BOTH, listening, send};

#[test]
fn every_value_of_every_channel_is_decoded() {
    for protocol in BOTH {
        let mut receiver = listening(protocol);
        for value in 0..2_048_u16 {
            let channels = std::array::from_fn(|n| (value + 131 * n as u16) % 2_048);
            let start_us = (u64::from(value) + 1) * 7_000;
            let frames = send(&mut receiver, protocol, start_us, &wire::channels(protocol, &channels));
            let expected = Frame { channels, failsafe: false, frame_lost: false, link_quality: None };
            assert_eq!(frames, [expected]);
            assert!(expected.is_live());
        }
        assert_eq!(receiver.counts(), Counts { good: 2_048, bad: 0, resyncs: 0 });
    }
}

/// From ArduPilot, `AP_RCProtocol/examples/RCProtocolTest`: the frame and its channels in µs, 0.625 µs a tick.
#[test]
fn published_sbus_frame_is_decoded() {
    let frame = [
        0x0f, 0x4c, 0x1c, 0x5f, 0x32, 0x34, 0x38, 0xdd, 0x89, 0x83, 0x0f, 0x7c, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0,
        0, 0, 0,
    ];
    let frames = send(&mut listening(Protocol::Sbus), Protocol::Sbus, 10_000, &frame);
    let us = frames[0].channels.map(|ticks| 875 + ticks * 5 / 8);
    assert_eq!(us[..8], [1562, 1496, 1000, 1531, 1806, 2006, 1495, 1495]);
    assert_eq!(us[8..], [875; 8]);
}

/// From Betaflight, `src/test/unit/rx_crsf_unittest.cc`: two captured frames, whose checksum does not cover the
/// address (there 0x00, the broadcast), and one handwritten frame.
#[test]
fn published_crsf_frames_are_decoded() {
    let captured = [
        0x18, 0x16, 0xbd, 0x08, 0x9f, 0xf4, 0xae, 0xf7, 0xbd, 0xef, 0x7d, 0xef, 0xfb, 0xad, 0xfd, 0x45, 0x2b,
        0x5a, 0x01, 0, 0, 0, 0, 0, 0x6c,
    ];
    let mut second = captured;
    second[6] = 0xaa;
    second[24] = 0x94;
    let receive = |address, rest: &[u8]| {
        let frame = [&[address], rest].concat();
        send(&mut listening(Protocol::Crsf), Protocol::Crsf, 10_000, &frame)
    };
    assert_eq!(receive(0xc8, &captured)[0].channels[..4], [189, 993, 978, 983]);
    assert_eq!(receive(0xc8, &second)[0].channels[..4], [189, 993, 978, 981]);
    assert_eq!(receive(0x00, &captured), [], "a frame that is not addressed to a flight controller");

    let by_hand = [0xff, 0xff, 0, 0, 0x58, 0x01, 0, 0xf0, 0x01, 0x60, 0xe2, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0];
    let frame = wire::crsf(0xc8, 0x16, &by_hand);
    let [channels] =
        receive(0xc8, &frame[1..])[..].try_into().map(|[frame]: [Frame; 1]| [frame.channels]).unwrap();
    assert_eq!(channels[..9], [0x7ff, 0x1f, 0, 172, 0, 992, 0, 1811, 0]);

    // This is the catalogue's check value of CRC-8/DVB-S2 (reveng).
    assert_eq!(wire::crc(b"123456789"), 0xbc);
}

#[test]
fn sbus_accepts_only_valid_flags_and_footers() {
    let mut receiver = listening(Protocol::Sbus);
    let mut time_us = 0;
    for flags in 0..=u8::MAX {
        for footer in 0..=u8::MAX {
            time_us += 7_000;
            let frame = wire::sbus(&[992; 16], flags, footer);
            let frames = send(&mut receiver, Protocol::Sbus, time_us, &frame);
            if flags < 16 && [0, 0x04, 0x14, 0x24, 0x34].contains(&footer) {
                assert_eq!((frames[0].frame_lost, frames[0].failsafe), (flags & 4 != 0, flags & 8 != 0));
                assert_eq!(frames[0].is_live(), flags & 12 == 0);
            } else {
                assert_eq!(frames, []);
            }
        }
    }
    let Counts { good, bad, .. } = receiver.counts();
    assert_eq!((good, bad), (16 * 5, 65_536 - 16 * 5));
}

#[test]
fn crsf_link_quality_decides_whether_frames_are_live() {
    // The statistics are from the tests of the `crsf` crate; the uplink quality is 99 %.
    let published = [0xc8, 12, 0x14, 16, 19, 99, 151, 1, 2, 3, 8, 88, 148, 252];
    let channels = wire::crsf_channels(&[992; 16]);
    let mut receiver = listening(Protocol::Crsf);
    let mut at = |time_us, bytes: &[u8]| send(&mut receiver, Protocol::Crsf, time_us, bytes);

    assert_eq!(at(4_000, &channels)[0].link_quality, None);
    assert_eq!(at(8_000, &published), []);
    let frame = at(12_000, &channels)[0];
    assert_eq!((frame.link_quality, frame.is_live()), (Some(99), true));
    // Statistics and channels come back to back, as receivers send them.
    let frame = at(16_000, &[&wire::crsf_quality(0)[..], &channels].concat())[0];
    assert_eq!((frame.link_quality, frame.failsafe, frame.is_live()), (Some(0), true, false));
    // A report expires after a while. Without a report, channels are live by themselves.
    assert_eq!(at(500_000, &channels)[0].link_quality, Some(0));
    let frame = at(520_000, &channels)[0];
    assert_eq!((frame.link_quality, frame.is_live()), (None, true));
    assert_eq!(at(524_000, &wire::crsf_quality(1)), []);
    assert!(at(528_000, &channels)[0].is_live());
}

#[test]
fn other_crsf_frames_are_skipped_and_longer_ones_read() {
    let channels = [300; 16];
    let frame = wire::crsf_channels(&channels);
    // "Frame size may be bigger than expected": tbs-crsf-spec, "Frame details".
    let longer = wire::crsf(0xc8, 0x16, &[&wire::pack(&channels)[..], &[1]].concat());
    let others = [
        wire::crsf(0xc8, 0x16, &wire::pack(&channels)[..21]),
        wire::crsf(0xc8, 0x14, &[0; 9]),
        wire::crsf(0xc8, 0x16, &[]),
        wire::crsf(0xee, 0x16, &wire::pack(&channels)),
        wire::crsf(0xc8, 0x29, b"\xea\xecReceiver"),
        wire::crsf(0xc8, 0x7a, &[0xc8; 60]),
    ];
    let mut receiver = listening(Protocol::Crsf);
    for (n, other) in (1..).zip(&others) {
        assert_eq!(send(&mut receiver, Protocol::Crsf, n * 4_000, other), []);
    }
    let all = [others.concat(), longer, frame].concat();
    let frames = send(&mut receiver, Protocol::Crsf, 100_000, &all);
    assert_eq!(frames.iter().map(|frame| frame.channels).collect::<Vec<_>>(), [channels; 2]);
    assert_eq!(receiver.counts().bad, 0);
}

#[test]
fn line_settings_give_the_published_frame_times() {
    assert_eq!(wire::received_us(Protocol::Sbus, 24), 3_000);
    assert_eq!(wire::received_us(Protocol::Crsf, 25), 619);
    assert!(Protocol::Sbus.line().inverted && !Protocol::Crsf.line().inverted);
    // USART2 of an STM32F405 runs at 42 MHz and divides by a multiple of 1/16 with 16 samples a bit: both rates are
    // exact.
    for protocol in BOTH {
        assert_eq!(42_000_000 % protocol.line().baud, 0);
    }
}
