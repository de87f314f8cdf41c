//! Fuzzes the line of an RC receiver: bytes at any time, damaged bytes, and frames with valid checksums.
//!
//! A decoded frame equals the bytes received, bit for bit, by an independent encoder. Counters only rise. The
//! firmware's search for the protocol gets the same bytes.
#![no_main]

use flight_core::rc::ChannelMap;
use libfuzzer_sys::fuzz_target;
use receiver::search::{Received, Search};
use receiver::{Counts, Frame, Protocol, Receiver};
use test_support::wire;

/// Number of bytes in which every frame lies.
const MAX_FRAME_BYTES: usize = 256;

struct Line {
    protocol: Protocol,
    receiver: Receiver,
    search: Search,
    time_us: u64,
    /// The bytes since the last damaged one.
    bytes: Vec<u8>,
    counts: Counts,
}

impl Line {
    fn byte(&mut self, byte: u8, after_us: u64) {
        self.time_us = self.time_us.saturating_add(after_us);
        self.bytes.push(byte);
        self.search.next_line(self.time_us);
        self.search.push(Received::Byte(byte), self.time_us);
        let frame = self.receiver.push(byte, self.time_us);
        let counts = self.receiver.counts();
        assert_eq!(counts.good - self.counts.good, u32::from(frame.is_some()));
        assert!(counts.bad >= self.counts.bad && counts.resyncs >= self.counts.resyncs, "{counts:?}");
        self.counts = counts;
        if let Some(frame) = frame {
            self.check(&frame);
        }
    }

    fn damaged(&mut self, after_us: u64) {
        self.time_us = self.time_us.saturating_add(after_us);
        // A damaged byte is part of no frame, so the bytes before it are not needed any more.
        self.bytes.clear();
        self.search.push(Received::Damaged, self.time_us);
        self.receiver.line_error(self.time_us);
        self.counts = self.receiver.counts();
    }

    fn check(&self, frame: &Frame) {
        let recent = &self.bytes[self.bytes.len().saturating_sub(MAX_FRAME_BYTES)..];
        let packed = wire::pack(&frame.channels);
        match self.protocol {
            Protocol::Sbus => {
                let [.., flags, footer] = recent else { panic!("a frame without bytes") };
                assert!(recent.ends_with(&wire::sbus(&frame.channels, *flags, *footer)), "{frame:?}");
                assert_eq!((frame.frame_lost, frame.failsafe), (flags & 4 != 0, flags & 8 != 0));
                assert!(flags & 0xf0 == 0 && [0, 0x04, 0x14, 0x24, 0x34].contains(footer));
            }
            Protocol::Crsf => {
                let is_frame = |at: &[u8]| {
                    let [0xc8, length, 0x16, payload @ ..] = at else { return false };
                    let length = usize::from(*length);
                    payload.starts_with(&packed)
                        && (24..=62).contains(&length)
                        && at.get(1 + length) == Some(&wire::crc(&at[2..1 + length]))
                };
                // Not always at the end: when the decoder gives up a frame, it may find another one in its bytes.
                assert!((0..recent.len()).any(|start| is_frame(&recent[start..])), "{frame:?}");
            }
        }
        let rc = frame.to_rc(&ChannelMap::AETR);
        assert!(rc.channels.iter().all(|ticks| frame.channels.contains(ticks)), "{rc:?} of {frame:?}");
    }

    /// Sends the bytes of a frame, with or without a pause before them.
    fn frame(&mut self, bytes: &[u8], pause: bool) {
        let byte_us = wire::received_us(self.protocol, 0);
        for (n, byte) in bytes.iter().enumerate() {
            self.byte(*byte, if n == 0 && pause { 4_000 } else { byte_us });
        }
    }
}

fuzz_target!(|data: &[u8]| {
    let mut rest = data;
    let mut take = |max: usize| {
        let (taken, left) = rest.split_at(max.min(rest.len()));
        rest = left;
        taken
    };
    let protocol = if take(1) == [0] { Protocol::Sbus } else { Protocol::Crsf };
    let mut line = Line {
        protocol,
        receiver: Receiver::new(protocol),
        search: Search::new(ChannelMap::AETR),
        time_us: 0,
        bytes: Vec::new(),
        counts: Counts::default(),
    };
    while let [kind] = take(1) {
        let pause = kind & 0x80 == 0;
        match kind % 8 {
            0 => line.damaged(u64::from(kind >> 3) * 100),
            1 => {
                let after_us = take(2).iter().fold(0, |us, byte| us << 8 | u64::from(*byte));
                take(1).iter().for_each(|byte| line.byte(*byte, after_us));
            }
            2 => {
                let ticks = take(22);
                let mut packed = [0; 22];
                packed[..ticks.len()].copy_from_slice(ticks);
                let [flags, footer] = *take(2) else { continue };
                line.frame(&[&[0x0f][..], &packed, &[flags, footer]].concat(), pause);
            }
            3 => {
                let [address, packet_type, length] = *take(3) else { continue };
                let address = if address & 1 == 0 { 0xc8 } else { address };
                let packet_type = [0x16, 0x14, packet_type, packet_type][usize::from(address >> 1 & 3)];
                let payload = take(usize::from(length % 61));
                line.frame(&wire::crsf(address, packet_type, payload), pause);
            }
            4 => line.frame(&wire::crsf_channels(&[992; 16]), pause),
            _ => {
                let bytes = take(usize::from(kind >> 3));
                line.frame(bytes, pause);
            }
        }
    }
});
