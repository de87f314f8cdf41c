//! The parts of the firmware that need no board: the extension of the microsecond counter, and the search for
//! the receiver's protocol.

#[path = "../../firmware/src/clock.rs"]
mod clock;
#[path = "../../firmware/src/pilot.rs"]
mod pilot;
#[allow(dead_code)] // the other end of the receiver's wire, of which only the frames are needed here
#[path = "../../receiver/tests/decoding/wire.rs"]
mod wire;

use flight_core::rc::ChannelMap;
use flight_core::sample::{LinkStatus, RcFrame};
use pilot::{Heard, Pilot};
use receiver::Protocol;

#[test]
fn the_clock_goes_on_where_its_counter_wraps() {
    let mut clock = clock::Clock::new();
    assert_eq!(clock.at(5), 5);
    assert_eq!(clock.at(5), 5);
    let mut count = 5_u32;
    let mut expected = 5_u64;
    for _ in 0..100 {
        // Half an hour each: over the wrap at 71 minutes.
        count = count.wrapping_add(1_800_000_000);
        expected += 1_800_000_000;
        assert_eq!(clock.at(count), expected);
        // A reading that was taken earlier, and asked for later.
        assert_eq!(clock.at(count.wrapping_sub(40)), expected - 40);
        assert_eq!(clock.at(count), expected);
    }
}

/// A port with a receiver at its other end, which sends a frame every 10 ms and knows nothing of the port's settings.
struct Wire {
    pilot: Pilot,
    listens_for: Protocol,
    now_us: u64,
}

impl Wire {
    fn new() -> Self {
        Self { pilot: Pilot::new(ChannelMap::AETR), listens_for: Pilot::FIRST, now_us: 0 }
    }

    /// Ten milliseconds: the receiver sends `bytes`, in `speaks`.
    fn pass(&mut self, speaks: Protocol, bytes: &[u8]) -> Option<RcFrame> {
        let mut last = None;
        for (n, byte) in bytes.iter().enumerate() {
            let heard = if self.listens_for == speaks { Heard::Byte(*byte) } else { Heard::Damaged };
            let frame = self.pilot.hear(heard, self.now_us + wire::received_us(speaks, n));
            last = frame.or(last);
        }
        self.now_us += 10_000;
        if let Some(line) = self.pilot.search(self.now_us) {
            self.listens_for = wire::BOTH.into_iter().find(|protocol| protocol.line() == line).unwrap();
        }
        last
    }
}

#[test]
fn the_receivers_protocol_is_found_and_kept() {
    let mut channels = [992; 16];
    channels[2] = 300;
    for speaks in wire::BOTH {
        let bytes = wire::channels(speaks, &channels);
        let mut wire = Wire::new();
        let first = (0..150).find_map(|_| wire.pass(speaks, &bytes)).expect("found within 1.5 s");
        assert_eq!(first, ChannelMap::AETR.frame(&channels, LinkStatus::Good));
        assert_eq!(wire.pilot.found(), Some(speaks));

        // A minute of silence: the port goes on listening for the same, and hears the first frame that comes.
        for _ in 0..6_000 {
            assert_eq!(wire.pass(speaks, &[]), None);
        }
        assert_eq!(wire.pass(speaks, &bytes), Some(first));

        // A frame that ends wrong is counted, and the next one heard.
        let (last, begin) = bytes.split_last().unwrap();
        let before = wire.pilot.damaged();
        assert_eq!(wire.pass(speaks, &[begin, &[last ^ 0x81]].concat()), None);
        assert_eq!(wire.pass(speaks, &bytes), Some(first));
        assert!(wire.pilot.damaged() > before);
    }
}

#[test]
fn what_the_receiver_says_of_its_link_is_passed_on() {
    let mut wire = Wire::new();
    let frame = |flags| wire::sbus(&[992; 16], flags, 0);
    for _ in 0..100 {
        wire.pass(Protocol::Sbus, &frame(0));
    }
    for (flags, status) in
        [(0, LinkStatus::Good), (0b0100, LinkStatus::FrameLost), (0b1000, LinkStatus::Failsafe)]
    {
        let passed = wire.pass(Protocol::Sbus, &frame(flags)).unwrap();
        assert_eq!(passed.status, status);
    }
}

#[test]
fn noise_is_no_receiver() {
    let mut wire = Wire::new();
    let mut random = wire::Random(1);
    for _ in 0..60_000 {
        let bytes: [u8; 26] = std::array::from_fn(|_| random.byte());
        let speaks = wire.listens_for;
        assert_eq!(wire.pass(speaks, &bytes), None);
    }
    assert_eq!(wire.pilot.found(), None);
}
