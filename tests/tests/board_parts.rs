//! Parts of the firmware that live in host-tested crates and need a scene, a receiver or a stored record to test: the
//! extension of the microsecond counter, the search for the receiver's protocol, and the check of a stored
//! configuration.

use flight_core::calibration::Calibration;
use flight_core::geometry::{Mat3, vec3};
use flight_core::rc::ChannelMap;
use flight_core::sample::{LinkStatus, RcFrame};
use flight_core::{Config, FlightController, Params};
use proptest::prelude::*;
use receiver::Protocol;
use receiver::search::{Received, Search};
use sim_host::scene::{BUILT_IN, Scene};
use stored_config::board::{Refused, read_for_board};
use stored_config::{DecodeError, MAX_RECORD, encode};
use tasks::clock::Clock;
use test_support::wire;

#[test]
fn clock_continues_when_its_counter_wraps() {
    let mut clock = Clock::new();
    assert_eq!(clock.at(5), 5);
    assert_eq!(clock.at(5), 5);
    let mut count = 5_u32;
    let mut expected = 5_u64;
    for _ in 0..100 {
        // Half an hour each, so that the counter wraps (after 71 minutes).
        count = count.wrapping_add(1_800_000_000);
        expected += 1_800_000_000;
        assert_eq!(clock.at(count), expected);
        // A count that was read earlier and is converted later.
        assert_eq!(clock.at(count.wrapping_sub(40)), expected - 40);
        assert_eq!(clock.at(count), expected);
    }
}

/// A serial port with a receiver at the other end, which sends a frame every 10 ms at any settings of the port.
struct Wire {
    search: Search,
    port_set_for: Protocol,
    now_us: u64,
}

impl Wire {
    fn new() -> Self {
        Self { search: Search::new(ChannelMap::AETR), port_set_for: Search::FIRST, now_us: 0 }
    }

    /// Advances by ten milliseconds, in which the receiver sends `bytes` in the protocol `sent`.
    fn pass(&mut self, sent: Protocol, bytes: &[u8]) -> Option<RcFrame> {
        let mut last = None;
        for (n, byte) in bytes.iter().enumerate() {
            let received = if self.port_set_for == sent { Received::Byte(*byte) } else { Received::Damaged };
            let frame = self.search.push(received, self.now_us + wire::received_us(sent, n));
            last = frame.or(last);
        }
        self.now_us += 10_000;
        if let Some(line) = self.search.next_line(self.now_us) {
            self.port_set_for = wire::BOTH.into_iter().find(|protocol| protocol.line() == line).unwrap();
        }
        last
    }
}

#[test]
fn receiver_protocol_is_found_and_kept() {
    let mut channels = [992; 16];
    channels[2] = 300;
    for sent in wire::BOTH {
        let bytes = wire::channels(sent, &channels);
        let mut wire = Wire::new();
        let first = (0..150).find_map(|_| wire.pass(sent, &bytes)).expect("found within 1.5 s");
        assert_eq!(first, ChannelMap::AETR.frame(&channels, LinkStatus::Good));
        assert_eq!(wire.search.found(), Some(sent));

        // After a minute of silence the port still has the same settings and decodes the first frame.
        for _ in 0..6_000 {
            assert_eq!(wire.pass(sent, &[]), None);
        }
        assert_eq!(wire.pass(sent, &bytes), Some(first));

        // A frame with a wrong last byte is counted, and the next one is decoded.
        let (last, begin) = bytes.split_last().unwrap();
        let before = wire.search.damaged();
        assert_eq!(wire.pass(sent, &[begin, &[last ^ 0x81]].concat()), None);
        assert_eq!(wire.pass(sent, &bytes), Some(first));
        assert!(wire.search.damaged() > before);
    }
}

#[test]
fn receiver_link_status_is_passed_on() {
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
fn noise_is_not_taken_for_a_receiver() {
    let mut wire = Wire::new();
    let mut random = wire::Random(1);
    for _ in 0..60_000 {
        let bytes: [u8; 26] = std::array::from_fn(|_| random.byte());
        let sent = wire.port_set_for;
        assert_eq!(wire.pass(sent, &bytes), None);
    }
    assert_eq!(wire.search.found(), None);
}

/// Returns the parameters of a board whose IMU is mounted rotated.
fn board() -> Params {
    let mut board = Params::default();
    let mounting = Mat3 { rows: [vec3(0.0, 1.0, 0.0), vec3(1.0, 0.0, 0.0), vec3(0.0, 0.0, -1.0)] };
    board.gyro.mounting = mounting;
    board.accel.mounting = mounting;
    board
}

fn stored_as(config: &Config) -> Result<Config, Refused> {
    let mut flash = [0xff; MAX_RECORD];
    encode(config, &mut flash).unwrap();
    read_for_board(&flash, &board())
}

#[test]
fn stored_configuration_keeps_the_boards_mounting() {
    let mut config = Config { params: Params::default(), calibration: Some(Calibration::NONE) };
    config.calibration.as_mut().unwrap().gyro.bias = vec3(0.01, -0.02, 0.03);
    config.params.descent.throttle = 0.3;
    // The magnetometer is not on the board: the vehicle defines its mounting.
    config.params.mag.mounting = board().gyro.mounting;
    let accepted = stored_as(&config).unwrap();
    assert_eq!(accepted.params.gyro.mounting, board().gyro.mounting);
    assert_eq!(accepted.params.accel.mounting, board().accel.mounting);
    config.params.gyro.mounting = board().gyro.mounting;
    config.params.accel.mounting = board().accel.mounting;
    assert_eq!(accepted, config);
    assert!(FlightController::new(&accepted).is_ok());
}

#[test]
fn configuration_of_another_board_is_refused_by_field() {
    let config = Config { params: Params::default(), calibration: Some(Calibration::NONE) };
    let refused = |change: fn(&mut Config)| {
        let mut config = config;
        change(&mut config);
        stored_as(&config).map(|_| ())
    };
    assert_eq!(refused(|_| ()), Ok(()));
    let wrong_board = |field| Err(Refused::WrongBoard(field));
    let out_of_range = |field| Err(Refused::OutOfRange(field));
    assert_eq!(refused(|c| c.params.imu_rate_hz = 500.0), wrong_board("imu_rate_hz"));
    assert_eq!(refused(|c| c.params.imu_rate_hz = f32::NAN), wrong_board("imu_rate_hz"));
    assert_eq!(refused(|c| c.params.gyro.per_count *= 2.0), wrong_board("gyro.per_count"));
    assert_eq!(refused(|c| c.params.accel.per_count = f32::NAN), wrong_board("accel.per_count"));
    assert_eq!(refused(|c| c.params.mag.per_count *= 0.998), wrong_board("mag.per_count"));
    assert_eq!(refused(|c| c.params.gyro.per_count *= 1.000_01), Ok(()));
    assert_eq!(refused(|c| c.params.descent.throttle = f32::NAN), out_of_range("descent.throttle"));
    assert_eq!(refused(|c| c.params.channels.arm = 16), out_of_range("rc.channels"));
    assert_eq!(
        refused(|c| c.calibration.as_mut().unwrap().gyro.matrix = Mat3::IDENTITY * 0.0),
        out_of_range("calibration.gyro.matrix (determinant)")
    );
    assert_eq!(read_for_board(&[0xff; 9], &board()), Err(Refused::Record(DecodeError::Empty)));
    assert_eq!(out_of_range("a").map_err(Refused::text), Err::<(), _>(("out of range: ", "a")));
}

/// The configurations are those that `sim-host config` writes.
#[test]
fn scenes_with_the_boards_sensors_are_accepted() {
    let mut accepted = 0;
    for built_in in BUILT_IN {
        let scene = Scene::parse(built_in.name, built_in.text).unwrap();
        match stored_as(&scene.config) {
            Ok(_) => accepted += 1,
            Err(refused) => assert!(matches!(refused, Refused::WrongBoard(_)), "{}", built_in.name),
        }
    }
    assert!(accepted >= 10, "{accepted}");
}

proptest! {
    /// Any bytes in flash are either accepted, and a flight controller can be built from them, or refused.
    #[test]
    fn any_stored_bytes_are_accepted_or_refused(
        bytes in prop::collection::vec(any::<u8>(), 0..MAX_RECORD),
        floats in prop::collection::vec((any::<prop::sample::Index>(), prop::num::f32::ANY), 0..3),
    ) {
        prop_assert!(read_for_board(&bytes, &board()).is_err());
        // Arbitrary numbers with a valid checksum are also either accepted or refused.
        let config = Config { params: Params::default(), calibration: Some(Calibration::NONE) };
        let mut record = encode(&config, &mut [0; MAX_RECORD]).unwrap().to_vec();
        let end = record.len() - 4;
        for (at, float) in floats {
            let at = 8 + at.index(end - 8 - 4);
            record[at..at + 4].copy_from_slice(&float.to_le_bytes());
        }
        let checksum = crc32(&record[..end]);
        record[end..].copy_from_slice(&checksum.to_le_bytes());
        if let Ok(config) = read_for_board(&record, &board()) {
            prop_assert!(FlightController::new(&config).is_ok());
        }
    }
}

/// Computes the CRC-32 of Ethernet, bit by bit.
fn crc32(bytes: &[u8]) -> u32 {
    let bit = |crc: u32| if crc & 1 == 1 { crc >> 1 ^ 0xedb8_8320 } else { crc >> 1 };
    !bytes.iter().fold(!0, |crc, byte| (0..8).fold(crc ^ u32::from(*byte), |crc, _| bit(crc)))
}
