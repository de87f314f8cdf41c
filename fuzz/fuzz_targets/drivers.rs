//! Fuzzes the sensors' drivers with a bus that delivers arbitrary bytes, and with chips that were written to
//! arbitrarily.
//!
//! A decoded sample equals the bytes. A working chip can be set up after any earlier writes.
#![no_main]

use std::cell::RefCell;
use std::convert::Infallible;
use std::iter;
use std::rc::Rc;

use drivers::icm42688p::{self, Icm42688p};
use drivers::qmc5883l::{self, Qmc5883l, SampleError};
use embedded_hal::delay::DelayNs as _;
use embedded_hal::i2c::{self, I2c};
use embedded_hal::spi::{self, SpiDevice};
use flight_core::sample::{ImuSample, MagSample};
use libfuzzer_sys::fuzz_target;
use sim_host::chips::{Clock, icm42688p as imu_chip, qmc5883l as mag_chip};

/// A bus that delivers the input and then zeros. `last` keeps the bytes of the last read.
struct Bus<'a> {
    bytes: &'a [u8],
    last: Rc<RefCell<Vec<u8>>>,
}

impl<'a> Bus<'a> {
    fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, last: Rc::default() }
    }

    fn fill(&mut self, buffer: &mut [u8]) {
        for byte in buffer.iter_mut() {
            let (first, rest) = self.bytes.split_first().unwrap_or((&0, &[]));
            (*byte, self.bytes) = (*first, rest);
        }
        self.last.replace(buffer.to_vec());
    }
}

impl spi::ErrorType for Bus<'_> {
    type Error = Infallible;
}

impl SpiDevice for Bus<'_> {
    fn transaction(&mut self, operations: &mut [spi::Operation<'_, u8>]) -> Result<(), Infallible> {
        for operation in operations {
            match operation {
                spi::Operation::Read(buffer)
                | spi::Operation::Transfer(buffer, _)
                | spi::Operation::TransferInPlace(buffer) => self.fill(buffer),
                spi::Operation::Write(_) | spi::Operation::DelayNs(_) => {}
            }
        }
        Ok(())
    }
}

impl i2c::ErrorType for Bus<'_> {
    type Error = Infallible;
}

impl I2c for Bus<'_> {
    fn transaction(&mut self, _: u8, operations: &mut [i2c::Operation<'_>]) -> Result<(), Infallible> {
        for operation in operations {
            if let i2c::Operation::Read(buffer) = operation {
                self.fill(buffer);
            }
        }
        Ok(())
    }
}

fuzz_target!(|data: &[u8]| {
    let Some((kind, bytes)) = data.split_first() else { return };
    match kind % 5 {
        0 => bytes.as_chunks().0.iter().for_each(imu_frame),
        1 => {
            let clock = Clock::default();
            let edges = || (clock.now_ns() / 1_000_000) as u32;
            if let Ok(mut imu) = Icm42688p::new(Bus::new(bytes), &mut clock.clone(), edges) {
                let Ok(frame) = imu.read_frame();
                imu_frame(&frame);
            }
        }
        2 => mag_samples(bytes),
        3 => abused_imu(bytes),
        _ => abused_mag(bytes),
    }
});

fn imu_frame(frame: &icm42688p::Frame) {
    for risen in [false, true] {
        let Ok(ImuSample { gyro, accel }) = icm42688p::decode(frame, risen) else { continue };
        let again: Vec<u8> = accel.iter().chain(&gyro).flat_map(|counts| counts.to_be_bytes()).collect();
        assert_eq!(again, frame[1..13]);
        assert!(!risen && accel.iter().chain(&gyro).all(|counts| *counts >= -32_766));
    }
}

fn mag_samples(bytes: &[u8]) {
    let _ = Qmc5883l::new(Bus::new(bytes), &mut Clock::default());
    // What the setup expects to read: the identity, and the settings as they were written.
    let setup_then_input = [&[0xff, 0x01, 0b00_01_10_01], bytes].concat();
    let bus = Bus::new(&setup_then_input);
    let last = Rc::clone(&bus.last);
    let Ok(mut mag) = Qmc5883l::new(bus, &mut Clock::default()) else {
        panic!("the setup fails with the expected bytes")
    };
    for _ in 0..=bytes.len() / 4 {
        if let Ok(Some(sample)) | Err(SampleError::Skipped(sample)) = mag.sample() {
            let again: Vec<u8> = sample.counts.iter().flat_map(|counts| counts.to_le_bytes()).collect();
            assert_eq!(again, last.borrow()[..6]);
        }
    }
}

/// Writes, reads and pauses as the bytes specify, then sets up a driver.
fn abused_imu(bytes: &[u8]) {
    let mut clock = Clock::default();
    let truth = ImuSample { gyro: [1, -2, 3], accel: [-4, 5, -2_048] };
    let mut chip = imu_chip::Icm42688p::new(&clock, Box::new(move |_| truth));
    let mut rest = bytes.iter();
    while let Some(kind) = rest.next() {
        let mut buffer: Vec<u8> = rest.by_ref().take(usize::from(kind >> 4)).copied().collect();
        match kind % 3 {
            0 => clock.delay_ns(u32::from(*kind) * 40_000),
            1 => chip.write(&buffer).unwrap(),
            _ => chip.transfer_in_place(&mut buffer).unwrap(),
        }
    }
    let handle = chip.clone();
    let edges = || handle.data_ready_edges() as u32;
    let Ok(mut imu) = Icm42688p::new(chip, &mut clock, edges) else {
        panic!("the setup of a working chip fails")
    };
    clock.delay_ms(2);
    assert_eq!(icm42688p::decode(&imu.read_frame().unwrap(), false), Ok(truth));
}

fn abused_mag(bytes: &[u8]) {
    let mut clock = Clock::default();
    let truth = MagSample { counts: [1, -2, 3_000] };
    let mut chip = mag_chip::Qmc5883l::new(&clock, Box::new(move |_| truth.counts.map(i32::from)));
    let mut rest = bytes.iter();
    while let Some(kind) = rest.next() {
        let buffer: Vec<u8> = rest.by_ref().take(usize::from(kind >> 4)).copied().collect();
        let mut read = [0; 16];
        // A chip that is not ready or not addressed does not answer; the error does not matter here.
        let _ = match kind % 4 {
            0 => {
                clock.delay_ns(u32::from(*kind) * 40_000);
                Ok(())
            }
            1 => chip.write(qmc5883l::ADDRESS, &buffer),
            2 => chip.read(qmc5883l::ADDRESS, &mut read[..usize::from(kind >> 4)]),
            _ => chip.write_read(qmc5883l::ADDRESS, &buffer, &mut read[..usize::from(kind >> 4)]),
        };
    }
    let Ok(mut mag) = Qmc5883l::new(chip, &mut clock) else { panic!("the setup of a working chip fails") };
    let found = iter::repeat_with(|| {
        clock.delay_ms(5);
        mag.sample()
    });
    let first = found.take(6).find(|sample| !matches!(sample, Ok(None)));
    assert!(
        matches!(first, Some(Ok(Some(sample)) | Err(SampleError::Skipped(sample))) if sample == truth),
        "{first:?}"
    );
}
