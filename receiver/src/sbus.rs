//! Decoder for SBUS, a protocol of 25 bytes after a pause.
//!
//! ```text
//!  0x0F │ 22 bytes: 16 channels of 11 bits │ 0000 failsafe lost ch18 ch17 │ 0x00, SBUS2: 0x04 0x14 0x24 0x34
//! ```
//! The 25 bytes after a pause are a frame if the header (1 value of 256), the upper half of the flags (1 of 16) and
//! the footer (5 of 256) are valid. Of random bursts, 1 in 210,000 is valid. The channel values are not checked:
//! transmitters with extended end points use the whole range, and receivers fill unused channels with any value.

use uf_sbus::{SbusPacket, SbusParser};

use crate::{Counts, Frame, increment};

const HEADER: u8 = 0x0f;

#[derive(Debug)]
pub struct Decoder {
    parser: SbusParser,
    sync: Sync,
}

/// Position in the stream of frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Sync {
    AfterPause,
    InFrame,
    AfterFrame,
    /// Unknown position: all bytes are ignored until the next pause.
    Lost,
}

impl Decoder {
    pub fn new() -> Self {
        Self { parser: SbusParser::new(), sync: Sync::Lost }
    }

    pub fn push(&mut self, byte: u8, counts: &mut Counts) -> Option<Frame> {
        match self.sync {
            Sync::AfterPause if byte == HEADER => self.sync = Sync::InFrame,
            Sync::InFrame => {}
            Sync::AfterPause | Sync::AfterFrame => {
                self.lose_sync(counts);
                return None;
            }
            Sync::Lost => return None,
        }
        match self.parser.push_byte(byte)? {
            Ok(SbusPacket { channels, failsafe, frame_lost, .. }) => {
                self.sync = Sync::AfterFrame;
                Some(Frame { channels, failsafe, frame_lost, link_quality: None })
            }
            Err(_) => {
                increment(&mut counts.bad);
                self.lose_sync(counts);
                None
            }
        }
    }

    pub fn pause(&mut self, counts: &mut Counts) {
        if self.sync == Sync::InFrame {
            increment(&mut counts.bad);
        }
        self.parser.reset();
        self.sync = Sync::AfterPause;
    }

    pub fn line_error(&mut self, counts: &mut Counts) {
        if self.sync != Sync::Lost {
            increment(&mut counts.bad);
            self.lose_sync(counts);
        }
    }

    fn lose_sync(&mut self, counts: &mut Counts) {
        increment(&mut counts.resyncs);
        self.sync = Sync::Lost;
    }
}
