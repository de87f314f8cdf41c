//! The QMC5883L magnetometer on I2C.
//!
//! Registers and their meaning are those of QST's datasheet 1.0 (February 2016). Many boards sold with an HMC5883L have
//! this chip. A real HMC5883L answers at 0x1e and has other registers; this driver does not support it.
//!
//! Configuration: ±8 G, 3,000 counts per gauss, 100 samples a second, each the mean of 512.
//!
//! # Sampling
//! The chip's data-ready line is not on the connector, so the driver polls the status register. Reading data clears the
//! flag, so the status is read first. The data registers stay constant from the first byte read to the last (6.2.1.1):
//! a sample is never torn, but one that comes during the read is lost. Call [`Qmc5883l::sample`] more often than
//! samples come, otherwise some are reported as lost.
//!
//! # Other drivers
//! No published driver fits: `qmc5883l` 0.0.1 is AGPL and for embedded-hal 0.2, `qmc5883p` 1.0 is for another chip, and
//! `Laura7089/qmc5883l-rs` neither checks its settings nor reports lost samples.

use embedded_hal::delay::DelayNs;
use embedded_hal::i2c::I2c;
use flight_core::sample::MagSample;

/// The chip's only address (5.4).
pub const ADDRESS: u8 = 0x0d;

const DATA: u8 = 0x00;
const STATUS: u8 = 0x06;
const CONTROL_1: u8 = 0x09;
const CONTROL_2: u8 = 0x0a;
const SET_RESET_PERIOD: u8 = 0x0b;
const CHIP_ID: u8 = 0x0d;

/// Content of CHIP_ID. An undriven bus reads the same, but then no chip acknowledges the address.
const IDENTITY: u8 = 0xff;
/// CONTROL_2: resets all registers to their power-up values.
const SOFT_RST: u8 = 0x80;

/// STATUS: a sample is ready that was not read.
const DRDY: u8 = 0x01;
/// STATUS: an axis exceeded 16 bits.
const OVL: u8 = 0x02;
/// STATUS: a sample was lost, because the previous one had not been read.
const DOR: u8 = 0x04;

/// Mean of 512 (00), ±8 G (01), 100 Hz (10), continuous (01).
const MEASURING: u8 = 0b00_01_10_01;

const SETTINGS: [(u8, u8); 2] = [
    // This is the only value that the datasheet recommends (9.2.5).
    (SET_RESET_PERIOD, 0x01),
    // Last, because it starts the chip.
    (CONTROL_1, MEASURING),
];

/// Reason why the set-up failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SetupError<E> {
    /// The bus failed, or no chip answers at the address.
    Bus(E),
    /// Another chip answers.
    Identity(u8),
    /// The register at this address does not hold the value that was written.
    ReadbackMismatch(u8),
}

impl<E> From<E> for SetupError<E> {
    fn from(error: E) -> Self {
        Self::Bus(error)
    }
}

/// Reason why [`Qmc5883l::sample`] returns no sample, or a sample with a warning.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SampleError<E> {
    /// The bus failed, or the chip no longer answers.
    Bus(E),
    /// The setting that is read after the data is not the one that was written: the chip has reset (for example after a
    /// dip of its supply) or stopped answering during the read. It needs a new set-up.
    SettingLost,
    /// The field exceeds the range: the registers do not hold its value.
    Overflow,
    /// This sample is new and complete, but one or more before it were lost.
    Skipped(MagSample),
}

impl<E> From<E> for SampleError<E> {
    fn from(error: E) -> Self {
        Self::Bus(error)
    }
}

/// The magnetometer, configured and sampling.
pub struct Qmc5883l<I2C> {
    i2c: I2C,
}

impl<I2C: I2c> Qmc5883l<I2C> {
    /// Resets the chip and configures it. I2C up to 400 kHz. Takes 2 ms.
    ///
    /// # Errors
    /// See [`SetupError`].
    pub fn new(i2c: I2C, delay: &mut impl DelayNs) -> Result<Self, SetupError<I2C::Error>> {
        let mut mag = Self { i2c };
        // The first access must follow power-up by 350 µs (table 7). The supply may have come up just now.
        delay.delay_ms(1);
        mag.write(CONTROL_2, SOFT_RST)?;
        // The datasheet has no time for a software reset; a power-on reset takes 350 µs.
        delay.delay_ms(1);

        let [identity] = mag.read(CHIP_ID)?;
        if identity != IDENTITY {
            return Err(SetupError::Identity(identity));
        }
        for (register, value) in SETTINGS {
            mag.write(register, value)?;
        }
        for (register, value) in SETTINGS {
            if mag.read(register)? != [value] {
                return Err(SetupError::ReadbackMismatch(register));
            }
        }
        Ok(mag)
    }

    /// Reads the latest sample, if there is one that was not read before. At 400 kHz it takes 0.16 ms, and 0.45 ms if
    /// there is a sample.
    ///
    /// # Errors
    /// See [`SampleError`].
    pub fn sample(&mut self) -> Result<Option<MagSample>, SampleError<I2C::Error>> {
        // Both reads include the setting, so that a line that stays low or high is not taken for a chip.
        let [status, .., setting] = self.read::<4>(STATUS)?;
        if setting != MEASURING {
            return Err(SampleError::SettingLost);
        }
        if status & DRDY == 0 {
            return Ok(None);
        }
        // The data are read even if they are unusable: reading frees the registers for the next sample.
        let [xl, xh, yl, yh, zl, zh, .., setting] = self.read::<10>(DATA)?;
        if setting != MEASURING {
            return Err(SampleError::SettingLost);
        }
        let counts = [[xl, xh], [yl, yh], [zl, zh]].map(i16::from_le_bytes);
        let sample = MagSample { counts };
        if status & OVL != 0 {
            Err(SampleError::Overflow)
        } else if status & DOR != 0 {
            Err(SampleError::Skipped(sample))
        } else {
            Ok(Some(sample))
        }
    }

    fn write(&mut self, register: u8, value: u8) -> Result<(), I2C::Error> {
        self.i2c.write(ADDRESS, &[register, value])
    }

    fn read<const N: usize>(&mut self, first: u8) -> Result<[u8; N], I2C::Error> {
        let mut values = [0; N];
        self.i2c.write_read(ADDRESS, &[first], &mut values)?;
        Ok(values)
    }
}
