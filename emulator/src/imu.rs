//! The IMU on its board: an ICM-42688-P, its INT1 line, and their faults.
//!
//! The chip is `rigless`'s model, which has no interrupt output. This module makes INT1 from the settings that the firmware
//! writes (datasheet DS-000347 rev 1.6): data ready on INT1 (`INT_SOURCE0` bit 3), polarity and mode (`INT_CONFIG`), and
//! `INT_ASYNC_RESET` cleared (14.52: otherwise the pins do not work properly; here they do not work at all). A sample is due
//! at each multiple of the period after the start of the output data rate. The model's registers use the same times, so the
//! line is in phase with the data.

use rigless::chip::Timeline;
use rigless::chip::icm42688p::Icm42688p;
use rigless::chip::spi::Peer;
use rigless::snapshot::store;
use rigless::time::{EventId, VirtualNanos};

/// Length of the pulse on INT1, ns (14.52, at rates below 4 kHz).
const PULSE_NS: u64 = 100_000;

const DEVICE_CONFIG: u8 = 0x11;
const INT_CONFIG: u8 = 0x14;
const ACCEL_DATA_X1: u8 = 0x1f;
const INT_STATUS: u8 = 0x2d;
const PWR_MGMT0: u8 = 0x4e;
const GYRO_CONFIG0: u8 = 0x4f;
const ACCEL_CONFIG0: u8 = 0x50;
const INT_CONFIG1: u8 = 0x64;
const INT_SOURCE0: u8 = 0x65;
const REG_BANK_SEL: u8 = 0x76;
const READ: u8 = 0x80;

/// Minimum count of a valid sample in the chip's registers (14.34).
const MIN_COUNT: i16 = -32_766;

/// Present faults of the sensor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Faults {
    /// The sensor has no supply: the data line reads ones, and INT1 is low.
    pub dead: bool,
    /// INT1 is stuck at this level.
    pub stuck_line: Option<bool>,
    /// On average, one bit in this number of words from the chip is flipped.
    pub flip_every: Option<u32>,
}

/// Phase of an SPI transaction.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
enum Phase {
    #[default]
    Address,
    Read(u8),
    Write(u8),
}

/// The sensor.
#[derive(Debug, serde::Serialize, serde::Deserialize)]
pub struct Imu {
    chip: Icm42688p,
    /// Present faults.
    pub faults: Faults,
    /// Whether the chip resets itself before the next transaction.
    reset_requested: bool,
    phase: Phase,
    bank: u8,
    /// The registers INT_CONFIG, INT_CONFIG1 and INT_SOURCE0, as the firmware wrote them.
    int_config: [u8; 3],
    /// The registers PWR_MGMT0, GYRO_CONFIG0 and ACCEL_CONFIG0, as the firmware wrote them.
    rate_config: [u8; 3],
    /// Start of the output data rate, and its period, ns.
    grid: Option<(u64, u64)>,
    due: Option<(EventId, u64)>,
    pulse_ends: Option<EventId>,
    sampled: bool,
    /// Whether the last sample was not taken: the registers still hold the sample before it.
    skipped: bool,
    int1: bool,
    /// Counts that the model's registers cannot hold as a valid sample; they are read in place of the registers.
    raw: Option<[i16; 6]>,
    words: u32,
}

store!(Imu);

impl Default for Imu {
    fn default() -> Self {
        Self::new()
    }
}

impl Imu {
    /// Returns a sensor just after power-on.
    pub fn new() -> Self {
        Self {
            chip: Icm42688p::new(),
            faults: Faults::default(),
            reset_requested: false,
            phase: Phase::Address,
            bank: 0,
            int_config: [0, 0x10, 0],
            rate_config: [0, 0x06, 0x06],
            grid: None,
            due: None,
            pulse_ends: None,
            sampled: false,
            skipped: false,
            int1: false,
            raw: None,
            words: 0,
        }
    }

    /// Returns the time of the next sample, ns; `None` while the chip takes no samples.
    pub fn next_sample_ns(&self) -> Option<u64> {
        self.due.map(|(_, at)| at).filter(|_| !self.faults.dead)
    }

    /// Returns whether a sample was due since the last call.
    pub fn take_sampled(&mut self) -> bool {
        std::mem::take(&mut self.sampled) && !self.faults.dead
    }

    /// Sets the present measurement: counts of ±2,000 °/s and ±16 g along the chip's axes.
    pub fn set_counts(&mut self, gyro: [i16; 3], accel: [i16; 3]) {
        // The model's inputs are in 0.001 °/s and 10⁻⁶ g. It rounds them to counts of 2,000/2¹⁵ °/s and 1/2,048 g, which
        // are 61 and 488 of these units: the conversion reproduces each count exactly.
        let [x, y, z] = gyro.map(|counts| rounded(i64::from(counts) * 2_000_000, 32_768));
        self.chip.set_rate(x, y, z);
        let [x, y, z] = accel.map(|counts| rounded(i64::from(counts) * 1_000_000, 2_048));
        self.chip.set_acceleration(x, y, z);
        let [gx, gy, gz] = gyro;
        let [ax, ay, az] = accel;
        let all = [ax, ay, az, gx, gy, gz];
        self.raw = all.iter().any(|&counts| counts < MIN_COUNT).then_some(all);
    }

    /// Raises INT1 for a new sample, if the settings enable it.
    pub fn signal_ready(&mut self) {
        self.skipped = false;
        let [_, config1, source] = self.int_config;
        if source & 0x08 != 0 && config1 & 0x10 == 0 {
            self.int1 = true;
        }
    }

    /// Skips the sample that is due.
    pub fn skip_sample(&mut self) {
        self.skipped = true;
    }

    /// Returns the level of the pin INT1.
    pub fn int1(&self) -> bool {
        if self.faults.dead {
            return false;
        }
        let active_high = self.int_config[0] & 0x01 != 0;
        self.faults.stuck_line.unwrap_or(self.int1 == active_high)
    }

    /// Makes the chip lose its settings, as after a dip of its supply.
    pub fn request_reset(&mut self) {
        self.reset_requested = true;
        self.clear_settings();
    }

    fn clear_settings(&mut self) {
        self.bank = 0;
        self.int_config = [0, 0x10, 0];
        self.rate_config = [0, 0x06, 0x06];
        self.grid = None;
        self.due = None;
        self.pulse_ends = None;
        self.int1 = false;
        self.sampled = false;
    }

    /// Does a requested reset. The model can be reset only over its bus.
    fn do_requested_reset(&mut self, context: &mut Timeline<'_, '_>) {
        if !std::mem::take(&mut self.reset_requested) {
            return;
        }
        for (address, value) in [(REG_BANK_SEL, 0), (DEVICE_CONFIG, 0x01)] {
            self.chip.select(context);
            self.chip.transfer(u32::from(address), 8, context);
            self.chip.transfer(value, 8, context);
            self.chip.deselect(context);
        }
    }

    /// Updates the copies of the settings after a write to a register.
    fn on_write(&mut self, address: u8, value: u8, context: &mut Timeline<'_, '_>) {
        if address == REG_BANK_SEL {
            self.bank = value & 0x07;
        }
        if self.bank != 0 {
            return;
        }
        match address {
            DEVICE_CONFIG if value & 0x01 != 0 => self.clear_settings(),
            INT_CONFIG => self.int_config[0] = value,
            INT_CONFIG1 => self.int_config[1] = value,
            INT_SOURCE0 => self.int_config[2] = value,
            PWR_MGMT0 => self.set_rate_register(0, value, context),
            GYRO_CONFIG0 => self.set_rate_register(1, value, context),
            ACCEL_CONFIG0 => self.set_rate_register(2, value, context),
            _ => {}
        }
    }

    /// Stores one of the three registers that determine the output data rate, and restarts the rate if it changes.
    fn set_rate_register(&mut self, n: usize, value: u8, context: &mut Timeline<'_, '_>) {
        self.rate_config[n] = value;
        let [power, gyro, accel] = self.rate_config;
        // Only low-noise mode and the common rates are modelled (14.36 to 14.38), because the driver uses no others.
        let period = |code: u8| match code & 0x0f {
            3 => Some(125_000),
            4 => Some(250_000),
            5 => Some(500_000),
            6 => Some(1_000_000),
            _ => None,
        };
        let gyro = period(gyro).filter(|_| power & 0x0c == 0x0c);
        let accel = period(accel).filter(|_| power & 0x03 == 0x03);
        let period = [gyro, accel].into_iter().flatten().min();
        if period == self.grid.map(|(_, period)| period) {
            return;
        }
        self.grid = period.map(|period| (context.now().0, period));
        self.schedule(context);
    }

    fn schedule(&mut self, context: &mut Timeline<'_, '_>) {
        self.due = self.grid.map(|(start, period)| {
            let at = start + ((context.now().0 - start) / period + 1) * period;
            (context.schedule(VirtualNanos(at)), at)
        });
    }

    /// Returns a byte from the chip with the effects of faults, as it appears on the bus.
    fn with_faults(&mut self, address: u8, byte: u8) -> u8 {
        let mut byte = byte;
        if let Some(raw) = &self.raw
            && self.bank == 0
            && (ACCEL_DATA_X1..ACCEL_DATA_X1 + 12).contains(&address)
        {
            let at = usize::from(address - ACCEL_DATA_X1);
            byte = raw[at / 2].to_be_bytes()[at % 2];
        }
        // DATA_RDY_INT.
        if self.skipped && self.bank == 0 && address == INT_STATUS {
            byte &= !0x08;
        }
        self.words = self.words.wrapping_add(1);
        if let Some(every) = self.faults.flip_every {
            // A multiplicative hash spreads the errors over words and bits.
            let hash = self.words.wrapping_mul(0x9e37_79b1);
            if (hash >> 7).is_multiple_of(every) {
                byte ^= 1 << (hash & 7);
            }
        }
        byte
    }
}

fn rounded(numerator: i64, denominator: i64) -> i32 {
    let half = denominator / 2 * numerator.signum();
    ((numerator + half) / denominator) as i32
}

impl Peer for Imu {
    fn select(&mut self, context: &mut Timeline<'_, '_>) {
        self.do_requested_reset(context);
        self.phase = Phase::Address;
        self.chip.select(context);
    }

    fn deselect(&mut self, context: &mut Timeline<'_, '_>) {
        self.chip.deselect(context);
    }

    fn transfer(&mut self, mosi: u32, bits: u8, context: &mut Timeline<'_, '_>) -> u32 {
        if self.faults.dead {
            return 0xff;
        }
        let sent = mosi as u8;
        let answer = self.chip.transfer(mosi, bits, context) as u8;
        match self.phase {
            Phase::Address => {
                let address = sent & !READ;
                self.phase = if sent & READ != 0 { Phase::Read(address) } else { Phase::Write(address) };
                u32::from(answer)
            }
            Phase::Read(address) => {
                self.phase = Phase::Read(address.wrapping_add(1) & 0x7f);
                if address == INT_STATUS && self.bank == 0 && self.int_config[0] & 0x04 != 0 {
                    self.int1 = false;
                }
                u32::from(self.with_faults(address, answer))
            }
            Phase::Write(address) => {
                self.on_write(address, sent, context);
                u32::from(answer)
            }
        }
    }

    fn on_event(&mut self, event: EventId, context: &mut Timeline<'_, '_>) {
        if self.due.is_some_and(|(due, _)| due == event) {
            self.sampled = true;
            self.schedule(context);
            // In pulsed mode the line falls after the pulse; in latched mode it stays.
            if self.int_config[0] & 0x04 == 0 {
                self.pulse_ends = Some(context.schedule(VirtualNanos(context.now().0 + PULSE_NS)));
            }
        } else if self.pulse_ends == Some(event) {
            self.pulse_ends = None;
            self.int1 = false;
        }
    }

    fn restarted(&mut self, context: &mut Timeline<'_, '_>) {
        self.pulse_ends = None;
        self.int1 = false;
        self.schedule(context);
    }
}
