use std::vec::Vec;

use flight_core::arming::{Cause, Event};
use flight_core::calibration::Calibration;
use flight_core::sample::{Battery, ImuSample, LinkStatus, MagSample, RcFrame};
use flight_core::{ArmState, Config, Params};
use proptest::prelude::*;

use crate::*;

fn frame(sequence: u32, message: &impl serde::Serialize) -> Vec<u8> {
    let mut frame = [0; MAX_FRAME];
    let length = encode(sequence, message, &mut frame).unwrap();
    frame[..length].to_vec()
}

/// Decodes bytes to sequence numbers and messages, or errors.
fn decode<T: serde::de::DeserializeOwned>(bytes: &[u8]) -> Vec<Result<(u32, Option<T>), FrameError>> {
    let mut decoder = Decoder::default();
    let mut found = std::vec![];
    for byte in bytes {
        if let Some(result) = decoder.push(*byte) {
            found.push(result.map(|packet| (packet.sequence, packet.message())));
        }
    }
    found
}

fn step() -> Step {
    Step {
        time_us: 12_345_678_901,
        imu: Some(ImuSample { gyro: [1, -2, i16::MIN], accel: [i16::MAX, 0, -2_048] }),
        mag: Some(MagSample { counts: [750, -3, 1_230] }),
        rc: Some(RcFrame {
            channels: [172, 992, 1_811, 2_047],
            arm_switch: 172,
            mode_switch: 1_811,
            status: LinkStatus::FrameLost,
        }),
        battery: Some(Battery { voltage_v: 11.1 }),
    }
}

#[test]
fn messages_survive_encoding_and_decoding() {
    let config = Config { params: Params::default(), calibration: Some(Calibration::NONE) };
    for message in
        [ToBoard::Start(config), ToBoard::Step(step()), ToBoard::Step(Step::default()), ToBoard::End]
    {
        assert_eq!(decode(&frame(7, &message)), [Ok((7, Some(message)))]);
    }
    let done = Done {
        time_us: u64::MAX,
        state: ArmState::Descent,
        event: Some(Event { from: ArmState::Armed, to: ArmState::Descent, cause: Cause::RcLost }),
        driven: true,
        pulses_us: [1_000.0, 1_234.567_9, 2_000.0, f32::MIN_POSITIVE],
        attitude: [1.0, -0.0, 1.0e-38, 0.5],
        instructions: 1_900,
        missed_deadlines: 3,
        received: Received { corrupt: 1, lost: 2, repeated: u32::MAX },
    };
    for message in [ToHost::Ready(Started { watchdog_reset: true }), ToHost::Refused, ToHost::Done(done)] {
        assert_eq!(decode(&frame(u32::MAX, &message)), [Ok((u32::MAX, Some(message)))]);
    }
}

#[test]
fn packet_has_the_documented_layout() {
    // Version 1, one byte, sequence number 258, variant 2 of `ToBoard`, and the CRC by another implementation
    // (Python: `hex(zlib.crc32(bytes([1, 1, 0, 2, 1, 0, 0, 2])))` is 0x4b32a1e7), then COBS by hand.
    let mut packet = std::vec![1, 1, 0, 2, 1, 0, 0, 2];
    let crc = {
        // This computes the checksum bit by bit, as in the standard: reflected, polynomial 0xEDB88320, inverted
        // at both ends.
        !packet.iter().fold(u32::MAX, |crc, byte| {
            (0..8).fold(
                crc ^ u32::from(*byte),
                |crc, _| if crc & 1 != 0 { crc >> 1 ^ 0xedb8_8320 } else { crc >> 1 },
            )
        })
    };
    packet.extend(crc.to_le_bytes());
    let mut encoded = std::vec![];
    for block in packet.split(|byte| *byte == 0) {
        encoded.push(block.len() as u8 + 1);
        encoded.extend(block);
    }
    encoded.push(0);
    assert_eq!(frame(258, &ToBoard::End), encoded);
}

#[test]
fn bit_errors_are_detected_and_next_frame_is_decoded() {
    let good = frame(1, &ToBoard::Step(step()));
    let next = frame(2, &ToBoard::End);
    let bits = 8 * good.len();
    for first in 0..bits {
        for second in (first..bits).step_by(13) {
            let mut bytes = good.clone();
            bytes[first / 8] ^= 1 << (first % 8);
            if second != first {
                bytes[second / 8] ^= 1 << (second % 8);
            }
            bytes.extend(&next);
            // A flipped bit can end the frame early, or remove its end and so destroy the next frame, too. The decoder
            // reports an error in both cases.
            let found = decode::<ToBoard>(&bytes);
            assert!(found.iter().any(Result::is_err), "bits {first}, {second}");
            assert!(!found.iter().flatten().any(|(sequence, _)| *sequence == 1), "bits {first}, {second}");
            let end_is_removed = bytes[good.len() - 1] != 0;
            assert_eq!(found.last().unwrap().is_ok(), !end_is_removed, "bits {first}, {second}");
        }
    }
}

#[test]
fn error_names_another_version() {
    let mut frame_bytes = frame(0, &ToBoard::End);
    // A valid packet of version 9. In COBS the first byte is a count, the second the version.
    frame_bytes.clear();
    let mut packet = std::vec![9, 1, 0, 0, 0, 0, 0, 2];
    let crc = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(&packet);
    packet.extend(crc.to_le_bytes());
    let mut encoded = [0; 64];
    let length = cobs::encode(&packet, &mut encoded);
    assert_eq!(decode::<ToBoard>(&[&encoded[..length], &[0]].concat()), [Err(FrameError::Version(9))]);
}

#[test]
fn frame_without_end_is_an_error_and_next_is_decoded() {
    let mut bytes = std::vec![1; 3 * MAX_FRAME];
    bytes.push(0);
    bytes.extend(frame(5, &ToBoard::End));
    assert_eq!(decode(&bytes), [Err(FrameError::TooLong), Ok((5, Some(ToBoard::End)))]);
}

#[test]
fn sequence_numbers_tell_repeats_from_losses() {
    assert_eq!(Order::of(0, None), Order::Next);
    assert_eq!(Order::of(3, None), Order::Lost(3));
    assert_eq!(Order::of(8, Some(7)), Order::Next);
    assert_eq!(Order::of(7, Some(7)), Order::Repeated);
    assert_eq!(Order::of(2, Some(7)), Order::Repeated);
    assert_eq!(Order::of(10, Some(7)), Order::Lost(2));
    assert_eq!(Order::of(0, Some(u32::MAX)), Order::Next);
    assert_eq!(Order::of(u32::MAX, Some(0)), Order::Repeated);
}

proptest! {
    #[test]
    fn random_bytes_give_no_message(bytes in prop::collection::vec(any::<u8>(), 0..2_000)) {
        for (_, message) in decode::<ToBoard>(&bytes).into_iter().flatten() {
            prop_assert!(message.is_none(), "a frame in noise has one chance in 2³²");
        }
    }

    #[test]
    fn truncated_frame_gives_an_error_or_nothing(cut in 0_usize..60) {
        let good = frame(1, &ToBoard::Step(step()));
        // Cut at least one byte more than the final zero, because a frame that lacks only this zero would be complete.
        let cut = cut.min(good.len() - 2);
        let found = decode::<ToBoard>(&[&good[..cut], &[0]].concat());
        prop_assert!(found.iter().all(Result::is_err), "cut at {cut}");
    }
}
