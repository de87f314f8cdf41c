//! Fuzzes the frames of the hardware-in-the-loop link, which the firmware and `sim-host` decode: first the input as a
//! stream of bytes, then valid frames with the input as their body.
//!
//! A decoded message is the same after it is encoded and decoded again. A flight controller that accepts a
//! configuration from the link keeps its invariants.
#![no_main]

use hil_link::{Decoder, MAX_FRAME, Packet, ToBoard, ToHost, encode};
use libfuzzer_sys::fuzz_target;
use serde::Serialize;
use serde::ser::{SerializeTuple as _, Serializer};

use test_support::invariants::CheckedController;
use test_support::script::{Bytes, Script};

/// Bytes that postcard writes unchanged.
struct Raw<'a>(&'a [u8]);

impl Serialize for Raw<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut bytes = serializer.serialize_tuple(self.0.len())?;
        self.0.iter().try_for_each(|byte| bytes.serialize_element(byte))?;
        bytes.end()
    }
}

fuzz_target!(|data: &[u8]| {
    let mut decoder = Decoder::default();
    for byte in data {
        if let Some(Ok(packet)) = decoder.push(*byte) {
            check(&packet);
        }
    }
    // After any input, a zero byte resynchronises the decoder.
    decoder.push(0);
    let mut frame = [0; MAX_FRAME];
    let Ok(length) = encode(7, &Raw(data), &mut frame) else { return };
    let (end, before) = frame[..length].split_last().unwrap();
    assert!(before.iter().all(|byte| decoder.push(*byte).is_none()), "a frame before its end");
    let packet = decoder.push(*end).expect("the end of a frame").expect("a valid frame");
    assert_eq!(packet.sequence, 7);
    check(&packet);
});

fn check(packet: &Packet) {
    if let Some(message) = packet.message::<ToHost>() {
        check_round_trip(&message, |packet| packet.message::<ToHost>());
    }
    let Some(message) = packet.message::<ToBoard>() else { return };
    check_round_trip(&message, |packet| packet.message::<ToBoard>());
    if let ToBoard::Start(config) = message
        && let Some(mut controller) = CheckedController::new(&config)
    {
        Script::read(&mut Bytes::new(&[])).with_config(config).fly(&mut controller);
    }
}

/// Checks that a message is the same after it is sent again. Compared as text, because NaN is not equal to itself.
fn check_round_trip<T: Serialize + std::fmt::Debug>(message: &T, read: impl Fn(&Packet) -> Option<T>) {
    let mut frame = [0; MAX_FRAME];
    let length =
        encode(u32::MAX, message, &mut frame).expect("a message that came in a frame fits into a frame");
    let mut decoder = Decoder::default();
    let found = frame[..length].iter().find_map(|byte| {
        decoder.push(*byte).map(|packet| format!("{:?}", read(&packet.expect("a valid frame"))))
    });
    assert_eq!(found, Some(format!("{:?}", Some(message))));
}
