//! SBUS: 25 bytes behind a pause.
//!
//! ```text
//!  0x0F │ 22 bytes: 16 channels of 11 bits │ 0000 failsafe lost ch18 ch17 │ 0x00, SBUS2: 0x04 0x14 0x24 0x34
//! ```
//! What begins behind a pause is a frame if its header (1 of 256), the upper half of its flags (1 of 16) and
//! its footer (5 of 256) fit: of random bursts, 1 of 210,000. The channels are taken as they are: transmitters
//! with extended end points send the whole range, and receivers fill unused channels with anything.

use uf_sbus::{SbusPacket, SbusParser};

use crate::{Counts, Frame, count};

const HEADER: u8 = 0x0f;

#[derive(Debug)]
pub struct Decoder {
    parser: SbusParser,
    place: Place,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Place {
    /// Behind a pause.
    Start,
    Inside,
    /// Behind a frame.
    End,
    /// Anywhere: nothing counts until the next pause.
    Lost,
}

impl Decoder {
    pub fn new() -> Self {
        Self { parser: SbusParser::new(), place: Place::Lost }
    }

    pub fn push(&mut self, byte: u8, counts: &mut Counts) -> Option<Frame> {
        match self.place {
            Place::Start if byte == HEADER => self.place = Place::Inside,
            Place::Inside => {}
            Place::Start | Place::End => {
                self.lose(counts);
                return None;
            }
            Place::Lost => return None,
        }
        match self.parser.push_byte(byte)? {
            Ok(SbusPacket { channels, failsafe, frame_lost, .. }) => {
                self.place = Place::End;
                Some(Frame { channels, failsafe, frame_lost, link_quality: None })
            }
            Err(_) => {
                count(&mut counts.bad);
                self.lose(counts);
                None
            }
        }
    }

    pub fn pause(&mut self, counts: &mut Counts) {
        if self.place == Place::Inside {
            count(&mut counts.bad);
        }
        self.parser.reset();
        self.place = Place::Start;
    }

    pub fn line_error(&mut self, counts: &mut Counts) {
        if self.place != Place::Lost {
            count(&mut counts.bad);
            self.lose(counts);
        }
    }

    fn lose(&mut self, counts: &mut Counts) {
        count(&mut counts.resyncs);
        self.place = Place::Lost;
    }
}
