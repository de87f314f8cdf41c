//! The ICM-42688-P IMU on SPI.
//!
//! Register names, addresses and fields are those of TDK's datasheet DS-000347 (revision 1.7). A comment on a setting
//! refers to the register's description there.
//!
//! Configuration: ±2,000 °/s and ±16 g, both at 1 kHz in low-noise mode; anti-alias filters at 258 Hz, below the
//! Nyquist frequency of 500 Hz; user filters at their default (second order, a quarter of the output rate); a
//! data-ready pulse on INT1.
//!
//! # Set-up
//! [`Setup`] configures the IMU in steps that do not wait, so that it can also run in flight. It repeats failed
//! attempts until one succeeds. [`Recovery`] decides when a new set-up is needed.
//!
//! # Sampling by DMA
//! After the set-up, the board sends [`BURST_READ`] by DMA whenever the data-ready line rises, and passes the received
//! bytes to [`decode`].
//!
//! ```text
//!      0 µs      the chip has a sample: line high, DATA_RDY_INT set
//!      1 µs      the burst starts: address, accelerometer, gyroscope, FSYNC time, INT_STATUS
//!     14 µs      16 bytes at 10.5 MHz later, the last byte has read DATA_RDY_INT, and cleared it
//!  1,000 µs      the next sample
//! ```
//!
//! The last byte says whether a new sample came since the previous burst; without one, the burst has read the same
//! registers again. It follows the data, so it also detects a chip that stops answering during the burst.
//!
//! A frame does not show whether a sample became ready during the burst. The datasheet does not guarantee that the
//! registers stay constant during a burst, so some bytes may be older than others. This needs a data-ready edge between
//! start and end of the burst: the board detects it and passes it to [`decode`]. A burst that starts within 980 µs
//! after its edge is safe. A burst without an edge (the line is broken, and the board reads by its own clock) may tear
//! a sample undetected, if the sample becomes ready in its 13 of 1,000 µs.
//!
//! SPI has no checksum: a flipped bit is not detected here.
//!
//! # Other drivers
//! No published driver fits: `icm42688` 0.2 is for I2C and embedded-hal 0.2, `icm426xx` 0.4 only reads 20-bit packets
//! from the FIFO, `ShenMian/icm42688p-rs` 0.1 reads one register at a time, and none of them validates the data.

mod recovery;
mod setup;

use embedded_hal::delay::DelayNs;
use embedded_hal::spi::SpiDevice;
use flight_core::sample::ImuSample;

pub use recovery::Recovery;
pub use setup::{Progress, Setup, SetupError};

/// A register in one of the chip's banks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Register {
    bank: u8,
    address: u8,
}

const fn bank0(address: u8) -> Register {
    Register { bank: 0, address }
}
const fn bank1(address: u8) -> Register {
    Register { bank: 1, address }
}
const fn bank2(address: u8) -> Register {
    Register { bank: 2, address }
}

const DEVICE_CONFIG: Register = bank0(0x11);
const INT_CONFIG: Register = bank0(0x14);
const ACCEL_DATA_X1: Register = bank0(0x1f);
const INT_STATUS: Register = bank0(0x2d);
const INTF_CONFIG0: Register = bank0(0x4c);
const INTF_CONFIG1: Register = bank0(0x4d);
const PWR_MGMT0: Register = bank0(0x4e);
const GYRO_CONFIG0: Register = bank0(0x4f);
const ACCEL_CONFIG0: Register = bank0(0x50);
const INT_CONFIG1: Register = bank0(0x64);
const INT_SOURCE0: Register = bank0(0x65);
const WHO_AM_I: Register = bank0(0x75);
const GYRO_CONFIG_STATIC3: Register = bank1(0x0c);
const GYRO_CONFIG_STATIC4: Register = bank1(0x0d);
const GYRO_CONFIG_STATIC5: Register = bank1(0x0e);
const ACCEL_CONFIG_STATIC2: Register = bank2(0x03);
const ACCEL_CONFIG_STATIC3: Register = bank2(0x04);
const ACCEL_CONFIG_STATIC4: Register = bank2(0x05);

/// The bank-select register, at the same address in every bank.
const REG_BANK_SEL: u8 = 0x76;
/// Bit of the address byte that marks a read.
const READ: u8 = 0x80;
/// INT_STATUS: a sample came since this register was last read.
const DATA_RDY_INT: u8 = 0x08;
/// INT_STATUS: the chip has reset since this register was last read.
const RESET_DONE_INT: u8 = 0x10;
/// INT_STATUS: a bit that the chip never sets.
const RESERVED: u8 = 0x80;

/// Length of a burst, bytes: the address, twelve of data, two of an unused time, INT_STATUS.
pub const FRAME_LEN: usize = 16;

/// The bytes received during [`BURST_READ`].
pub type Frame = [u8; FRAME_LEN];

/// The bytes sent in a burst.
pub const BURST_READ: Frame = {
    let mut sent = [0; FRAME_LEN];
    sent[0] = ACCEL_DATA_X1.address | READ;
    sent
};

/// Index of INT_STATUS in a frame.
const STATUS_AT: usize = 1 + (INT_STATUS.address - ACCEL_DATA_X1.address) as usize;
const _: () = assert!(STATUS_AT == FRAME_LEN - 1);

/// The smallest valid count. The registers hold −32,768 until the first sample, and −32,767 also marks invalid data; a
/// saturated axis stops at −32,766 (INTF_CONFIG0, FIFO_HOLD_LAST_DATA_EN clear).
const LOWEST_VALID: i16 = -32_766;

/// Reason why a frame has no new sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameError {
    /// The line stayed low or high: no chip drives it.
    NoAnswer,
    /// The chip has reset since the last frame, for example after a dip of its supply. It needs a new set-up.
    Reset,
    /// An axis has no valid count: the sensor is off or still starting.
    NoData,
    /// No sample came since the last frame: the registers hold the sample that was already read.
    Repeated,
    /// A sample became ready during the burst: see the module's documentation.
    Torn,
}

/// Decodes a frame's sample; `risen` says whether the data-ready line rose during the burst.
///
/// # Errors
/// See [`FrameError`].
pub fn decode(frame: &Frame, risen: bool) -> Result<ImuSample, FrameError> {
    // The first byte is received while the address is sent. It is the lowest of these 128 bits and is ignored.
    let silent = u128::from_le_bytes(*frame) >> 8 == 0;
    let [_, answer @ ..] = frame;
    let status = frame[STATUS_AT];
    if silent || status & RESERVED != 0 {
        return Err(FrameError::NoAnswer);
    }
    if status & RESET_DONE_INT != 0 {
        return Err(FrameError::Reset);
    }
    // The accelerometer's registers come first, then the gyroscope's, most significant byte first.
    let axis = |n: usize| i16::from_be_bytes([answer[2 * n], answer[2 * n + 1]]);
    let sample = ImuSample { accel: [axis(0), axis(1), axis(2)], gyro: [axis(3), axis(4), axis(5)] };
    if sample.accel.iter().chain(&sample.gyro).any(|&counts| counts < LOWEST_VALID) {
        return Err(FrameError::NoData);
    }
    if status & DATA_RDY_INT == 0 {
        return Err(FrameError::Repeated);
    }
    if risen { Err(FrameError::Torn) } else { Ok(sample) }
}

/// The IMU, configured and sampling, on a blocking bus: for tests, and for boards with no other work.
pub struct Icm42688p<SPI> {
    spi: SPI,
}

impl<SPI: SpiDevice> Icm42688p<SPI> {
    /// Runs [`Setup`] once, which takes 55 ms. SPI mode 0 or 3, up to 24 MHz. `edges` returns how often the data-ready
    /// line has risen so far.
    ///
    /// # Errors
    /// See [`SetupError`].
    pub fn new(
        mut spi: SPI,
        delay: &mut impl DelayNs,
        mut edges: impl FnMut() -> u32,
    ) -> Result<Self, SetupError<SPI::Error>> {
        const POLL_US: u32 = 500;
        let mut now_us = 0;
        let mut setup = Setup::new(now_us);
        loop {
            match setup.step(&mut spi, now_us, edges()) {
                Progress::Waiting => {
                    delay.delay_us(POLL_US);
                    now_us += POLL_US;
                }
                Progress::Done => return Ok(Self { spi }),
                Progress::Failed(error) => return Err(error),
            }
        }
    }

    /// Reads one burst, and waits for it.
    ///
    /// # Errors
    /// Errors of the bus.
    pub fn read_frame(&mut self) -> Result<Frame, SPI::Error> {
        let mut frame = BURST_READ;
        self.spi.transfer_in_place(&mut frame)?;
        Ok(frame)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The frame has the accelerometer counts 1, −2, 32,767, the gyroscope counts −32,766, 300, −1, and a new sample.
    const FRAME: Frame = [0x5a, 0, 1, 0xff, 0xfe, 0x7f, 0xff, 0x80, 0x02, 1, 0x2c, 0xff, 0xff, 0, 0, 0x08];

    fn with(changes: &[(usize, u8)]) -> Frame {
        let mut frame = FRAME;
        for (at, byte) in changes {
            frame[*at] = *byte;
        }
        frame
    }

    #[test]
    fn valid_frame_decodes_to_sample() {
        let sample = ImuSample { accel: [1, -2, 32_767], gyro: [-32_766, 300, -1] };
        assert_eq!(decode(&FRAME, false), Ok(sample));
        // The byte received with the address is ignored.
        assert_eq!(decode(&with(&[(0, 0xff)]), false), Ok(sample));
    }

    #[test]
    fn invalid_frames_decode_to_their_error() {
        assert_eq!(decode(&[0xff; FRAME_LEN], false), Err(FrameError::NoAnswer));
        assert_eq!(decode(&[0x00; FRAME_LEN], false), Err(FrameError::NoAnswer));
        assert_eq!(decode(&with(&[(15, 0x18)]), false), Err(FrameError::Reset));
        assert_eq!(decode(&with(&[(15, 0x00)]), false), Err(FrameError::Repeated));
        assert_eq!(decode(&FRAME, true), Err(FrameError::Torn));
        for axis in 0..6 {
            for low in [0x00, 0x01] {
                let frame = with(&[(1 + 2 * axis, 0x80), (2 + 2 * axis, low)]);
                assert_eq!(decode(&frame, false), Err(FrameError::NoData), "axis {axis}");
            }
        }
    }
}
