//! The set-up, in steps that do not wait.
//!
//! ```text
//!  0 ms    2 ms              4 ms                            35 ms                        55 ms
//!  begun   told to reset     settings written and checked,   the gyroscope has started,   the data-ready line
//!                            both sensors on                 and the mode has been kept   has risen 20 times
//! ```
//! The times are those at which a step is due. Whoever calls [`Setup::step`] once a millisecond finds the sensor set
//! up after 59 ms at most.

use embedded_hal::spi::SpiDevice;

use super::*;

/// From power-up to the first access 1 ms (table 4). The supply may have come up just now.
const POWER_UP_US: u32 = 2_000;
/// The reset takes up to 1 ms.
const RESET_US: u32 = 2_000;
/// After the mode has changed, no register may be written for 200 µs, and the gyroscope takes 30 ms to start (table
/// 1). A millisecond is for the step that changes the mode at its end. The gyroscope must stay on for 45 ms at least:
/// an attempt that fails goes on after more than that.
const START_US: u32 = 31_000;
/// For so long the edges of the data-ready line are counted, ...
const COUNT_US: u32 = 20_000;
/// ... of which there must be one in each millisecond, but for a fifth: for the chip's own clock, and for those at
/// either end. The next rates that the chip has are half and twice this one.
const PERIOD_US: u32 = 1_000;

/// How long it is until the next attempt, µs. The first few are close together if the sensor does not answer: its
/// supply may be back in a few milliseconds, and in flight there are 100 ms in all. Then come attempts 150 ms apart, up
/// to the twentieth; then one a second, for ever.
const fn pause_us(attempt: u32, sensors_on: bool) -> u32 {
    match attempt {
        ..=5 if !sensors_on => 5_000,
        ..=20 => 150_000,
        _ => 1_000_000,
    }
}

/// What WHO_AM_I reads.
const IDENTITY: u8 = 0x47;

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
    /// The data-ready line does not rise 1,000 times a second: no samples, another rate, or the line is broken.
    Rate {
        /// Edges in 20 ms.
        edges: u32,
    },
}

impl<E> From<E> for SetupError<E> {
    fn from(error: E) -> Self {
        Self::Bus(error)
    }
}

impl<E> SetupError<E> {
    /// For people.
    pub const fn text(&self) -> &'static str {
        match self {
            Self::Bus(_) => "the bus failed",
            Self::Identity(_) => "another chip answers, or none: identity",
            Self::NotReset => "does not reset",
            Self::NotKept { .. } => "does not take a setting: bank and register",
            Self::Rate { .. } => "data ready does not rise 20 times in 20 ms: times",
        }
    }

    /// The number that belongs to [`Self::text`]; 0 if none does.
    pub const fn number(&self) -> u32 {
        match *self {
            Self::Bus(_) | Self::NotReset => 0,
            Self::Identity(identity) => identity as u32,
            Self::NotKept { bank, address } => (bank as u32) << 8 | address as u32,
            Self::Rate { edges } => edges,
        }
    }
}

/// What has become of the set-up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Progress<E> {
    /// It is under way, or waits for its next attempt.
    Waiting,
    /// The sensor samples.
    Done,
    /// This attempt has failed; another one follows.
    Failed(SetupError<E>),
}

/// What comes next.
#[derive(Clone, Copy)]
enum Stage {
    Reset,
    Settings,
    Count,
    End { since_us: u32, edges: u32 },
}

/// The set-up.
pub struct Setup {
    stage: Stage,
    due_us: u32,
    attempt: u32,
}

impl Setup {
    /// Begins at `now_us`, on a counter that may wrap.
    pub const fn new(now_us: u32) -> Self {
        Self { stage: Stage::Reset, due_us: now_us.wrapping_add(POWER_UP_US), attempt: 1 }
    }

    /// Does what is due, which takes up to 60 transactions of two bytes. SPI mode 0 or 3, up to 24 MHz; nobody else
    /// may use the sensor meanwhile, nor between two steps. `edges` is how often its data-ready line has risen so
    /// far, on a counter that may wrap.
    pub fn step<SPI: SpiDevice>(&mut self, spi: &mut SPI, now_us: u32, edges: u32) -> Progress<SPI::Error> {
        if (now_us.wrapping_sub(self.due_us) as i32) < 0 {
            return Progress::Waiting;
        }
        let wait_us = match self.advance(&mut Registers { spi }, now_us, edges) {
            Ok(None) => return Progress::Done,
            Ok(Some(wait_us)) => wait_us,
            Err(error) => {
                let sensors_on = matches!(self.stage, Stage::Count | Stage::End { .. });
                *self = Self {
                    stage: Stage::Reset,
                    due_us: now_us.wrapping_add(pause_us(self.attempt, sensors_on)),
                    attempt: self.attempt.saturating_add(1),
                };
                return Progress::Failed(error);
            }
        };
        self.due_us = now_us.wrapping_add(wait_us);
        Progress::Waiting
    }

    /// Which attempt is under way, or comes next: from 1.
    pub const fn attempt(&self) -> u32 {
        self.attempt
    }

    /// Does the stage, and says how long the next one must wait; `None` after the last.
    fn advance<SPI: SpiDevice>(
        &mut self,
        imu: &mut Registers<'_, SPI>,
        now_us: u32,
        edges: u32,
    ) -> Result<Option<u32>, SetupError<SPI::Error>> {
        let (next, wait_us) = match self.stage {
            Stage::Reset => {
                imu.write(DEVICE_CONFIG, 0x01)?;
                (Stage::Settings, RESET_US)
            }
            Stage::Settings => {
                imu.set_up()?;
                (Stage::Count, START_US)
            }
            Stage::Count => {
                imu.check(PWR_MGMT0, BOTH_LOW_NOISE)?;
                (Stage::End { since_us: now_us, edges }, COUNT_US)
            }
            Stage::End { since_us, edges: before } => {
                let edges = edges.wrapping_sub(before);
                let us = now_us.wrapping_sub(since_us);
                let tolerated_us = us / 5;
                if edges.saturating_mul(PERIOD_US).abs_diff(us) > tolerated_us {
                    return Err(SetupError::Rate { edges });
                }
                return Ok(None);
            }
        };
        self.stage = next;
        Ok(Some(wait_us))
    }
}

/// The sensor's registers.
struct Registers<'a, SPI> {
    spi: &'a mut SPI,
}

impl<SPI: SpiDevice> Registers<'_, SPI> {
    /// After its reset: the settings, and both sensors on. Bank 0 is selected at the end, as a burst needs it.
    fn set_up(&mut self) -> Result<(), SetupError<SPI::Error>> {
        let identity = self.read(WHO_AM_I)?;
        if identity != IDENTITY {
            return Err(SetupError::Identity(identity));
        }
        if self.read(INT_STATUS)? & RESET_DONE_INT == 0 {
            return Err(SetupError::NotReset);
        }
        for (register, value) in SETTINGS {
            self.write(register, value)?;
        }
        for (register, value) in SETTINGS {
            self.check(register, value)?;
        }
        // Bits 7:6 from 10 to 01 switch off the adaptive full-scale feature, in which the gyroscope's output
        // stands still for milliseconds at a time. The datasheet calls them reserved; the setting is from
        // ArduPilot's pull request 25332.
        let interface = self.read(INTF_CONFIG1)? & 0x3f | 0x40;
        self.write(INTF_CONFIG1, interface)?;
        self.check(INTF_CONFIG1, interface)?;
        self.write(PWR_MGMT0, BOTH_LOW_NOISE)?;
        Ok(())
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
        let mut frame = [register.address | READ, 0];
        self.spi.transfer_in_place(&mut frame)?;
        Ok(frame[1])
    }

    fn select(&mut self, bank: u8) -> Result<(), SPI::Error> {
        self.spi.write(&[REG_BANK_SEL, bank])
    }
}
