//! The sending side of the receiver's wire: an independent encoder of both protocols, bit by bit, and the byte times.

use receiver::{Frame, Protocol, Receiver};

/// Packs 16 channels of 11 bits, lowest bit first.
pub fn pack(channels: &[u16; 16]) -> [u8; 22] {
    let mut packed = [0; 22];
    for bit in 0..176 {
        packed[bit / 8] |= ((channels[bit / 11] >> (bit % 11) & 1) as u8) << (bit % 8);
    }
    packed
}

pub fn sbus(channels: &[u16; 16], flags: u8, footer: u8) -> Vec<u8> {
    [&[0x0f][..], &pack(channels), &[flags, footer]].concat()
}

/// CRC-8/DVB-S2: polynomial 0xD5, initial value 0, highest bit first.
pub fn crc(bytes: &[u8]) -> u8 {
    bytes.iter().fold(0, |crc, byte| {
        (0..8).fold(crc ^ byte, |crc: u8, _| crc << 1 ^ if crc & 0x80 != 0 { 0xd5 } else { 0 })
    })
}

pub fn crsf(address: u8, packet_type: u8, payload: &[u8]) -> Vec<u8> {
    let body = [&[packet_type], payload].concat();
    [&[address, body.len() as u8 + 1], &body[..], &[crc(&body)]].concat()
}

pub fn crsf_channels(channels: &[u16; 16]) -> Vec<u8> {
    crsf(0xc8, 0x16, &pack(channels))
}

/// Returns a frame of link statistics with this uplink quality, %.
pub fn crsf_quality(percent: u8) -> Vec<u8> {
    crsf(0xc8, 0x14, &[60, 70, percent, 10, 0, 2, 3, 80, 99, 9])
}

/// Returns a frame of channels in the given protocol.
pub fn channels(protocol: Protocol, channels: &[u16; 16]) -> Vec<u8> {
    match protocol {
        Protocol::Sbus => sbus(channels, 0, 0),
        Protocol::Crsf => crsf_channels(channels),
    }
}

pub const BOTH: [Protocol; 2] = [Protocol::Sbus, Protocol::Crsf];

/// Returns when the `n`th of consecutive bytes has been received, µs after the start of the first one.
pub fn received_us(protocol: Protocol, n: usize) -> u64 {
    let line = protocol.line();
    let bits = 1 + 8 + u64::from(line.even_parity) + u64::from(line.stop_bits);
    (n as u64 + 1) * bits * 1_000_000 / u64::from(line.baud)
}

/// Pushes consecutive `bytes`, the first of which starts at `start_us`, and returns the frames received.
pub fn send(receiver: &mut Receiver, protocol: Protocol, start_us: u64, bytes: &[u8]) -> Vec<Frame> {
    let times = (0..).map(|n| start_us + received_us(protocol, n));
    bytes.iter().zip(times).filter_map(|(byte, time_us)| receiver.push(*byte, time_us)).collect()
}

/// Returns a receiver whose last byte is long ago, so that it expects the start of a frame.
pub fn listening(protocol: Protocol) -> Receiver {
    let mut receiver = Receiver::new(protocol);
    receiver.push(0, 0);
    receiver
}

/// SplitMix64 (Steele, Lea and Flood, 2014).
pub struct Random(pub u64);

impl Random {
    pub fn word(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ self.0 >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ z >> 31
    }

    pub fn below(&mut self, end: u64) -> u64 {
        self.word() % end
    }

    pub fn byte(&mut self) -> u8 {
        self.word() as u8
    }

    pub fn channels(&mut self) -> [u16; 16] {
        std::array::from_fn(|_| self.below(2_048) as u16)
    }
}
