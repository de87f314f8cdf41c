//! The ICM-42688-P inertial sensor on SPI.
//!
//! Register names, addresses and fields are those of TDK's datasheet DS-000347 (revision 1.7); a remark on a
//! setting is from the description of its register there.
//!
//! Set up here: ±2,000 °/s and ±16 g, both at 1 kHz in low-noise mode; anti-alias filters at 258 Hz, below the
//! 500 Hz that a rate of 1 kHz would fold down; user filters at their default (second order, a quarter of the
//! output rate); a data-ready pulse on INT1.

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

/// Anti-alias filter at 258 Hz (section 5.3).
const AAF_DELT: u8 = 6;
const AAF_DELTSQR: u16 = 36;
const AAF_BITSHIFT: u8 = 10;

/// Settings that are written as a whole, in this order, with both sensors off.
const SETTINGS: [(Register, u8); 11] = [
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
    // Data ready goes to INT1.
    (INT_SOURCE0, 0x08),
];

/// Both sensors in low-noise mode.
const BOTH_LOW_NOISE: u8 = 0x0f;
/// What a data register holds until the first sample.
const NO_DATA: i16 = i16::MIN;

/// Why the sensor could not be set up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SetupError<E> {
    /// The bus failed.
    Bus(E),
    /// Another chip answers, or none.
    Identity(u8),
    /// A register does not hold what was written to it.
    NotKept {
        /// Bank of the register.
        bank: u8,
        /// Address of the register.
        address: u8,
    },
}

impl<E> From<E> for SetupError<E> {
    fn from(error: E) -> Self {
        Self::Bus(error)
    }
}

/// The sensor, set up and sampling.
pub struct Icm42688p<SPI> {
    spi: SPI,
}

impl<SPI: SpiDevice> Icm42688p<SPI> {
    /// Resets the sensor and sets it up. SPI mode 0 or 3, up to 24 MHz.
    ///
    /// # Errors
    /// See [`SetupError`].
    pub fn new(spi: SPI, delay: &mut impl DelayNs) -> Result<Self, SetupError<SPI::Error>> {
        let mut imu = Self { spi };
        imu.write(DEVICE_CONFIG, 0x01)?;
        // The reset takes up to 1 ms.
        delay.delay_ms(2);

        let identity = imu.read(WHO_AM_I)?;
        if identity != IDENTITY {
            return Err(SetupError::Identity(identity));
        }
        for (register, value) in SETTINGS {
            imu.write(register, value)?;
        }
        for (register, value) in SETTINGS {
            if imu.read(register)? != value {
                return Err(SetupError::NotKept { bank: register.bank, address: register.address });
            }
        }
        // Bits 7:6 from 10 to 01 switch off the adaptive full-scale feature, in which the gyroscope's output
        // stands still for milliseconds at a time. The datasheet calls them reserved; the setting is from
        // ArduPilot's pull request 25332.
        let interface = imu.read(INTF_CONFIG1)?;
        imu.write(INTF_CONFIG1, interface & 0x3f | 0x40)?;

        imu.write(PWR_MGMT0, BOTH_LOW_NOISE)?;
        // No register may be written for 200 µs after this, and the gyroscope must stay on for 45 ms at least.
        delay.delay_ms(50);
        Ok(imu)
    }

    /// Reads the latest sample, if there is one.
    ///
    /// # Errors
    /// The bus's.
    pub fn sample(&mut self) -> Result<Option<ImuSample>, SPI::Error> {
        // The accelerometer's registers, then the gyroscope's, most significant byte first.
        let mut frame = [0; 13];
        frame[0] = ACCEL_DATA_X1.address | READ;
        self.spi.transfer_in_place(&mut frame)?;
        let axis = |n: usize| i16::from_be_bytes([frame[1 + 2 * n], frame[2 + 2 * n]]);
        let sample = ImuSample { accel: [axis(0), axis(1), axis(2)], gyro: [axis(3), axis(4), axis(5)] };
        let complete = sample.accel.iter().chain(&sample.gyro).all(|&counts| counts != NO_DATA);
        Ok(complete.then_some(sample))
    }

    fn write(&mut self, register: Register, value: u8) -> Result<(), SPI::Error> {
        self.select(register.bank)?;
        self.spi.write(&[register.address, value])
    }

    fn read(&mut self, register: Register) -> Result<u8, SPI::Error> {
        self.select(register.bank)?;
        let mut frame = [register.address | READ, 0];
        self.spi.transfer_in_place(&mut frame)?;
        Ok(frame[1])
    }

    /// Selects the bank; every access does, and only the setup accesses single registers.
    fn select(&mut self, bank: u8) -> Result<(), SPI::Error> {
        self.spi.write(&[REG_BANK_SEL, bank])
    }
}
