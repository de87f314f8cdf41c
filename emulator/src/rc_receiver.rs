//! The receiver receiver at its serial port: frames as bytes, each at its time.
//!
//! | | CRSF | SBUS |
//! |---|---|---|
//! | line | 420,000 baud, 8N1 | 100,000 baud, 8E2 |
//! | channels | 26 bytes: address 0xC8, length, type 0x16, 16 × 11 bits, CRC-8 (0xD5) | 25 bytes: 0x0F, 16 × 11 bits, flags, 0x00 |
//! | link lost | no frames | the failsafe flag |
//!
//! Sources: TBS, "CRSF specification" (`tbs-crsf-spec`), and Bolder Flight's description of SBUS. The firmware's
//! decoders are other people's crates, and these encoders share nothing with them.

use std::collections::VecDeque;

use clap::ValueEnum;
use flight_core::rc::ChannelMap;
use flight_core::sample::{LinkStatus, RcFrame};
use rigless::chip::Timeline;
use rigless::chip::uart::Peer;
use rigless::snapshot::store;
use rigless::time::VirtualNanos;

/// What the receiver speaks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, serde::Serialize, serde::Deserialize)]
pub enum Protocol {
    /// TBS Crossfire and ExpressLRS.
    Crsf,
    /// Futaba and FrSky, behind the board's inverter.
    Sbus,
}

/// Settings of a serial port.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Line {
    /// Bits a second.
    pub baud: u32,
    /// Even parity.
    pub parity: bool,
    /// One or two.
    pub stop_bits: u8,
}

impl Protocol {
    /// Its line.
    pub const fn line(self) -> Line {
        match self {
            Self::Crsf => Line { baud: 420_000, parity: false, stop_bits: 1 },
            Self::Sbus => Line { baud: 100_000, parity: true, stop_bits: 2 },
        }
    }

    /// Time from the start of one byte to the next, ns.
    const fn byte_ns(self) -> u64 {
        let line = self.line();
        let bits = 9 + line.parity as u64 + line.stop_bits as u64;
        bits * 1_000_000_000 / line.baud as u64
    }

    /// The bytes of a frame; `None` where the receiver is silent.
    fn frame(self, rc: &RcFrame, map: &ChannelMap) -> Option<Vec<u8>> {
        // What the pilot does not move is centred.
        let mut channels = [992_u16; 16];
        for (ticks, channel) in rc.channels.into_iter().zip(map.sticks) {
            channels[usize::from(channel)] = ticks;
        }
        channels[usize::from(map.arm)] = rc.arm_switch;
        channels[usize::from(map.mode)] = rc.mode_switch;
        let packed = pack(&channels);
        match self {
            Self::Crsf => {
                // ExpressLRS and Crossfire send nothing while the link is down.
                if rc.status != LinkStatus::Good {
                    return None;
                }
                let mut checked = vec![0x16];
                checked.extend(packed);
                let mut frame = vec![0xc8, checked.len() as u8 + 1];
                frame.extend(&checked);
                frame.push(crc8(&checked));
                Some(frame)
            }
            Self::Sbus => {
                let flags = match rc.status {
                    LinkStatus::Good => 0,
                    LinkStatus::FrameLost => 0x04,
                    LinkStatus::Failsafe => 0x0c,
                };
                let mut frame = vec![0x0f];
                frame.extend(packed);
                frame.extend([flags, 0x00]);
                Some(frame)
            }
        }
    }
}

/// Sixteen channels of 11 bits, the first in the lowest bits.
fn pack(channels: &[u16; 16]) -> [u8; 22] {
    let mut bytes = [0; 22];
    for (n, ticks) in channels.iter().enumerate() {
        for bit in 0..11 {
            let at = 11 * n + bit;
            bytes[at / 8] |= ((ticks >> bit & 1) as u8) << (at % 8);
        }
    }
    bytes
}

fn crc8(bytes: &[u8]) -> u8 {
    bytes.iter().fold(0, |crc, byte| {
        (0..8).fold(crc ^ byte, |crc, _| if crc & 0x80 != 0 { crc << 1 ^ 0xd5 } else { crc << 1 })
    })
}

/// The receiver.
#[derive(Debug, serde::Serialize, serde::Deserialize)]
pub struct RcReceiver {
    /// What it speaks.
    pub protocol: Protocol,
    /// Bytes on their way, and when each begins, ns.
    bytes: VecDeque<(u64, u8)>,
}

store!(RcReceiver);

impl RcReceiver {
    /// A receiver that has said nothing yet.
    pub fn new(protocol: Protocol) -> Self {
        Self { protocol, bytes: VecDeque::new() }
    }

    /// Sends a frame from `at_ns` on, after what is still on its way.
    pub fn send(&mut self, rc: &RcFrame, map: &ChannelMap, at_ns: u64) {
        if let Some(frame) = self.protocol.frame(rc, map) {
            self.send_bytes(frame, at_ns);
        }
    }

    /// Sends bytes from `at_ns` on, after what is still on its way.
    pub fn send_bytes(&mut self, bytes: impl IntoIterator<Item = u8>, at_ns: u64) {
        let period = self.protocol.byte_ns();
        let free = self.bytes.back().map_or(0, |(at, _)| at + period);
        let start = at_ns.max(free);
        self.bytes.extend(bytes.into_iter().zip(0..).map(|(byte, n)| (start + n * period, byte)));
    }

    /// When the first byte after `now_ns` begins, ns.
    pub fn next_byte_ns(&self, now_ns: u64) -> Option<u64> {
        self.bytes.iter().map(|(at, _)| *at).find(|at| *at > now_ns)
    }

    /// Whether all bytes are sent.
    pub fn is_idle(&self) -> bool {
        self.bytes.is_empty()
    }

    /// Forgets what began before `now_ns`, and nobody has listened to.
    pub fn forget_before(&mut self, now_ns: u64) {
        self.bytes.retain(|(at, _)| *at >= now_ns);
    }
}

impl Peer for RcReceiver {
    fn receive(&mut self, _: u16, _: &mut Timeline<'_, '_>) {}

    fn transmit(&mut self, now: VirtualNanos) -> Option<u16> {
        let (at, byte) = *self.bytes.front()?;
        if at > now.0 {
            return None;
        }
        self.bytes.pop_front();
        // One whose time has passed while nobody listened is gone.
        (now.0 - at < self.protocol.byte_ns()).then_some(u16::from(byte)).or_else(|| self.transmit(now))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// TBS's example of the checksum's polynomial: CRC-8/DVB-S2 of "123456789" is 0xBC.
    #[test]
    fn crc_is_dvb_s2() {
        assert_eq!(crc8(b"123456789"), 0xbc);
    }

    /// What other people's decoders, those of the firmware, read from these frames.
    #[test]
    fn frames_are_read_back_by_the_firmwares_decoders() {
        let rc = RcFrame {
            channels: [172, 1_811, 992, 1_000],
            arm_switch: 1_792,
            mode_switch: 191,
            status: LinkStatus::Good,
        };
        let map = ChannelMap::AETR;
        for (protocol, theirs) in
            [(Protocol::Crsf, receiver::Protocol::Crsf), (Protocol::Sbus, receiver::Protocol::Sbus)]
        {
            let mut receiver = receiver::Receiver::new(theirs);
            // A byte long ago, so that the frame begins behind a pause: SBUS is not read without one.
            assert_eq!(receiver.push(0, 0), None);
            let bytes = protocol.frame(&rc, &map).expect("a live link sends");
            let frames: Vec<_> = bytes.into_iter().filter_map(|byte| receiver.push(byte, 10_000)).collect();
            assert_eq!(frames.len(), 1, "{protocol:?}");
            assert_eq!(frames[0].to_rc(&map), rc, "{protocol:?}");
        }
    }
}
