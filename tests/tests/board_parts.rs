//! The parts of the firmware that need no board: the inertial sensor's driver against a sensor played here,
//! and the extension of the microsecond counter.

#[path = "../../firmware/src/clock.rs"]
mod clock;
#[path = "../../firmware/src/icm42688p.rs"]
mod icm42688p;

use std::convert::Infallible;

use embedded_hal::delay::DelayNs;
use embedded_hal::spi::{ErrorType, Operation, SpiDevice};
use flight_core::sample::ImuSample;
use icm42688p::{Icm42688p, SetupError};

/// Addresses and values as the datasheet has them, typed in once more.
const BANK_SELECT: u8 = 0x76;
const DEVICE_CONFIG: usize = 0x11;
const PWR_MGMT0: usize = 0x4e;
const WHO_AM_I: usize = 0x75;

/// A sensor on the other end of the bus, and the delays between the accesses to it.
struct Sensor {
    identity: u8,
    /// A register (bank, address) that keeps nothing.
    broken: Option<(usize, usize)>,
    bank: usize,
    registers: [[u8; 128]; 3],
    now_ns: u64,
    /// Until when the sensor must be left alone.
    busy_until_ns: u64,
    sampling_since_ns: Option<u64>,
}

impl Sensor {
    fn new() -> Self {
        let mut sensor = Self {
            identity: 0x47,
            broken: None,
            bank: 0,
            registers: [[0; 128]; 3],
            now_ns: 0,
            busy_until_ns: 0,
            sampling_since_ns: None,
        };
        sensor.reset();
        sensor
    }

    fn reset(&mut self) {
        self.bank = 0;
        self.registers = [[0xa5; 128]; 3];
        let [bank0, ..] = &mut self.registers;
        bank0[DEVICE_CONFIG] = 0;
        bank0[WHO_AM_I] = self.identity;
        bank0[PWR_MGMT0] = 0;
        bank0[0x4d] = 0x91;
        bank0[0x64] = 0x10;
        for axis in 0..6 {
            bank0[0x1f + 2 * axis..][..2].copy_from_slice(&[0x80, 0x00]);
        }
    }

    fn write(&mut self, address: usize, value: u8) {
        assert!(self.now_ns >= self.busy_until_ns, "written to while it must be left alone");
        if address == usize::from(BANK_SELECT) {
            self.bank = usize::from(value);
        } else if (self.bank, address) == (0, DEVICE_CONFIG) && value & 1 == 1 {
            self.reset();
            self.busy_until_ns = self.now_ns + 1_000_000;
        } else if self.broken != Some((self.bank, address)) {
            self.registers[self.bank][address] = value;
            if (self.bank, address) == (0, PWR_MGMT0) {
                self.busy_until_ns = self.now_ns + 200_000;
                self.sampling_since_ns = (value == 0x0f).then_some(self.now_ns);
            }
        }
    }

    fn measure(&mut self, sample: ImuSample) {
        for (axis, counts) in sample.accel.iter().chain(&sample.gyro).enumerate() {
            self.registers[0][0x1f + 2 * axis..][..2].copy_from_slice(&counts.to_be_bytes());
        }
    }
}

impl ErrorType for Sensor {
    type Error = Infallible;
}

impl SpiDevice for Sensor {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Infallible> {
        match operations {
            [Operation::Write([address, value])] => self.write(usize::from(*address), *value),
            [Operation::TransferInPlace(frame)] => {
                assert!(self.now_ns >= self.busy_until_ns, "read while it must be left alone");
                let (address, data) = frame.split_first_mut().unwrap();
                assert!(*address & 0x80 != 0, "a write of more than a byte");
                let start = usize::from(*address & 0x7f);
                data.copy_from_slice(&self.registers[self.bank][start..][..data.len()]);
            }
            other => panic!("{} operations that the driver does not use", other.len()),
        }
        Ok(())
    }
}

/// The sensor sees the driver's delays through this.
struct Bench {
    sensor: std::cell::RefCell<Sensor>,
}

struct Bus<'a>(&'a Bench);
struct Wait<'a>(&'a Bench);

impl ErrorType for Bus<'_> {
    type Error = Infallible;
}

impl SpiDevice for Bus<'_> {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Infallible> {
        self.0.sensor.borrow_mut().transaction(operations)
    }
}

impl DelayNs for Wait<'_> {
    fn delay_ns(&mut self, ns: u32) {
        self.0.sensor.borrow_mut().now_ns += u64::from(ns);
    }
}

impl Bench {
    fn new(sensor: Sensor) -> Self {
        Self { sensor: sensor.into() }
    }

    fn set_up(&self) -> Result<Icm42688p<Bus<'_>>, SetupError<Infallible>> {
        Icm42688p::new(Bus(self), &mut Wait(self))
    }
}

#[test]
fn the_sensor_is_set_up_as_the_chain_expects_it() {
    let bench = Bench::new(Sensor::new());
    bench.set_up().unwrap();
    let sensor = bench.sensor.borrow();
    let [bank0, bank1, bank2] = &sensor.registers;
    // ±2,000 °/s and ±16 g at 1 kHz: 16.4 counts per °/s and 2,048 per g, as in `Params::default()`.
    assert_eq!((bank0[0x4f], bank0[0x50]), (0x06, 0x06));
    // Anti-alias filters at 258 Hz: 6, 36 and 10 of the datasheet's table.
    assert_eq!((bank1[0x0c], bank1[0x0d], bank1[0x0e]), (6, 36, 10 << 4));
    assert_eq!((bank2[0x03], bank2[0x04], bank2[0x05]), (6 << 1, 36, 10 << 4));
    // INT1: pulsed, push-pull, active high, not reset asynchronously, raised by data ready alone.
    assert_eq!((bank0[0x14], bank0[0x64], bank0[0x65]), (0x03, 0x00, 0x08));
    // The two reserved bits, and no others.
    assert_eq!(bank0[0x4d], 0x51);
    // The gyroscope stays on for 45 ms before anything is read.
    assert!(sensor.now_ns - sensor.sampling_since_ns.unwrap() >= 45_000_000);
}

#[test]
fn a_sample_is_read_axis_by_axis() {
    let bench = Bench::new(Sensor::new());
    let mut imu = bench.set_up().unwrap();
    assert_eq!(imu.sample(), Ok(None), "the registers hold nothing yet");
    let sample = ImuSample { gyro: [1, -2, 32_767], accel: [-32_767, 300, -2_048] };
    bench.sensor.borrow_mut().measure(sample);
    assert_eq!(imu.sample(), Ok(Some(sample)));
    bench.sensor.borrow_mut().measure(ImuSample { accel: [0, i16::MIN, 0], ..sample });
    assert_eq!(imu.sample(), Ok(None), "one axis holds nothing");
}

#[test]
fn what_is_no_working_sensor_is_refused() {
    let floating = Bench::new(Sensor { identity: 0xff, ..Sensor::new() });
    assert_eq!(floating.set_up().err(), Some(SetupError::Identity(0xff)));
    for (bank, address) in [(0, 0x4f), (0, 0x64), (1, 0x0d), (2, 0x05)] {
        let bench = Bench::new(Sensor { broken: Some((bank, address)), ..Sensor::new() });
        let expected = SetupError::NotKept { bank: bank as u8, address: address as u8 };
        assert_eq!(bench.set_up().err(), Some(expected));
    }
}

#[test]
fn the_clock_goes_on_where_its_counter_wraps() {
    let mut clock = clock::Clock::default();
    assert_eq!(clock.extend(5), 5);
    assert_eq!(clock.extend(5), 5);
    assert_eq!(clock.extend(u32::MAX), u64::from(u32::MAX));
    assert_eq!(clock.extend(0), 1 << 32);
    assert_eq!(clock.extend(1_000), (1 << 32) + 1_000);
}
