//! The RC receiver at its serial port: it sends the bytes of its frames, each at its time.
//!
//! | | CRSF | SBUS |
//! |---|---|---|
//! | line | 420,000 baud, 8N1 | 100,000 baud, 8E2 |
//! | channels | 26 bytes: address 0xC8, length, type 0x16, 16 × 11 bits, CRC-8 (0xD5) | 25 bytes: 0x0F, 16 × 11 bits, flags, 0x00 |
//! | lost link | no frames | the failsafe flag |
//!
//! Sources: TBS, "CRSF specification" (`tbs-crsf-spec`), and Bolder Flight's description of SBUS. The firmware decodes with
//! third-party crates; these encoders share no code with them.

use std::collections::VecDeque;

use clap::ValueEnum;
use flight_core::rc::ChannelMap;
use flight_core::sample::{LinkStatus, RcFrame};
use rigless::chip::Timeline;
use rigless::chip::uart::Peer;
use rigless::snapshot::store;
use rigless::time::VirtualNanos;

/// Protocol of the receiver.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, serde::Serialize, serde::Deserialize)]
pub enum Protocol {
    /// CRSF: TBS Crossfire and ExpressLRS.
    Crsf,
    /// SBUS: Futaba and FrSky, through the board's inverter.
    Sbus,
}

/// Settings of a serial port.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Line {
    /// Baud rate, bits a second.
    pub baud: u32,
    /// Even parity if true, no parity if false.
    pub parity: bool,
    /// Number of stop bits, 1 or 2.
    pub stop_bits: u8,
}

impl Protocol {
    /// Returns the settings of the line.
    pub const fn line(self) -> Line {
        match self {
            Self::Crsf => Line { baud: 420_000, parity: false, stop_bits: 1 },
            Self::Sbus => Line { baud: 100_000, parity: true, stop_bits: 2 },
        }
    }

    /// Returns the time of a byte with its start, parity and stop bits, ns.
    const fn byte_ns(self) -> u64 {
        let line = self.line();
        let bits = 9 + line.parity as u64 + line.stop_bits as u64;
        bits * 1_000_000_000 / line.baud as u64
    }

    /// Returns the bytes of a frame; `None` if the receiver sends nothing.
    fn frame(self, rc: &RcFrame, map: &ChannelMap) -> Option<Vec<u8>> {
        // Unused channels are centred.
        let mut channels = [992_u16; 16];
        for (ticks, channel) in rc.channels.into_iter().zip(map.sticks) {
            channels[usize::from(channel)] = ticks;
        }
        channels[usize::from(map.arm)] = rc.arm_switch;
        channels[usize::from(map.mode)] = rc.mode_switch;
        let packed = pack(&channels);
        match self {
            Self::Crsf => {
                // ExpressLRS and Crossfire send nothing while the link is lost.
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

/// Packs sixteen channels of 11 bits, the first in the lowest bits.
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

/// Returns the CRC-8/DVB-S2.
fn crc8(bytes: &[u8]) -> u8 {
    bytes.iter().fold(0, |crc, byte| {
        (0..8).fold(crc ^ byte, |crc, _| if crc & 0x80 != 0 { crc << 1 ^ 0xd5 } else { crc << 1 })
    })
}

/// The receiver.
#[derive(Debug, serde::Serialize, serde::Deserialize)]
pub struct RcReceiver {
    /// Protocol.
    pub protocol: Protocol,
    /// Bytes to send, each with its start time, ns.
    bytes: VecDeque<(u64, u8)>,
}

store!(RcReceiver);

impl RcReceiver {
    /// Returns a receiver without bytes to send.
    pub fn new(protocol: Protocol) -> Self {
        Self { protocol, bytes: VecDeque::new() }
    }

    /// Sends a frame from `at_ns` on, after all earlier bytes.
    pub fn send(&mut self, rc: &RcFrame, map: &ChannelMap, at_ns: u64) {
        if let Some(frame) = self.protocol.frame(rc, map) {
            self.send_bytes(frame, at_ns);
        }
    }

    /// Sends bytes from `at_ns` on, after all earlier bytes.
    pub fn send_bytes(&mut self, bytes: impl IntoIterator<Item = u8>, at_ns: u64) {
        let period = self.protocol.byte_ns();
        let free = self.bytes.back().map_or(0, |(at, _)| at + period);
        let start = at_ns.max(free);
        self.bytes.extend(bytes.into_iter().zip(0..).map(|(byte, n)| (start + n * period, byte)));
    }

    /// Returns the start time of the first byte after `now_ns`, ns.
    pub fn next_byte_ns(&self, now_ns: u64) -> Option<u64> {
        self.bytes.iter().map(|(at, _)| *at).find(|at| *at > now_ns)
    }

    /// Returns whether all bytes are sent.
    pub fn is_idle(&self) -> bool {
        self.bytes.is_empty()
    }

    /// Drops bytes that began before `now_ns` and were not received.
    pub fn drop_before(&mut self, now_ns: u64) {
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
        // A byte whose time has passed while the port did not receive is lost.
        (now.0 - at < self.protocol.byte_ns()).then_some(u16::from(byte)).or_else(|| self.transmit(now))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The check value of CRC-8/DVB-S2: "123456789" gives 0xBC.
    #[test]
    fn crc_is_dvb_s2() {
        assert_eq!(crc8(b"123456789"), 0xbc);
    }

    /// The firmware's third-party decoders decode the encoded frames.
    #[test]
    fn firmware_decoders_read_the_encoded_frames() {
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
            // An earlier byte makes a pause before the frame, which SBUS requires.
            assert_eq!(receiver.push(0, 0), None);
            let bytes = protocol.frame(&rc, &map).expect("a live link sends");
            let frames: Vec<_> = bytes.into_iter().filter_map(|byte| receiver.push(byte, 10_000)).collect();
            assert_eq!(frames.len(), 1, "{protocol:?}");
            assert_eq!(frames[0].to_rc(&map), rc, "{protocol:?}");
        }
    }
}
