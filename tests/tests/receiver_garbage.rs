//! Garbage at the receiver's port, from the bytes to the motors: it never arms and never panics, and the pilot is in
//! control again within the stated time.

use flight_core::ArmState;
use flight_core::rc::link::RC_BACK_US;
use flight_core::rc::{CENTRE_TICKS, ChannelMap, HIGH_TICKS, LOW_TICKS};
use receiver::{Protocol, RECOVERY_FRAMES, Receiver};
use test_support::still_vehicle::{StillVehicle, config};
use test_support::wire::{self, BOTH, Random, received_us};

/// Period of valid frames, µs.
const FRAME_US: u64 = 14_000;

/// A receiver's port, and the flight controller behind it.
struct Port {
    receiver: Receiver,
    vehicle: StillVehicle,
    /// Time up to which bytes have been sent, µs.
    sent_us: u64,
    stepped_ms: u64,
    channels: ChannelMap,
}

impl Port {
    fn new(protocol: Protocol) -> Self {
        Self {
            receiver: Receiver::new(protocol),
            vehicle: StillVehicle::new(&config()),
            sent_us: 0,
            stepped_ms: 0,
            channels: ChannelMap::AETR,
        }
    }

    /// Sends bytes, each `spacing_us` after the last, and steps the flight controller each millisecond.
    fn send(&mut self, bytes: &[u8], spacing_us: u64) {
        for byte in bytes {
            self.sent_us += spacing_us;
            if let Some(frame) = self.receiver.push(*byte, self.sent_us) {
                let frame = frame.to_rc(&self.channels);
                self.vehicle.step(Some(frame));
                self.stepped_ms += 1;
            }
            self.step();
        }
    }

    /// Waits without bytes.
    fn wait(&mut self, us: u64) {
        self.sent_us += us;
        self.step();
    }

    fn step(&mut self) {
        while self.stepped_ms * 1_000 < self.sent_us {
            self.vehicle.step(None);
            self.stepped_ms += 1;
        }
    }

    /// Sends valid frames until `done`, at most 300. Returns how long it took, µs.
    fn send_frames_until(
        &mut self,
        protocol: Protocol,
        channels: [u16; 16],
        done: impl Fn(&StillVehicle) -> bool,
    ) -> Option<u64> {
        let began_us = self.sent_us;
        let frame = wire::channels(protocol, &channels);
        for _ in 0..300 {
            let next_us = self.sent_us + FRAME_US;
            self.send(&frame, received_us(protocol, 0));
            self.wait(next_us.saturating_sub(self.sent_us));
            if done(&self.vehicle) {
                return Some(self.sent_us - began_us);
            }
        }
        None
    }
}

/// Returns channels in a transmitter's order: throttle low, yaw as given, arm switch on.
fn held(yaw: u16) -> [u16; 16] {
    let mut channels = [CENTRE_TICKS; 16];
    (channels[2], channels[3], channels[4]) = (LOW_TICKS, yaw, HIGH_TICKS);
    channels
}

/// Longest time from the first valid frame of the arm gesture until the vehicle is armed, µs. It is the sum of:
/// - the frames that may be lost until the decoder is synchronised,
/// - 0.5 s with valid frames, after which the link counts as back,
/// - 1 s for which the pilot holds the gesture,
/// - 0.5 s for the checks before arming,
/// - one frame, because time is counted from frame to frame.
const TO_ARMED_US: u64 = (RECOVERY_FRAMES as u64 + 1) * FRAME_US + RC_BACK_US as u64 + 1_000_000 + 500_000;

#[test]
fn random_bytes_never_arm_and_the_link_recovers_after_them() {
    for protocol in BOTH {
        for spacing_us in [0, received_us(protocol, 0), 900] {
            let mut port = Port::new(protocol);
            let mut random = Random(11);
            port.wait(2_000_000);
            for _ in 0..1_000 {
                let bytes: Vec<u8> = (0..1_000).map(|_| random.byte()).collect();
                port.send(&bytes, spacing_us);
                // A pause as between frames.
                port.wait(4_000);
            }
            assert!(!port.vehicle.turned, "{protocol:?}: {:?}", port.vehicle.events);
            let took = port.send_frames_until(protocol, held(HIGH_TICKS), |v| v.state() == ArmState::Armed);
            let took = took.unwrap_or_else(|| panic!("{protocol:?}: the link does not recover"));
            println!(
                "{protocol:?}, a byte every {spacing_us} µs: armed {took} µs after the first valid frame"
            );
            assert!(took <= TO_ARMED_US, "{protocol:?}: {took} µs, bound {TO_ARMED_US} µs");
        }
    }
}

#[test]
fn valid_frames_with_random_channels_never_arm() {
    // Send valid frames with random channels, one after the other, for ten minutes.
    for protocol in BOTH {
        let mut port = Port::new(protocol);
        let mut random = Random(5);
        for _ in 0..43_000 {
            let channels = std::array::from_fn(|_| (random.word() % 2_048) as u16);
            port.send(&wire::channels(protocol, &channels), received_us(protocol, 0));
            port.wait(10_000);
        }
        assert!(!port.vehicle.turned, "{protocol:?}: {:?}", port.vehicle.events);
    }
}

#[test]
fn broken_frames_between_good_ones_keep_the_link() {
    for protocol in BOTH {
        let mut port = Port::new(protocol);
        let mut random = Random(23);
        port.send_frames_until(protocol, held(CENTRE_TICKS), |_| false);
        assert!(
            port.send_frames_until(protocol, held(HIGH_TICKS), |v| v.state() == ArmState::Armed).is_some()
        );
        // Every other frame is truncated, has a flipped bit, or is spliced from two.
        let good = wire::channels(protocol, &held(CENTRE_TICKS));
        for n in 0..3_000 {
            let mut frame = good.clone();
            match n % 3 {
                0 => frame.truncate(1 + random.word() as usize % (good.len() - 1)),
                1 if protocol == Protocol::Crsf => {
                    let bit = random.word() as usize % (8 * good.len());
                    frame[bit / 8] ^= 1 << (bit % 8);
                }
                // SBUS has no checksum: a flipped bit of a channel only moves a stick for one frame.
                1 => frame[0] ^= 1 << (n % 8),
                _ => frame = [&good[..good.len() / 2], &good[..]].concat(),
            }
            for bytes in [frame, good.clone()] {
                port.send(&bytes, received_us(protocol, 0));
                port.wait(7_000);
            }
        }
        assert_eq!(port.vehicle.state(), ArmState::Armed, "{protocol:?}: {:?}", port.vehicle.events);
    }
}
