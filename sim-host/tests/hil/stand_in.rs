//! A stand-in for a board: it serves the link with a real flight controller, as the firmware does, or with a fault.

use flight_core::FlightController;
use flight_core::esc::EscParams;
use flight_core::sample::{Health, Input};
use hil_link::{Decoder, Done, MAX_FRAME, Order, Received, Started, Step, ToBoard, ToHost, encode};

/// Behaviour of a board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Behaviour {
    /// Works correctly.
    Good,
    /// Ends after this many steps.
    DiesAfter(u32),
    /// Stops answering after this many steps, and sleeps.
    SilentAfter(u32),
    /// Stops answering after this many steps, and computes.
    BusyAfter(u32),
    /// Is reset by its watchdog after this many steps, and loses the step.
    ResetAfter(u32),
    /// Is reset at every step.
    ResetsAlways,
    /// Flips a bit in every n-th answer.
    Damages(u32),
    /// Sends every n-th answer twice.
    Repeats(u32),
    /// Does not send every n-th answer.
    Loses(u32),
    /// Sends every n-th answer after the following one.
    Delays(u32),
    /// Sends bytes that are no frame.
    SendsNoise,
    /// Refuses the configuration.
    Refuses,
    /// Uses version 9 of the link.
    OtherVersion,
    /// Sends a message of an unknown type.
    OtherMessages,
    /// Answers every step with the time of the previous one.
    WrongTime,
}

/// The board, without the wire.
pub struct Board {
    behaviour: Behaviour,
    decoder: Decoder,
    controller: Option<FlightController>,
    watchdog_reset: bool,
    sequence: Option<u32>,
    received: Received,
    steps: u32,
    delayed: Vec<u8>,
    /// Bytes sent, until the host reads them.
    pub sent: Vec<u8>,
    /// Whether the board has ended.
    pub dead: bool,
    /// Whether the host has ended the flight.
    pub ended: bool,
}

impl Board {
    /// Creates a board that has just been switched on.
    pub fn new(behaviour: Behaviour) -> Self {
        let mut board = Self {
            behaviour,
            decoder: Decoder::default(),
            controller: None,
            watchdog_reset: false,
            sequence: None,
            received: Received::default(),
            steps: 0,
            delayed: vec![],
            sent: vec![],
            dead: false,
            ended: false,
        };
        board.get_ready();
        board
    }

    /// Returns the number of steps.
    pub fn steps(&self) -> u32 {
        self.steps
    }

    fn get_ready(&mut self) {
        match self.behaviour {
            // The packet has version 9, a message of one byte, and the number 0.
            Behaviour::OtherVersion => self.sent.extend(encode_by_hand(&[9, 1, 0, 0, 0, 0, 0, 2])),
            Behaviour::SendsNoise => self.sent.extend([7; 100_000]),
            // Message type 200, which does not exist.
            Behaviour::OtherMessages => {
                self.sent.extend(encode_by_hand(&[hil_link::VERSION, 2, 0, 0, 0, 0, 0, 200, 1]))
            }
            _ => self.answer(&ToHost::Ready(Started { watchdog_reset: self.watchdog_reset })),
        }
    }

    fn reset(&mut self) {
        self.controller = None;
        self.watchdog_reset = true;
        (self.sequence, self.received) = (None, Received::default());
        self.get_ready();
    }

    /// Receives bytes from the host.
    pub fn receive_bytes(&mut self, bytes: &[u8]) {
        for byte in bytes {
            let Some(found) = self.decoder.push(*byte) else { continue };
            let found = found.ok().and_then(|packet| Some((packet.sequence, packet.message::<ToBoard>()?)));
            if !self.dead {
                self.receive(found);
            }
        }
    }

    fn receive(&mut self, found: Option<(u32, ToBoard)>) {
        let Some((sequence, message)) = found else {
            self.received.corrupt += 1;
            return self.answer(&ToHost::Bad(self.received));
        };
        match self.sequence.map_or(Order::Next, |last| Order::of(sequence, Some(last))) {
            Order::Next => {}
            Order::Lost(frames) => self.received.lost += frames,
            Order::Repeated => {
                self.received.repeated += 1;
                return self.answer(&ToHost::Bad(self.received));
            }
        }
        self.sequence = Some(sequence);
        match message {
            ToBoard::Start(_) if self.behaviour == Behaviour::Refuses => self.answer(&ToHost::Refused),
            ToBoard::Start(config) => {
                self.controller = FlightController::new(&config).ok();
                self.answer(&ToHost::Started);
            }
            ToBoard::Step(step) => self.step(&step),
            ToBoard::End => self.ended = true,
        }
    }

    fn step(&mut self, step: &Step) {
        let Some(controller) = &mut self.controller else { return self.get_ready() };
        self.steps += 1;
        let steps = self.steps;
        match self.behaviour {
            Behaviour::DiesAfter(n) if steps > n => return self.dead = true,
            Behaviour::SilentAfter(n) if steps > n => return,
            Behaviour::BusyAfter(n) if steps > n => while !std::hint::black_box(self.dead) {},
            Behaviour::ResetAfter(n) if steps == n + 1 => return self.reset(),
            Behaviour::ResetsAlways => return self.reset(),
            _ => {}
        }
        let Step { time_us, imu, mag, rc, battery } = *step;
        let health = Health { watchdog_reset: self.watchdog_reset, ..Health::default() };
        let output = controller.step(&Input { time_us, imu, mag, rc, battery, bench: None, health });
        let stop_us = EscParams::STANDARD.stop_us;
        let driven = output.permit.is_some();
        let done = Done {
            time_us: if self.behaviour == Behaviour::WrongTime {
                time_us.saturating_sub(1_000)
            } else {
                time_us
            },
            state: output.state,
            event: output.event,
            driven,
            pulses_us: output.permit.map_or([stop_us; 4], |permit| permit.apply(output.pulses_us, stop_us)),
            attitude: controller.attitude().to_array(),
            instructions: 1_000 + steps % 2,
            missed_deadlines: 0,
            received: self.received,
        };
        let before = self.sent.len();
        self.answer(&ToHost::Done(done));
        let is_turn = |every: u32| steps.is_multiple_of(every);
        match self.behaviour {
            Behaviour::Damages(n) if is_turn(n) => self.sent[before + 9] ^= 0x10,
            Behaviour::Repeats(n) if is_turn(n) => self.sent.extend_from_within(before..),
            Behaviour::Loses(n) if is_turn(n) => self.sent.truncate(before),
            Behaviour::Delays(n) if is_turn(n) => self.delayed = self.sent.split_off(before),
            _ => self.sent.append(&mut self.delayed),
        }
    }

    fn answer(&mut self, message: &ToHost) {
        let mut frame = [0; MAX_FRAME];
        let length = encode(self.sequence.unwrap_or(0), message, &mut frame).unwrap();
        self.sent.extend(&frame[..length]);
    }
}

/// Encodes a packet as a frame, with an implementation of CRC and COBS that is independent of `hil-link`.
fn encode_by_hand(packet: &[u8]) -> Vec<u8> {
    let crc = !packet.iter().fold(u32::MAX, |crc, byte| {
        let shift = |crc: u32| if crc & 1 != 0 { crc >> 1 ^ 0xedb8_8320 } else { crc >> 1 };
        (0..8).fold(crc ^ u32::from(*byte), |crc, _| shift(crc))
    });
    let with_crc = [packet, &crc.to_le_bytes()].concat();
    let blocks =
        with_crc.split(|byte| *byte == 0).flat_map(|block| [&[block.len() as u8 + 1], block].concat());
    blocks.chain([0]).collect()
}
