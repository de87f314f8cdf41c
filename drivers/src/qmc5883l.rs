//! The QMC5883L magnetometer on I2C.
//!
//! Registers and their meaning are those of QST's datasheet 1.0 (February 2016). Many boards sold with an
//! HMC5883L carry this chip; that one answers at 0x1e, has other registers, and is not meant here.
//!
//! Set up here: ±8 G, 3,000 counts a gauss, 100 samples a second, each the mean of 512.
//!
//! # Sampling
//! The chip's data-ready line is on no connector, so the status register is asked. Reading data takes the
//! flag away, so the status comes first. The data registers stand still from the first byte that is read of
//! them to the last (6.2.1.1), so that a sample is never torn; one that comes meanwhile is lost.
//! [`Qmc5883l::sample`] must be called more often than samples come, or some are reported as lost.
//!
//! # Other drivers
//! None of those published fits: `qmc5883l` 0.0.1 is AGPL and for embedded-hal 0.2, `qmc5883p` 1.0 is for
//! another chip, and `Laura7089/qmc5883l-rs` neither checks its settings nor looks at lost samples.

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

/// What CHIP_ID reads. So does a bus that nobody drives, but there nobody acknowledges the address either.
const IDENTITY: u8 = 0xff;
/// CONTROL_2: back to the values after power-up.
const SOFT_RST: u8 = 0x80;

/// STATUS: there is a sample that was not read.
const DRDY: u8 = 0x01;
/// STATUS: an axis was beyond 16 bits.
const OVL: u8 = 0x02;
/// STATUS: a sample was lost because the one before it had not been read.
const DOR: u8 = 0x04;

/// Mean of 512 (00), ±8 G (01), 100 Hz (10), continuous (01).
const MEASURING: u8 = 0b00_01_10_01;

const SETTINGS: [(u8, u8); 2] = [
    // The only value that the datasheet recommends (9.2.5).
    (SET_RESET_PERIOD, 0x01),
    // Last, because it starts the chip.
    (CONTROL_1, MEASURING),
];

/// Why the sensor could not be set up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SetupError<E> {
    /// The bus failed, or nobody answers at the address.
    Bus(E),
    /// Another chip answers.
    Identity(u8),
    /// The register at this address does not hold what was written to it.
    NotKept(u8),
}

impl<E> From<E> for SetupError<E> {
    fn from(error: E) -> Self {
        Self::Bus(error)
    }
}

/// Why [`Qmc5883l::sample`] gives no sample, or not without a remark.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SampleError<E> {
    /// The bus failed, or the chip does not answer any more.
    Bus(E),
    /// What follows the data is not the setting that was written there: the chip has reset, as after a dip of
    /// its supply, or fell silent on the way. It must be set up again.
    SettingLost,
    /// The field is beyond the range: what the registers hold is not it.
    Overflow,
    /// This sample is new and whole, but one or more before it were lost.
    Skipped(MagSample),
}

impl<E> From<E> for SampleError<E> {
    fn from(error: E) -> Self {
        Self::Bus(error)
    }
}

/// The sensor, set up and sampling.
pub struct Qmc5883l<I2C> {
    i2c: I2C,
}

impl<I2C: I2c> Qmc5883l<I2C> {
    /// Resets the sensor and sets it up. I2C up to 400 kHz. Takes 2 ms.
    ///
    /// # Errors
    /// See [`SetupError`].
    pub fn new(i2c: I2C, delay: &mut impl DelayNs) -> Result<Self, SetupError<I2C::Error>> {
        let mut mag = Self { i2c };
        // From power-up to the first access 350 µs (table 7). The supply may have come up just now.
        delay.delay_ms(1);
        mag.write(CONTROL_2, SOFT_RST)?;
        // The datasheet has no figure for this one; a reset by the supply takes 350 µs.
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
                return Err(SetupError::NotKept(register));
            }
        }
        Ok(mag)
    }

    /// Reads the latest sample, if there is one that was not read before. At 400 kHz it waits 0.16 ms, and
    /// 0.45 ms if there is a sample.
    ///
    /// # Errors
    /// See [`SampleError`].
    pub fn sample(&mut self) -> Result<Option<MagSample>, SampleError<I2C::Error>> {
        // Both readings go on to the setting, so that a line which only stays low or high is not taken for a
        // chip.
        let [status, .., setting] = self.read::<4>(STATUS)?;
        if setting != MEASURING {
            return Err(SampleError::SettingLost);
        }
        if status & DRDY == 0 {
            return Ok(None);
        }
        // Also when the sample is of no use: reading it makes room for the next.
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
