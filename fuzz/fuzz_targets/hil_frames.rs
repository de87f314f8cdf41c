//! The link's frames, as the firmware and `sim-host` take them: bytes as they come, and whole frames of any body.
//!
//! What is taken for a message is the same after it has been sent again; and a flight controller that takes a
//! configuration from the link keeps its promises.
#![no_main]

use hil_link::{Decoder, MAX_FRAME, Packet, ToBoard, ToHost, encode};
use libfuzzer_sys::fuzz_target;
use serde::Serialize;
use serde::ser::{SerializeTuple as _, Serializer};

use test_support::invariants::CheckedController;
use test_support::script::{Bytes, Script};

/// Bytes that postcard writes as they are.
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
            judge(&packet);
        }
    }
    // Whatever came before, the decoder is in step again behind a zero.
    decoder.push(0);
    let mut frame = [0; MAX_FRAME];
    let Ok(length) = encode(7, &Raw(data), &mut frame) else { return };
    let (end, before) = frame[..length].split_last().unwrap();
    assert!(before.iter().all(|byte| decoder.push(*byte).is_none()), "a frame before its end");
    let packet = decoder.push(*end).expect("the end of a frame").expect("a whole frame");
    assert_eq!(packet.sequence, 7);
    judge(&packet);
});

fn judge(packet: &Packet) {
    if let Some(message) = packet.message::<ToHost>() {
        sent_again(&message, |packet| packet.message::<ToHost>());
    }
    let Some(message) = packet.message::<ToBoard>() else { return };
    sent_again(&message, |packet| packet.message::<ToBoard>());
    if let ToBoard::Start(config) = message
        && let Some(mut watched) = CheckedController::new(&config)
    {
        Script::read(&mut Bytes::new(&[])).with(config).fly(&mut watched);
    }
}

/// As text: a number that is none is not equal to itself.
fn sent_again<T: Serialize + std::fmt::Debug>(message: &T, read: impl Fn(&Packet) -> Option<T>) {
    let mut frame = [0; MAX_FRAME];
    let length = encode(u32::MAX, message, &mut frame).expect("what came in a frame fits into one");
    let mut decoder = Decoder::default();
    let found = frame[..length].iter().find_map(|byte| {
        decoder.push(*byte).map(|packet| format!("{:?}", read(&packet.expect("a whole frame"))))
    });
    assert_eq!(found, Some(format!("{:?}", Some(message))));
}
