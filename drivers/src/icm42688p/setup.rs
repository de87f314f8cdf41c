//! The set-up, in steps that do not wait.
//!
//! ```text
//!  0 ms    2 ms             4 ms                           35 ms                         55 ms
//!  begin   reset command    settings written and checked,  gyroscope started, mode       20 edges of the data-ready
//!                           both sensors on                still as written              line have been counted
//! ```
//! These are the times at which a step is due. With one call of [`Setup::step`] a millisecond, the set-up takes 59 ms
//! at most.

use embedded_hal::spi::SpiDevice;

use super::*;

/// Wait before the first access, µs. The datasheet asks for 1 ms after power-up (table 4), and the supply may have come
/// up just now.
const POWER_UP_US: u32 = 2_000;
/// Time for the reset, µs: up to 1 ms by the datasheet.
const RESET_US: u32 = 2_000;
/// Wait after the mode change, µs. No register may be written for 200 µs after it, and the gyroscope takes 30 ms to
/// start (table 1). The step that changes the mode at its end may take 1 ms of this. The gyroscope must stay on for at
/// least 45 ms: a failed attempt waits longer than that before the next one.
const START_US: u32 = 31_000;
/// Time during which edges of the data-ready line are counted, µs.
const COUNT_US: u32 = 20_000;
/// Expected time between edges, µs. The count may differ by a fifth: for the tolerance of the chip's clock, and for the
/// edges at start and end. The nearest other rates of the chip are half and twice this one.
const PERIOD_US: u32 = 1_000;

/// Returns the time until the next attempt, µs. If the IMU does not answer, the first attempts follow each other
/// closely: its supply may be back in a few milliseconds, and in flight there are only 100 ms. Then attempts follow
/// every 150 ms up to the twentieth, and after that every second without end.
const fn pause_us(attempt: u32, sensors_on: bool) -> u32 {
    match attempt {
        ..=5 if !sensors_on => 5_000,
        ..=20 => 150_000,
        _ => 1_000_000,
    }
}

/// Content of WHO_AM_I.
const IDENTITY: u8 = 0x47;

/// Anti-alias filter at 258 Hz (section 5.3).
const AAF_DELT: u8 = 6;
const AAF_DELTSQR: u16 = 36;
const AAF_BITSHIFT: u8 = 10;

/// Registers that are written completely, in this order, with both sensors off.
const SETTINGS: [(Register, u8); 12] = [
    // Only SPI is enabled; data have the most significant byte first; invalid data are marked as such.
    (INTF_CONFIG0, 0x33),
    (GYRO_CONFIG_STATIC3, AAF_DELT),
    (GYRO_CONFIG_STATIC4, AAF_DELTSQR as u8),
    (GYRO_CONFIG_STATIC5, AAF_BITSHIFT << 4 | (AAF_DELTSQR >> 8) as u8),
    // Bit 0 clear: the filter is on.
    (ACCEL_CONFIG_STATIC2, AAF_DELT << 1),
    (ACCEL_CONFIG_STATIC3, AAF_DELTSQR as u8),
    (ACCEL_CONFIG_STATIC4, AAF_BITSHIFT << 4 | (AAF_DELTSQR >> 8) as u8),
    // Full scale 0 is ±2,000 °/s and ±16 g; data rate 6 is 1 kHz.
    (GYRO_CONFIG0, 0x06),
    (ACCEL_CONFIG0, 0x06),
    // INT1 is pulsed, push-pull and active high.
    (INT_CONFIG, 0b011),
    // INT_ASYNC_RESET is set after a reset, and must be cleared for INT1 to work.
    (INT_CONFIG1, 0x00),
    // Only data ready is routed to INT1.
    (INT_SOURCE0, 0x08),
];

/// Both sensors in low-noise mode.
const BOTH_LOW_NOISE: u8 = 0x0f;

/// Reason why a set-up attempt failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SetupError<E> {
    /// The bus failed.
    Bus(E),
    /// Another chip answers, or none. Holds the content of WHO_AM_I.
    Identity(u8),
    /// The chip did not reset on command.
    NotReset,
    /// A register does not hold the value that was written.
    ReadbackMismatch {
        /// Bank of the register.
        bank: u8,
        /// Address of the register.
        address: u8,
    },
    /// The data-ready line does not rise 1,000 times a second: no samples, another rate, or the line is broken.
    Rate {
        /// Edges counted in 20 ms.
        edges: u32,
    },
}

impl<E> From<E> for SetupError<E> {
    fn from(error: E) -> Self {
        Self::Bus(error)
    }
}

impl<E> SetupError<E> {
    /// Returns a description for the log.
    pub const fn text(&self) -> &'static str {
        match self {
            Self::Bus(_) => "bus error:",
            Self::Identity(_) => "wrong chip or no answer: WHO_AM_I",
            Self::NotReset => "no reset on command:",
            Self::ReadbackMismatch { .. } => "setting not kept: bank and register",
            Self::Rate { .. } => "wrong data-ready rate: edges in 20 ms",
        }
    }

    /// Returns the number that belongs to [`Self::text`]; 0 if there is none.
    pub const fn number(&self) -> u32 {
        match *self {
            Self::Bus(_) | Self::NotReset => 0,
            Self::Identity(identity) => identity as u32,
            Self::ReadbackMismatch { bank, address } => (bank as u32) << 8 | address as u32,
            Self::Rate { edges } => edges,
        }
    }
}

/// Result of a set-up step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Progress<E> {
    /// The set-up is in progress, or waits for its next attempt.
    Waiting,
    /// The IMU samples.
    Done,
    /// This attempt has failed; another one follows.
    Failed(SetupError<E>),
}

/// The next stage.
#[derive(Clone, Copy)]
enum Stage {
    Reset,
    Settings,
    CountEdges,
    CheckRate { since_us: u32, edges: u32 },
}

/// The set-up.
pub struct Setup {
    stage: Stage,
    due_us: u32,
    attempt: u32,
}

impl Setup {
    /// Starts at `now_us`, on a counter that may wrap.
    pub const fn new(now_us: u32) -> Self {
        Self { stage: Stage::Reset, due_us: now_us.wrapping_add(POWER_UP_US), attempt: 1 }
    }

    /// Runs the stage that is due, which takes up to 60 transactions of two bytes. SPI mode 0 or 3, up to 24 MHz. No
    /// other code may use the IMU during the set-up, including between two steps. `edges` is how often the data-ready
    /// line has risen so far, on a counter that may wrap.
    pub fn step<SPI: SpiDevice>(&mut self, spi: &mut SPI, now_us: u32, edges: u32) -> Progress<SPI::Error> {
        if (now_us.wrapping_sub(self.due_us) as i32) < 0 {
            return Progress::Waiting;
        }
        let wait_us = match self.advance(&mut Registers { spi }, now_us, edges) {
            Ok(None) => return Progress::Done,
            Ok(Some(wait_us)) => wait_us,
            Err(error) => {
                let sensors_on = matches!(self.stage, Stage::CountEdges | Stage::CheckRate { .. });
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

    /// Returns the number of the current or next attempt, from 1.
    pub const fn attempt(&self) -> u32 {
        self.attempt
    }

    /// Runs the current stage and returns how long the next one must wait, µs; `None` after the last.
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
                imu.write_settings()?;
                (Stage::CountEdges, START_US)
            }
            Stage::CountEdges => {
                imu.check(PWR_MGMT0, BOTH_LOW_NOISE)?;
                (Stage::CheckRate { since_us: now_us, edges }, COUNT_US)
            }
            Stage::CheckRate { since_us, edges: before } => {
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

/// Access to the chip's registers.
struct Registers<'a, SPI> {
    spi: &'a mut SPI,
}

impl<SPI: SpiDevice> Registers<'_, SPI> {
    /// Writes and checks the settings after a reset, and switches both sensors on. Selects bank 0 at the end, as bursts
    /// need it.
    fn write_settings(&mut self) -> Result<(), SetupError<SPI::Error>> {
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
        // Changing bits 7:6 from 10 to 01 switches off the adaptive full-scale feature, which freezes the gyroscope's
        // output for milliseconds at a time. The datasheet calls these bits reserved; the setting comes from
        // ArduPilot's pull request 25332.
        let interface = self.read(INTF_CONFIG1)? & 0x3f | 0x40;
        self.write(INTF_CONFIG1, interface)?;
        self.check(INTF_CONFIG1, interface)?;
        self.write(PWR_MGMT0, BOTH_LOW_NOISE)?;
        Ok(())
    }

    fn check(&mut self, register: Register, value: u8) -> Result<(), SetupError<SPI::Error>> {
        let Register { bank, address } = register;
        if self.read(register)? == value {
            Ok(())
        } else {
            Err(SetupError::ReadbackMismatch { bank, address })
        }
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
