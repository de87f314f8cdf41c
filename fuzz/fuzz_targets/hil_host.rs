//! Fuzzes `sim-host hil` with arbitrary answers of the firmware: the other end of the link is the input.
//!
//! For any answers the flight ends, its outcome is within its bounds, and the report counts no more than there was.
#![no_main]

use std::collections::VecDeque;
use std::io::{self, Read, Write};
use std::sync::Arc;
use std::sync::LazyLock;
use std::sync::atomic::AtomicBool;

use flight_core::ArmState;
use hil_link::{Decoder, Done, MAX_FRAME, Received, Started, Step, ToBoard, ToHost, encode};
use libfuzzer_sys::fuzz_target;
use sim_host::hil::{self, Faults, OnTimeout, Wire};
use sim_host::scene::Scene;

static SCENE: LazyLock<Scene> = LazyLock::new(|| Scene::load("hover").expect("a built-in scene"));

/// A source of bytes, followed by endless zeros.
struct Bytes<'a>(&'a [u8]);

impl Bytes<'_> {
    fn u8(&mut self) -> u8 {
        let Some((first, rest)) = self.0.split_first() else { return 0 };
        self.0 = rest;
        *first
    }

    fn u32(&mut self) -> u32 {
        u32::from_le_bytes([(); 4].map(|()| self.u8()))
    }

    fn f32(&mut self) -> f32 {
        f32::from_bits(self.u32())
    }
}

/// The firmware at the other end of the wire.
struct Firmware<'a> {
    script: Bytes<'a>,
    decoder: Decoder,
    /// Sequence number of the last request, and the time of the last step, µs.
    last_request: (u32, u64),
    answer: VecDeque<u8>,
}

impl Firmware<'_> {
    fn received(&mut self) -> Received {
        Received { corrupt: self.script.u32(), lost: self.script.u32(), repeated: self.script.u32() }
    }

    fn done(&mut self) -> Done {
        let kind = self.script.u8();
        // Most messages are what a firmware answers; some are anything.
        let mut number = |usual: f32| if kind & 1 == 0 { usual } else { self.script.f32() };
        let (pulses_us, attitude) = ([(); 4].map(|()| number(1_400.0)), [1.0, 0.0, 0.0, 0.0].map(number));
        Done {
            time_us: if kind & 2 == 0 { self.last_request.1 } else { u64::from(self.script.u32()) },
            state: if kind & 4 == 0 { ArmState::Armed } else { ArmState::Disarmed },
            event: None,
            driven: kind & 8 == 0,
            pulses_us,
            attitude,
            instructions: if kind & 16 == 0 { 1_900 } else { self.script.u32() },
            missed_deadlines: if kind & 32 == 0 { 0 } else { self.script.u32() },
            received: if kind & 64 == 0 { Received::default() } else { self.received() },
        }
    }

    /// Queues the next answer. Returns `false` at the end of the script.
    fn queue_answer(&mut self) -> bool {
        if self.script.0.is_empty() {
            return false;
        }
        let kind = self.script.u8();
        let number = if kind & 0x80 == 0 { self.last_request.0 } else { self.script.u32() };
        let message = match kind % 8 {
            0 => ToHost::Ready(Started { watchdog_reset: kind & 0x40 != 0 }),
            1 => ToHost::Started,
            2 => ToHost::Refused,
            3 => ToHost::Bad(self.received()),
            4 => {
                // Bytes that are not a frame.
                let length = usize::from(self.script.u8()).min(self.script.0.len());
                let (bytes, rest) = self.script.0.split_at(length);
                self.answer.extend(bytes);
                self.script.0 = rest;
                return true;
            }
            _ => ToHost::Done(self.done()),
        };
        let mut frame = [0; MAX_FRAME];
        let length = encode(number, &message, &mut frame).expect("every message fits into a frame");
        self.answer.extend(&frame[..length]);
        true
    }
}

impl Read for Firmware<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.answer.is_empty() && self.script.0.first().is_some_and(|kind| kind % 16 == 15) {
            self.script.u8();
            return Err(io::ErrorKind::WouldBlock.into());
        }
        while self.answer.is_empty() && self.queue_answer() {}
        self.answer.read(buffer)
    }
}

impl Write for Firmware<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        for byte in bytes {
            let Some(found) = self.decoder.push(*byte) else { continue };
            // Bits are flipped on the link; a frame that is still valid holds a message.
            let Ok(packet) = found else { continue };
            self.last_request.0 = packet.sequence;
            match packet.message().expect("sim-host sends messages") {
                ToBoard::Step(Step { time_us, .. }) => self.last_request.1 = time_us,
                ToBoard::Start(config) => assert!(config == SCENE.config),
                ToBoard::End => {}
            }
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Wire for Firmware<'_> {
    fn on_timeout(&mut self) -> OnTimeout {
        if self.script.u8() & 1 == 0 { OnTimeout::NextFrame } else { OnTimeout::Wait }
    }
}

fuzz_target!(|data: &[u8]| {
    let mut script = Bytes(data);
    let faults = Faults {
        flip_bit_every: u32::from(script.u8()).try_into().ok(),
        dropped_us: 20_000..20_000 + 1_000 * u64::from(script.u8() % 16),
    };
    let mut firmware =
        Firmware { script, decoder: Decoder::default(), last_request: (0, 0), answer: VecDeque::new() };
    let stop = Arc::new(AtomicBool::new(false));
    let hil::Flown { outcome, report, ended } =
        hil::fly(&mut firmware, &SCENE, SCENE.seed, faults, stop, &mut ());
    assert!(ended.is_err() || outcome.crash.is_some(), "a flight of 30 s from {} bytes", data.len());
    assert!(report.unanswered <= report.frames + report.resets.len() as u64, "{report:?}");
    assert!(report.counted <= report.frames, "{report:?}");
    if let Err(error) = ended {
        assert!(!error.to_string().contains('\n'));
    }
});
