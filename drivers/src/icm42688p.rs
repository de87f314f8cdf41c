//! The ICM-42688-P inertial sensor on SPI.
//!
//! Register names, addresses and fields are those of TDK's datasheet DS-000347 (revision 1.7); a remark on a
//! setting is from the description of its register there.
//!
//! Set up here: ±2,000 °/s and ±16 g, both at 1 kHz in low-noise mode; anti-alias filters at 258 Hz, below the
//! 500 Hz that a rate of 1 kHz would fold down; user filters at their default (second order, a quarter of the
//! output rate); a data-ready pulse on INT1.
//!
//! # Sampling by DMA
//! [`Icm42688p::new`] needs a bus that waits; after it the board may send [`BURST`] by itself whenever the
//! data-ready line rises, and hand what comes back to [`decode`].
//!
//! ```text
//!      0 µs      the chip has a sample: line up, DATA_RDY_INT set
//!      1 µs      the burst starts: address, accelerometer, gyroscope, FSYNC time, INT_STATUS
//!     14 µs      16 bytes at 10.5 MHz later, its last byte has read DATA_RDY_INT, and cleared it
//!  1,000 µs      the next sample
//! ```
//!
//! The last byte says whether anything came since the burst before: without it, the registers were only read
//! again. It also comes after the data, so that a chip which falls silent on the way is noticed.
//!
//! What a frame cannot say is whether a sample landed between its bytes. The datasheet does not promise that
//! the registers stand still during a burst, so some bytes may be older than the rest. That takes a data-ready
//! edge between the start of the burst and its end: the board looks, and says so to [`decode`]. A burst that
//! starts within 980 µs of its edge is safe.
//!
//! SPI has no checksum. A bit that flips on the way is not noticed here.
//!
//! # Other drivers
//! None of those published fits: `icm42688` 0.2 is for I2C and embedded-hal 0.2, `icm426xx` 0.4 reads 20-bit
//! packets from the FIFO only, `ShenMian/icm42688p-rs` 0.1 reads register by register, and none judges what
//! it reads.

use embedded_hal::delay::DelayNs;
use embedded_hal::spi::SpiDevice;
use flight_core::sample::ImuSample;

/// A register of one of the sensor's banks.
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

/// The same address in every bank.
const REG_BANK_SEL: u8 = 0x76;
/// Set in the address byte of a read.
const READ: u8 = 0x80;
/// What WHO_AM_I reads.
const IDENTITY: u8 = 0x47;

/// INT_STATUS: there is a sample that was not there when this register was last read.
const DATA_RDY_INT: u8 = 0x08;
/// INT_STATUS: the chip has reset since this register was last read.
const RESET_DONE_INT: u8 = 0x10;
/// INT_STATUS: a bit that the chip never sets.
const RESERVED: u8 = 0x80;

/// Anti-alias filter at 258 Hz (section 5.3).
const AAF_DELT: u8 = 6;
const AAF_DELTSQR: u16 = 36;
const AAF_BITSHIFT: u8 = 10;

/// Settings that are written as a whole, in this order, with both sensors off.
const SETTINGS: [(Register, u8); 12] = [
    // Only SPI is listened to; data most significant byte first; invalid data is marked as such.
    (INTF_CONFIG0, 0x33),
    (GYRO_CONFIG_STATIC3, AAF_DELT),
    (GYRO_CONFIG_STATIC4, AAF_DELTSQR as u8),
    (GYRO_CONFIG_STATIC5, AAF_BITSHIFT << 4 | (AAF_DELTSQR >> 8) as u8),
    // Bit 0 clear: the filter is on.
    (ACCEL_CONFIG_STATIC2, AAF_DELT << 1),
    (ACCEL_CONFIG_STATIC3, AAF_DELTSQR as u8),
    (ACCEL_CONFIG_STATIC4, AAF_BITSHIFT << 4 | (AAF_DELTSQR >> 8) as u8),
    // Full scale 0: ±2,000 °/s, ±16 g; data rate 6: 1 kHz.
    (GYRO_CONFIG0, 0x06),
    (ACCEL_CONFIG0, 0x06),
    // INT1 pulsed, push-pull, active high.
    (INT_CONFIG, 0b011),
    // INT_ASYNC_RESET is set after a reset, and must be cleared for INT1 to work.
    (INT_CONFIG1, 0x00),
    // Data ready goes to INT1, and nothing else.
    (INT_SOURCE0, 0x08),
];

/// Both sensors in low-noise mode.
const BOTH_LOW_NOISE: u8 = 0x0f;

/// The set-up counts the samples of this many looks, 100 µs apart, ...
const RATE_LOOKS: u32 = 200;
const RATE_LOOK_US: u32 = 100;
/// ... which must be 20, but for the time that the looks themselves take and for the chip's own clock. The
/// next rates that the chip has are half and twice this one.
const RATE_SAMPLES: core::ops::RangeInclusive<u32> = 16..=24;

/// Bytes of a burst: the address, twelve of data, two of a time that is not used, INT_STATUS.
pub const FRAME_LEN: usize = 16;

/// What comes back for [`BURST`].
pub type Frame = [u8; FRAME_LEN];

/// What is sent in a burst.
pub const BURST: Frame = {
    let mut sent = [0; FRAME_LEN];
    sent[0] = ACCEL_DATA_X1.address | READ;
    sent
};

/// Where INT_STATUS is in a frame.
const STATUS_AT: usize = 1 + (INT_STATUS.address - ACCEL_DATA_X1.address) as usize;
const _: () = assert!(STATUS_AT == FRAME_LEN - 1);

/// The smallest count that is a measurement. −32,768 is what the registers hold until the first sample, and
/// −32,767 marks invalid data too: a saturated axis ends at −32,766 (INTF_CONFIG0, FIFO_HOLD_LAST_DATA_EN clear).
const LOWEST_VALID: i16 = -32_766;

/// Why the sensor could not be set up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SetupError<E> {
    /// The bus failed.
    Bus(E),
    /// Another chip answers, or none.
    Identity(u8),
    /// The chip did not reset when told to.
    NotReset,
    /// A register does not hold what was written to it.
    NotKept {
        /// Bank of the register.
        bank: u8,
        /// Address of the register.
        address: u8,
    },
    /// Samples do not come at 1 kHz.
    Rate {
        /// Samples in about 20 ms.
        samples: u32,
    },
}

impl<E> From<E> for SetupError<E> {
    fn from(error: E) -> Self {
        Self::Bus(error)
    }
}

/// Why a frame holds no new sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameError {
    /// The line stayed low or high: nobody drives it.
    NoAnswer,
    /// The chip has reset since the last frame, as after a dip of its supply. It must be set up again.
    Reset,
    /// An axis has no measurement: the sensor is off or still starts.
    NoData,
    /// No sample came since the last frame: what the registers hold has been read before.
    Repeated,
    /// A sample came between the bytes: see the module's documentation.
    Torn,
}

/// The sample in a frame; `risen` if the data-ready line rose while the burst ran.
///
/// # Errors
/// See [`FrameError`].
pub fn decode(frame: &Frame, risen: bool) -> Result<ImuSample, FrameError> {
    // The first byte comes while the address goes out: it is the lowest of these 128 bits, and does not count.
    let silent = u128::from_le_bytes(*frame) >> 8 == 0;
    let [_, answer @ ..] = frame;
    let status = frame[STATUS_AT];
    if silent || status & RESERVED != 0 {
        return Err(FrameError::NoAnswer);
    }
    if status & RESET_DONE_INT != 0 {
        return Err(FrameError::Reset);
    }
    // The accelerometer's registers, then the gyroscope's, most significant byte first.
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

/// The sensor, set up and sampling.
pub struct Icm42688p<SPI> {
    spi: SPI,
}

impl<SPI: SpiDevice> Icm42688p<SPI> {
    /// Resets the sensor, sets it up, and sees that samples come. SPI mode 0 or 3, up to 24 MHz. Takes 55 ms.
    ///
    /// # Errors
    /// See [`SetupError`].
    pub fn new(spi: SPI, delay: &mut impl DelayNs) -> Result<Self, SetupError<SPI::Error>> {
        let mut imu = Self { spi };
        // From power-up to the first access 1 ms (table 4). The supply may have come up just now.
        delay.delay_ms(2);
        imu.write(DEVICE_CONFIG, 0x01)?;
        // The reset takes up to 1 ms.
        delay.delay_ms(2);

        let identity = imu.read(WHO_AM_I)?;
        if identity != IDENTITY {
            return Err(SetupError::Identity(identity));
        }
        if imu.read(INT_STATUS)? & RESET_DONE_INT == 0 {
            return Err(SetupError::NotReset);
        }
        for (register, value) in SETTINGS {
            imu.write(register, value)?;
        }
        for (register, value) in SETTINGS {
            imu.check(register, value)?;
        }
        // Bits 7:6 from 10 to 01 switch off the adaptive full-scale feature, in which the gyroscope's output
        // stands still for milliseconds at a time. The datasheet calls them reserved; the setting is from
        // ArduPilot's pull request 25332.
        let interface = imu.read(INTF_CONFIG1)? & 0x3f | 0x40;
        imu.write(INTF_CONFIG1, interface)?;
        imu.check(INTF_CONFIG1, interface)?;

        imu.write(PWR_MGMT0, BOTH_LOW_NOISE)?;
        // No register may be written for 200 µs after this, the gyroscope takes 30 ms to start (table 1), and
        // it must stay on for 45 ms at least.
        delay.delay_ms(30);
        imu.check(PWR_MGMT0, BOTH_LOW_NOISE)?;
        let samples = imu.count_samples(delay)?;
        if !RATE_SAMPLES.contains(&samples) {
            return Err(SetupError::Rate { samples });
        }
        Ok(imu)
    }

    /// Does a burst, and waits for it.
    ///
    /// # Errors
    /// The bus's.
    pub fn read_frame(&mut self) -> Result<Frame, SPI::Error> {
        let mut frame = BURST;
        self.spi.transfer_in_place(&mut frame)?;
        Ok(frame)
    }

    /// The bus, for sampling by DMA.
    pub fn release(self) -> SPI {
        self.spi
    }

    fn count_samples(&mut self, delay: &mut impl DelayNs) -> Result<u32, SPI::Error> {
        self.read(INT_STATUS)?;
        let mut samples = 0;
        for _ in 0..RATE_LOOKS {
            delay.delay_us(RATE_LOOK_US);
            samples += u32::from(self.read_here(INT_STATUS)? & DATA_RDY_INT != 0);
        }
        Ok(samples)
    }

    fn check(&mut self, register: Register, value: u8) -> Result<(), SetupError<SPI::Error>> {
        let Register { bank, address } = register;
        if self.read(register)? == value { Ok(()) } else { Err(SetupError::NotKept { bank, address }) }
    }

    fn write(&mut self, register: Register, value: u8) -> Result<(), SPI::Error> {
        self.select(register.bank)?;
        self.spi.write(&[register.address, value])
    }

    fn read(&mut self, register: Register) -> Result<u8, SPI::Error> {
        self.select(register.bank)?;
        self.read_here(register)
    }

    /// Reads a register of the bank that is selected: bank 0, once the sensor is set up.
    fn read_here(&mut self, register: Register) -> Result<u8, SPI::Error> {
        let mut frame = [register.address | READ, 0];
        self.spi.transfer_in_place(&mut frame)?;
        Ok(frame[1])
    }

    fn select(&mut self, bank: u8) -> Result<(), SPI::Error> {
        self.spi.write(&[REG_BANK_SEL, bank])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Accelerometer 1, −2, 32,767; gyroscope −32,766, 300, −1; new.
    const FRAME: Frame = [0x5a, 0, 1, 0xff, 0xfe, 0x7f, 0xff, 0x80, 0x02, 1, 0x2c, 0xff, 0xff, 0, 0, 0x08];

    fn with(changes: &[(usize, u8)]) -> Frame {
        let mut frame = FRAME;
        for (at, byte) in changes {
            frame[*at] = *byte;
        }
        frame
    }

    #[test]
    fn a_frame_holds_a_sample() {
        let sample = ImuSample { accel: [1, -2, 32_767], gyro: [-32_766, 300, -1] };
        assert_eq!(decode(&FRAME, false), Ok(sample));
        // The byte that comes with the address means nothing.
        assert_eq!(decode(&with(&[(0, 0xff)]), false), Ok(sample));
    }

    #[test]
    fn a_frame_says_why_it_holds_none() {
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
