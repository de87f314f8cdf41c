//! The sensors' drivers with the chips that `sim-host` simulates register by register.
//!
//! Register addresses and values are copied from the datasheets, independently of the drivers.

use std::cell::Cell;
use std::collections::VecDeque;
use std::rc::Rc;

use drivers::icm42688p::{self, FrameError, Icm42688p};
use drivers::qmc5883l::{self, Qmc5883l, SampleError};
use embedded_hal::i2c::NoAcknowledgeSource;
use embedded_hal::spi::SpiDevice;
use embedded_hal::{i2c, spi};
use flight_core::sample::{ImuSample, MagSample};
use proptest::prelude::*;
use sim_host::chips::{self, Clock, Fault};
use sim_host::flight::{Flight, Observer, StepView};
use sim_host::scene::{BUILT_IN, Scene};

const MS: u64 = 1_000_000;
const FOR_EVER: std::ops::Range<u64> = 0..u64::MAX;

/// Returns an IMU sample that encodes its number in all axes, so that a mixture of two samples is detected.
fn numbered_imu(n: u16) -> ImuSample {
    let axis = |k: u16| (n.wrapping_mul(7).wrapping_add(k) & 0x3fff) as i16;
    ImuSample { gyro: [axis(1), axis(2), axis(3)], accel: [axis(4), axis(5), n as i16] }
}

fn number(sample: ImuSample) -> u16 {
    sample.accel[2] as u16
}

fn numbered_mag(n: u16) -> [i32; 3] {
    [i32::from(n), -i32::from(n) - 1, i32::from(n) + 2]
}

/// Returns a clock and an IMU whose samples are numbered in order.
fn imu_chip() -> (Clock, chips::icm42688p::Icm42688p) {
    let clock = Clock::default();
    let mut n = 0;
    let source = move |_| {
        n += 1;
        numbered_imu(n)
    };
    let chip = chips::icm42688p::Icm42688p::new(&clock, Box::new(source));
    (clock, chip)
}

fn mag_chip() -> (Clock, chips::qmc5883l::Qmc5883l) {
    let clock = Clock::default();
    let mut n = 0;
    let source = move |_| {
        n += 1;
        numbered_mag(n)
    };
    let chip = chips::qmc5883l::Qmc5883l::new(&clock, Box::new(source));
    (clock, chip)
}

type Imu = Icm42688p<chips::icm42688p::Icm42688p>;
type Mag = Qmc5883l<chips::qmc5883l::Qmc5883l>;

fn set_up_imu(
    clock: &Clock,
    chip: &chips::icm42688p::Icm42688p,
) -> Result<Imu, icm42688p::SetupError<spi::ErrorKind>> {
    Icm42688p::new(chip.clone(), &mut clock.clone(), || chip.data_ready_edges() as u32)
}

fn set_up_mag(
    clock: &Clock,
    chip: &chips::qmc5883l::Qmc5883l,
) -> Result<Mag, qmc5883l::SetupError<i2c::ErrorKind>> {
    Qmc5883l::new(chip.clone(), &mut clock.clone())
}

fn advance_to(clock: &Clock, at_ns: u64) {
    clock.advance_ns(at_ns - clock.now_ns());
}

/// Reads a burst as the board does, with a check of the data-ready line.
fn burst(
    chip: &chips::icm42688p::Icm42688p,
    imu: &mut Imu,
) -> Result<Result<ImuSample, FrameError>, spi::ErrorKind> {
    let before = chip.data_ready_edges();
    let frame = imu.read_frame()?;
    Ok(icm42688p::decode(&frame, chip.data_ready_edges() != before))
}

#[test]
fn imu_registers_match_the_datasheet_after_setup() {
    let (clock, chip) = imu_chip();
    set_up_imu(&clock, &chip).unwrap();
    for (what, bank, address, value) in [
        ("16.4 counts a °/s, 1 kHz", 0, 0x4f, 0x06),
        ("2,048 counts a g, 1 kHz", 0, 0x50, 0x06),
        ("both in low-noise mode", 0, 0x4e, 0x0f),
        ("anti-alias filter of the gyroscope at 258 Hz: 6", 1, 0x0c, 6),
        ("36", 1, 0x0d, 36),
        ("10", 1, 0x0e, 10 << 4),
        ("the accelerometer's: 6, and on", 2, 0x03, 6 << 1),
        ("36", 2, 0x04, 36),
        ("10", 2, 0x05, 10 << 4),
        ("INT1 pulsed, push-pull, active high", 0, 0x14, 0x03),
        ("INT1 not reset asynchronously", 0, 0x64, 0x00),
        ("INT1 raised by data ready alone", 0, 0x65, 0x08),
        ("SPI only, big endian, invalid data marked", 0, 0x4c, 0x33),
        ("adaptive full scale off, and nothing else changed", 0, 0x4d, 0x51),
    ] {
        assert_eq!(chip.register(bank, address), value, "{what}");
    }
    // There is no misuse: the driver waits after power-up and reset, and writes nothing while the mode changes or
    // the sensors sample.
    assert_eq!(chip.misuse(), []);
}

#[test]
fn magnetometer_registers_match_the_datasheet_after_setup() {
    let (clock, chip) = mag_chip();
    set_up_mag(&clock, &chip).unwrap();
    assert_eq!(chip.register(0x09), 0x19, "mean of 512, ±8 G, 100 Hz, continuous");
    assert_eq!(chip.register(0x0b), 0x01, "set/reset period");
    assert_eq!(chip.misuse(), []);
}

#[test]
fn imu_setup_fails_with_the_error_of_each_fault() {
    use icm42688p::SetupError;
    let refused = |fault| {
        let (clock, chip) = imu_chip();
        chip.inject(FOR_EVER, fault);
        set_up_imu(&clock, &chip).err()
    };
    assert_eq!(refused(Fault::Identity(0x42)), Some(SetupError::Identity(0x42)));
    assert_eq!(refused(Fault::NoAnswer { reads: 0xff }), Some(SetupError::Identity(0xff)));
    assert_eq!(refused(Fault::NoAnswer { reads: 0x00 }), Some(SetupError::Identity(0x00)));
    assert_eq!(refused(Fault::NoPower), Some(SetupError::Identity(0x00)));
    assert_eq!(refused(Fault::Stalled), Some(SetupError::Rate { edges: 0 }));
    for every in 1..40 {
        assert_eq!(refused(Fault::Bus { every }), Some(SetupError::Bus(spi::ErrorKind::Other)));
    }
    for (bank, address) in [
        (0, 0x14),
        (0, 0x4c),
        (0, 0x4d),
        (0, 0x4e),
        (0, 0x64),
        (0, 0x65),
        (1, 0x0c),
        (1, 0x0d),
        (1, 0x0e),
        (2, 0x03),
        (2, 0x04),
        (2, 0x05),
    ] {
        let stuck = Fault::StuckRegister { bank, address };
        assert_eq!(refused(stuck), Some(SetupError::ReadbackMismatch { bank, address }));
    }
    // The chip ignores the software reset, because writes to its reset register have no effect. The chip also sets the
    // flag "reset done" after power-up. A read clears this flag, so that the driver does not take it for the flag of
    // its own reset.
    let (clock, chip) = imu_chip();
    clock.advance_ns(2 * MS);
    chip.clone().transfer_in_place(&mut [0x2d | 0x80, 0]).unwrap();
    chip.inject(FOR_EVER, Fault::StuckRegister { bank: 0, address: 0x11 });
    assert_eq!(set_up_imu(&clock, &chip).err(), Some(SetupError::NotReset));
}

#[test]
fn imu_powered_late_is_set_up() {
    // Power comes after 1.5 s. The attempts before it fail; the first six are close together. The next attempt
    // succeeds.
    let (clock, chip) = imu_chip();
    chip.inject(0..1_500 * MS, Fault::NoPower);
    let mut setup = icm42688p::Setup::new(0);
    let mut failures_us = vec![];
    loop {
        let now_us = (clock.now_ns() / 1_000) as u32;
        match setup.step(&mut chip.clone(), now_us, chip.data_ready_edges() as u32) {
            icm42688p::Progress::Waiting => {}
            icm42688p::Progress::Failed(icm42688p::SetupError::Identity(0)) => failures_us.push(now_us),
            icm42688p::Progress::Failed(error) => panic!("{error:?}"),
            icm42688p::Progress::Done => break,
        }
        clock.advance_ns(MS);
    }
    let pauses_us: Vec<u32> = failures_us.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let (close, far) = pauses_us.split_at(5);
    assert!(close.iter().all(|us| (7_000..=8_000).contains(us)), "{failures_us:?}");
    assert!(far.len() == 9 && far.iter().all(|us| (152_000..=153_000).contains(us)), "{failures_us:?}");
    assert!(clock.now_ns() < 1_500 * MS + 215 * MS, "at most 150 ms to the next attempt and 60 ms for it");
    assert_eq!(chip.misuse(), []);
}

#[test]
fn absent_imu_is_retried_once_a_second_after_20_attempts() {
    let (clock, chip) = imu_chip();
    chip.inject(FOR_EVER, Fault::NoPower);
    let mut setup = icm42688p::Setup::new(0);
    let mut failures = 0;
    while clock.now_ns() < 20_000 * MS {
        let step = setup.step(&mut chip.clone(), (clock.now_ns() / 1_000) as u32, 0);
        failures += u32::from(matches!(step, icm42688p::Progress::Failed(_)));
        clock.advance_ns(MS);
    }
    // There are twenty attempts in the first 2.2 s, then one a second.
    assert!((37..=38).contains(&failures), "{failures}");
    assert_eq!(setup.attempt(), failures + 1);
}

#[test]
fn imu_setup_fails_with_a_broken_data_ready_line() {
    for (kind, edges_per_ms) in
        [("no edges", 0), ("half the rate", 1), ("twice the rate", 4), ("noise", 1_000)]
    {
        let (clock, chip) = imu_chip();
        let edges = || (clock.now_ns() / (MS / 2) * edges_per_ms / 4) as u32;
        let refused = Icm42688p::new(chip, &mut clock.clone(), edges).err();
        assert!(matches!(refused, Some(icm42688p::SetupError::Rate { .. })), "{kind}: {refused:?}");
    }
}

#[test]
fn magnetometer_setup_fails_with_the_error_of_each_fault() {
    use qmc5883l::SetupError;
    let refused = |fault| {
        let (clock, chip) = mag_chip();
        chip.inject(FOR_EVER, fault);
        set_up_mag(&clock, &chip).err()
    };
    let nack = i2c::ErrorKind::NoAcknowledge(NoAcknowledgeSource::Address);
    assert_eq!(refused(Fault::Identity(0x80)), Some(SetupError::Identity(0x80)));
    assert_eq!(refused(Fault::NoAnswer { reads: 0x00 }), Some(SetupError::Identity(0x00)));
    assert_eq!(refused(Fault::NoAnswer { reads: 0xff }), Some(SetupError::Bus(nack)));
    assert_eq!(refused(Fault::NoPower), Some(SetupError::Bus(nack)));
    for every in 1..6 {
        assert_eq!(refused(Fault::Bus { every }), Some(SetupError::Bus(nack)));
    }
    for address in [0x09, 0x0b] {
        let stuck = Fault::StuckRegister { bank: 0, address };
        assert_eq!(refused(stuck), Some(SetupError::ReadbackMismatch(address)));
    }
}

/// The samples that the flight controller received in the first seconds of the scene `hover`.
#[derive(Default)]
struct Recording {
    imu: VecDeque<ImuSample>,
    mag: VecDeque<MagSample>,
}

impl Observer for Recording {
    fn step(&mut self, view: &StepView) {
        self.imu.extend(view.input.imu);
        self.mag.extend(view.input.mag);
    }
}

fn hover() -> Recording {
    let text = BUILT_IN.iter().find(|scene| scene.name == "hover").unwrap().text;
    let mut scene = Scene::parse("hover", text).unwrap();
    scene.duration_s = 5.0;
    let mut recording = Recording::default();
    Flight::new(&scene, scene.seed).run(&mut recording);
    recording
}

#[test]
fn flight_samples_pass_chip_and_driver_bit_for_bit() {
    let Recording { imu: recorded, mag: recorded_mag } = hover();
    assert!(recorded.len() == 5_000 && recorded_mag.len() == 500);

    // The chip samples from the start. The driver's setup takes 50 ms, so the first 50 ms of samples are lost.
    let clock = Clock::default();
    let taken = Rc::new(Cell::new(0));
    let (counter, samples) = (taken.clone(), recorded.clone());
    let source = move |_| {
        counter.set(counter.get() + 1);
        samples[counter.get() - 1]
    };
    let chip = chips::icm42688p::Icm42688p::new(&clock, Box::new(source));
    let mut imu = set_up_imu(&clock, &chip).unwrap();
    let mut read = 0;
    while taken.get() < recorded.len() {
        advance_to(&clock, chip.next_sample_ns().unwrap() + 1_000);
        assert_eq!(burst(&chip, &mut imu), Ok(Ok(recorded[taken.get() - 1])));
        read += 1;
    }
    assert!(read > 4_900);

    let clock = Clock::default();
    let mut samples = recorded_mag.clone();
    let source = move |_| samples.pop_front().unwrap().counts.map(i32::from);
    let chip = chips::qmc5883l::Qmc5883l::new(&clock, Box::new(source));
    let mut mag = set_up_mag(&clock, &chip).unwrap();
    for sample in recorded_mag {
        advance_to(&clock, chip.next_sample_ns().unwrap() - MS);
        assert_eq!(mag.sample(), Ok(None), "no new sample yet");
        clock.advance_ns(2 * MS);
        assert_eq!(mag.sample(), Ok(Some(sample)));
        assert_eq!(mag.sample(), Ok(None), "the same sample is not delivered twice");
    }
}

#[test]
fn saturated_axis_is_a_valid_sample() {
    let clock = Clock::default();
    let ends = ImuSample { gyro: [i16::MIN, 0, i16::MAX], accel: [i16::MAX, 1, i16::MIN] };
    let chip = chips::icm42688p::Icm42688p::new(&clock, Box::new(move |_| ends));
    let mut imu = set_up_imu(&clock, &chip).unwrap();
    advance_to(&clock, chip.next_sample_ns().unwrap());
    // The chip's range ends at −32,766; lower values mean that there is no measurement.
    let saturated = ImuSample { gyro: [-32_766, 0, 32_767], accel: [32_767, 1, -32_766] };
    assert_eq!(burst(&chip, &mut imu), Ok(Ok(saturated)));
}

#[test]
fn data_ready_line_rises_with_each_sample() {
    let (clock, chip) = imu_chip();
    set_up_imu(&clock, &chip).unwrap();
    let before = chip.data_ready_edges();
    clock.advance_ns(100 * MS);
    assert_eq!(chip.data_ready_edges() - before, 100);
}

#[test]
fn adaptive_full_scale_repeats_samples_unless_it_is_off() {
    // Changes between 0 and 150 °/s every 20 ms, and every sample is different.
    let shaken = || {
        let clock = Clock::default();
        let source = |at_ns: u64| {
            let fast = if (at_ns / (20 * MS)).is_multiple_of(2) { 0 } else { 2_460 };
            let n = (at_ns / MS % 100) as i16;
            ImuSample { gyro: [fast + n, n, n], accel: [n, 0, 0] }
        };
        let chip = chips::icm42688p::Icm42688p::new(&clock, Box::new(source));
        (clock, chip)
    };
    let repeats = |clock: &Clock, chip: &chips::icm42688p::Icm42688p, imu: &mut Imu| {
        let mut last = None;
        let repeats = (0..100).filter(|_| {
            advance_to(clock, chip.next_sample_ns().unwrap());
            let gyro = burst(chip, imu).unwrap().unwrap().gyro;
            last.replace(gyro) == Some(gyro)
        });
        repeats.count()
    };
    let (clock, chip) = shaken();
    let mut imu = set_up_imu(&clock, &chip).unwrap();
    assert_eq!(repeats(&clock, &chip, &mut imu), 0);
    // Write the reset value of INTF_CONFIG1.
    chip.clone().write(&[0x4d, 0x91]).unwrap();
    assert!(repeats(&clock, &chip, &mut imu) >= 5);
}

#[test]
fn imu_read_fails_with_the_error_of_each_fault() {
    let (clock, chip) = imu_chip();
    let mut imu = set_up_imu(&clock, &chip).unwrap();
    let mut next = || {
        advance_to(&clock, chip.next_sample_ns().unwrap_or(clock.now_ns() + MS));
        burst(&chip, &mut imu)
    };
    let during = |ms: u64| clock.now_ns()..clock.now_ns() + ms * MS;

    next().unwrap().unwrap();
    chip.inject(during(2), Fault::NoAnswer { reads: 0xff });
    assert_eq!(next(), Ok(Err(FrameError::NoAnswer)));
    clock.advance_ns(2 * MS);
    chip.inject(during(2), Fault::NoAnswer { reads: 0x00 });
    assert_eq!(next(), Ok(Err(FrameError::NoAnswer)));
    clock.advance_ns(2 * MS);
    chip.inject(during(2), Fault::Bus { every: 1 });
    assert_eq!(next(), Err(spi::ErrorKind::Other));
    clock.advance_ns(2 * MS);
    next().unwrap().unwrap();

    chip.inject(during(3), Fault::Stalled);
    assert_eq!(next(), Ok(Err(FrameError::Repeated)));
    clock.advance_ns(3 * MS);
    next().unwrap().unwrap();

    chip.inject(during(3), Fault::NoPower);
    assert_eq!(next(), Ok(Err(FrameError::NoAnswer)), "supply off");
    clock.advance_ns(4 * MS);
    assert_eq!(next(), Ok(Err(FrameError::Reset)), "supply on again");
    assert_eq!(next(), Ok(Err(FrameError::NoData)), "the chip is not set up");

    let mut imu = set_up_imu(&clock, &chip).unwrap();
    advance_to(&clock, chip.next_sample_ns().unwrap());
    burst(&chip, &mut imu).unwrap().unwrap();
    assert_eq!(burst(&chip, &mut imu), Ok(Err(FrameError::Repeated)), "read twice");
    assert_eq!(chip.misuse(), []);
}

#[test]
fn imu_sample_during_a_burst_is_reported_as_torn() {
    let (clock, chip) = imu_chip();
    let mut imu = set_up_imu(&clock, &chip).unwrap();
    let mut torn = 0;
    // The bursts take 12 µs, and start from 20 µs before a sample to 5 µs after it.
    for early_ns in (0..=20_000).step_by(100) {
        advance_to(&clock, chip.next_sample_ns().unwrap());
        advance_to(&clock, chip.next_sample_ns().unwrap() - early_ns);
        let before = chip.data_ready_edges();
        let frame = imu.read_frame().unwrap();
        let risen = chip.data_ready_edges() != before;
        // Without the check of the line the torn frame would be accepted.
        let sample = icm42688p::decode(&frame, false).unwrap();
        let consistent = sample == numbered_imu(number(sample));
        assert!(consistent || risen);
        if !consistent {
            assert_eq!(icm42688p::decode(&frame, risen), Err(FrameError::Torn));
            torn += 1;
        }
    }
    assert!(torn > 50, "{torn}");
}

#[test]
fn magnetometer_read_fails_with_the_error_of_each_fault() {
    let (clock, chip) = mag_chip();
    let mut mag = set_up_mag(&clock, &chip).unwrap();
    let nack = Err(SampleError::Bus(i2c::ErrorKind::NoAcknowledge(NoAcknowledgeSource::Address)));
    let during = |ms: u64| clock.now_ns()..clock.now_ns() + ms * MS;
    let newest = || chip.latest().unwrap();

    clock.advance_ns(10 * MS);
    assert_eq!(mag.sample(), Ok(Some(newest())));
    clock.advance_ns(30 * MS);
    assert_eq!(mag.sample(), Err(SampleError::Skipped(newest())), "two samples were lost");
    assert_eq!(mag.sample(), Ok(None));

    clock.advance_ns(10 * MS);
    chip.inject(during(5), Fault::Bus { every: 1 });
    assert_eq!(mag.sample(), nack);
    clock.advance_ns(5 * MS);
    assert_eq!(mag.sample(), Ok(Some(newest())));

    chip.inject(during(5), Fault::NoAnswer { reads: 0xff });
    assert_eq!(mag.sample(), nack);
    clock.advance_ns(5 * MS);
    chip.inject(during(5), Fault::NoAnswer { reads: 0x00 });
    assert_eq!(mag.sample(), Err(SampleError::SettingLost), "a line stuck low acknowledges and reads zero");
    clock.advance_ns(5 * MS);
    // The line goes low, or the supply fails, between the status, which is read after 160 µs, and the data.
    for (after_us, fault) in [(150, Fault::NoAnswer { reads: 0x00 }), (300, Fault::NoPower)] {
        mag.sample().ok();
        clock.advance_ns(10 * MS);
        let from_ns = clock.now_ns() + after_us * 1_000;
        chip.inject(from_ns..from_ns + MS, fault);
        assert_eq!(mag.sample(), Err(SampleError::SettingLost), "{fault:?}");
        clock.advance_ns(2 * MS);
    }
    let mut mag = set_up_mag(&clock, &chip).unwrap();
    clock.advance_ns(5 * MS);

    chip.inject(during(20), Fault::Stalled);
    mag.sample().unwrap();
    clock.advance_ns(19 * MS);
    assert_eq!(mag.sample(), Ok(None));
    clock.advance_ns(11 * MS);
    assert_eq!(mag.sample(), Ok(Some(newest())));

    chip.inject(during(5), Fault::NoPower);
    assert_eq!(mag.sample(), nack);
    clock.advance_ns(6 * MS);
    assert_eq!(mag.sample(), Err(SampleError::SettingLost));
    let mut mag = set_up_mag(&clock, &chip).unwrap();
    clock.advance_ns(10 * MS);
    assert_eq!(mag.sample(), Ok(Some(newest())));
    assert_eq!(chip.misuse(), []);
}

#[test]
fn magnetic_field_beyond_the_range_is_an_overflow_error() {
    let clock = Clock::default();
    let mut n = 0;
    let source = move |_| {
        n += 1;
        if n == 1 { [0, 32_768, 0] } else { [0, 32_767, -32_768] }
    };
    let chip = chips::qmc5883l::Qmc5883l::new(&clock, Box::new(source));
    let mut mag = set_up_mag(&clock, &chip).unwrap();
    clock.advance_ns(10 * MS);
    assert_eq!(mag.sample(), Err(SampleError::Overflow));
    assert_eq!(mag.sample(), Ok(None), "the overflow was read and cleared");
    clock.advance_ns(10 * MS);
    assert_eq!(mag.sample(), Ok(Some(MagSample { counts: [0, 32_767, -32_768] })));
}

#[test]
fn magnetometer_sample_lost_during_a_read_is_reported() {
    let (clock, chip) = mag_chip();
    let mut mag = set_up_mag(&clock, &chip).unwrap();
    clock.advance_ns(10 * MS);
    let first = chip.latest().unwrap();
    // The new sample comes between the read of the status and the end of the data.
    advance_to(&clock, chip.next_sample_ns().unwrap() - 280_000);
    assert_eq!(mag.sample(), Ok(Some(first)), "the chip's data protection keeps the sample consistent");
    assert_eq!(mag.sample(), Ok(None));
    clock.advance_ns(10 * MS);
    assert_eq!(mag.sample(), Err(SampleError::Skipped(chip.latest().unwrap())));
}

fn fault() -> impl Strategy<Value = Fault> {
    prop_oneof![
        (1..4u32).prop_map(|every| Fault::Bus { every }),
        prop_oneof![Just(0x00), Just(0xff)].prop_map(|reads| Fault::NoAnswer { reads }),
        Just(Fault::NoPower),
        Just(Fault::Stalled),
    ]
}

/// Generates up to six faults within `within_ns`, each at most a tenth of it long.
fn schedule(within_ns: u64) -> impl Strategy<Value = Vec<(u64, u64, Fault)>> {
    prop::collection::vec((0..within_ns, 1..within_ns / 10, fault()), 0..6)
}

proptest! {
    // A failure prints its smallest input; failures are not stored in a file.
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn random_faults_never_give_a_false_imu_sample(
        faults in schedule(100 * MS),
        waits_ns in prop::collection::vec(0..1_500_000u64, 100),
    ) {
        let (clock, chip) = imu_chip();
        let mut imu = set_up_imu(&clock, &chip).unwrap();
        let start_ns = clock.now_ns();
        for (at_ns, for_ns, fault) in faults {
            chip.inject(start_ns + at_ns..start_ns + at_ns + for_ns, fault);
        }
        let mut last = None;
        for wait_ns in waits_ns {
            clock.advance_ns(wait_ns);
            match burst(&chip, &mut imu) {
                Ok(Ok(sample)) => {
                    // The sample is consistent, newer than the one before, and the newest of the chip, unless the
                    // supply failed between the last byte and now.
                    prop_assert_eq!(sample, numbered_imu(number(sample)));
                    prop_assert!(chip.latest().is_none_or(|latest| latest == sample));
                    prop_assert!(Some(number(sample)) > last);
                    last = Some(number(sample));
                }
                Ok(Err(FrameError::Reset | FrameError::NoData)) => {
                    if let Ok(again) = set_up_imu(&clock, &chip) {
                        imu = again;
                    }
                }
                _ => {}
            }
        }
    }

    #[test]
    fn random_faults_never_give_a_false_magnetometer_sample(
        faults in schedule(1_000 * MS),
        waits_ns in prop::collection::vec(0..15 * MS, 100),
    ) {
        let (clock, chip) = mag_chip();
        let mut mag = set_up_mag(&clock, &chip).unwrap();
        let start_ns = clock.now_ns();
        for (at_ns, for_ns, fault) in faults {
            chip.inject(start_ns + at_ns..start_ns + at_ns + for_ns, fault);
        }
        let mut last = 0;
        for wait_ns in waits_ns {
            clock.advance_ns(wait_ns);
            match mag.sample() {
                Ok(Some(sample)) | Err(SampleError::Skipped(sample)) => {
                    let number = sample.counts[0] as u16;
                    prop_assert_eq!(sample.counts.map(i32::from), numbered_mag(number));
                    prop_assert!(number > last);
                    last = number;
                }
                Err(SampleError::SettingLost) => {
                    if let Ok(again) = set_up_mag(&clock, &chip) {
                        mag = again;
                    }
                }
                _ => {}
            }
        }
    }
}
