//! Model of the ICM-42688-P: gyroscope and accelerometer on SPI.
//!
//! Source: TDK's datasheet DS-000347. Section numbers, reset values and quoted rules are those of revision 1.6, as the
//! crate `rigless` 0.3 (`chip/icm42688p.rs`, `chip/icm426xx.rs`) cites them. FIFO, APEX, self-test and filters are not
//! modelled, because the driver does not use them: registers that are not in `RESET_VALUES` read zero and ignore
//! writes.
//!
//! | subject | in the datasheet |
//! |---|---|
//! | access (9.6) | a byte of direction and address; reads continue at the next address, a write takes one byte |
//! | banks (13) | each has its own registers; REG_BANK_SEL is in all of them |
//! | power-up, reset | registers are accessible after 1 ms (table 4; 14.1); then RESET_DONE_INT is set |
//! | data registers (14.5 to 14.18) | −32,768 until the first sample, then the latest valid one |
//! | range of a count (14.34) | −32,766 to 32,767 |
//! | start (tables 1, 2) | first data of the accelerometer 10 ms after it is switched on, of the gyroscope after 30 ms |
//! | rate (5.6) | that of the faster sensor |
//! | DATA_RDY_INT (14.21) | set by a sample, cleared by reading INT_STATUS |
//! | forbidden | a write within 200 µs after a change of mode; gyroscope off within 45 ms (14.36); changes of settings other than modes, rates and ranges while a sensor is on (12) |
//!
//! The datasheet does not specify these points, so the model assumes:
//! - A sample that arrives during a burst changes the registers that are still to be read, byte by byte.
//! - A chip that is not ready reads zero and ignores writes.
//! - A change of the rate restarts the period.
//! - The adaptive full-scale feature, which INTF_CONFIG1's reserved bits 7:6 leave on after reset (10), holds
//!   the gyroscope's registers for 2 ms whenever a rate crosses 100 °/s (ArduPilot, pull request 25332: "between
//!   1ms and 2ms").

use std::cell::RefCell;
use std::rc::Rc;

use embedded_hal::spi::{ErrorKind, ErrorType, Operation, SpiDevice};
use flight_core::sample::ImuSample;

use super::{Clock, Fault, Misuse, Sampling, Schedule};

const DEVICE_CONFIG: u8 = 0x11;
const INT_CONFIG: u8 = 0x14;
const ACCEL_DATA_X1: u8 = 0x1f;
const GYRO_DATA_X1: u8 = 0x25;
const GYRO_DATA_Z0: u8 = 0x2a;
const INT_STATUS: u8 = 0x2d;
const INTF_CONFIG0: u8 = 0x4c;
const INTF_CONFIG1: u8 = 0x4d;
const PWR_MGMT0: u8 = 0x4e;
const GYRO_CONFIG0: u8 = 0x4f;
const ACCEL_CONFIG0: u8 = 0x50;
const INT_CONFIG1: u8 = 0x64;
const INT_SOURCE0: u8 = 0x65;
const WHO_AM_I: u8 = 0x75;
const REG_BANK_SEL: u8 = 0x76;

/// The writable registers of the modelled part of the chip: bank, address, value after a reset (14 to 16).
const RESET_VALUES: [(u8, u8, u8); 21] = [
    (0, DEVICE_CONFIG, 0x00),
    (0, 0x13, 0x05), // DRIVE_CONFIG
    (0, INT_CONFIG, 0x00),
    (0, INTF_CONFIG0, 0x30),
    (0, INTF_CONFIG1, 0x91),
    (0, PWR_MGMT0, 0x00),
    (0, GYRO_CONFIG0, 0x06),
    (0, ACCEL_CONFIG0, 0x06),
    (0, 0x51, 0x16), // GYRO_CONFIG1
    (0, 0x52, 0x11), // GYRO_ACCEL_CONFIG0
    (0, 0x53, 0x0d), // ACCEL_CONFIG1
    (0, 0x63, 0x00), // INT_CONFIG0
    (0, INT_CONFIG1, 0x10),
    (0, INT_SOURCE0, 0x10),
    (1, 0x0b, 0xa0), // GYRO_CONFIG_STATIC2 to 5
    (1, 0x0c, 0x0d),
    (1, 0x0d, 0xaa),
    (1, 0x0e, 0x80),
    (2, 0x03, 0x30), // ACCEL_CONFIG_STATIC2 to 4
    (2, 0x04, 0x40),
    (2, 0x05, 0x62),
];

const IDENTITY: u8 = 0x47;
const DATA_RDY_INT: u8 = 0x08;
const RESET_DONE_INT: u8 = 0x10;
const READY_NS: u64 = 1_000_000;
const MODE_CHANGE_NS: u64 = 200_000;
const GYRO_START_NS: u64 = 30_000_000;
const GYRO_MIN_ON_NS: u64 = 45_000_000;
const ACCEL_START_NS: u64 = 10_000_000;
const MIN_COUNT: i32 = -32_766;
/// 100 °/s at ±2,000 °/s.
const ADAPTIVE_STEP_COUNTS: u16 = 1_640;
const ADAPTIVE_HOLD_NS: u64 = 2_000_000;

/// Periods of the data rates by their code (14.37), ns; 0 for a code without a rate in low-noise mode.
const PERIOD_NS: [u64; 16] = [
    0, 31_250, 62_500, 125_000, 250_000, 500_000, 1_000_000, 5_000_000, 10_000_000, 20_000_000, 40_000_000,
    80_000_000, 0, 0, 0, 2_000_000,
];

/// Time of a byte on the bus at 10.5 MHz, ns.
const BYTE_NS: u64 = 762;

/// The source of samples: returns the counts at a time, ns, for the ranges ±2,000 °/s and ±16 g.
pub type Source = Box<dyn FnMut(u64) -> ImuSample>;

/// A handle on the chip: the bus device for the driver, and the interface for the test.
#[derive(Clone)]
pub struct Icm42688p(Rc<RefCell<Chip>>);

impl Icm42688p {
    /// Creates a chip whose supply comes up now.
    pub fn new(clock: &Clock, source: Source) -> Self {
        let mut chip = Chip {
            schedule: Schedule::new(clock),
            source,
            misuse: vec![],
            banks: [[0; 128]; 5],
            bank: 0,
            ready_ns: 0,
            mode_ns: None,
            gyro_on_ns: None,
            accel_on_ns: None,
            gyro_held_until_ns: 0,
            gyro_was_fast: false,
            latest: None,
            edges: 0,
            frame: Frame::Address,
            line: None,
        };
        chip.restart(clock.now_ns());
        Self(Rc::new(RefCell::new(chip)))
    }

    /// Injects a fault for a time range, ns.
    pub fn inject(&self, during: std::ops::Range<u64>, fault: Fault) {
        self.0.borrow_mut().schedule.faults.list.push((during, fault));
    }

    /// Returns the driver's violations of the datasheet.
    pub fn misuse(&self) -> Vec<Misuse> {
        self.0.borrow().misuse.clone()
    }

    /// Returns the content of a register, without side effects on it.
    pub fn register(&self, bank: u8, address: u8) -> u8 {
        self.now().banks[usize::from(bank)][usize::from(address)]
    }

    /// Returns the sample in the data registers, at the configured scale.
    pub fn latest(&self) -> Option<ImuSample> {
        self.now().latest
    }

    /// Returns the number of rising edges of the data-ready line.
    pub fn data_ready_edges(&self) -> u64 {
        self.now().edges
    }

    /// Returns the time of the next sample, ns.
    pub fn next_sample_ns(&self) -> Option<u64> {
        self.now().schedule.next_sample_ns
    }

    fn now(&self) -> std::cell::RefMut<'_, Chip> {
        let mut chip = self.0.borrow_mut();
        chip.catch_up();
        chip
    }
}

/// The chip's position in a transaction.
#[derive(Clone, Copy)]
enum Frame {
    Address,
    Read(u8),
    Write(u8),
    /// A write takes one byte.
    Written,
}

struct Chip {
    schedule: Schedule,
    source: Source,
    misuse: Vec<Misuse>,
    banks: [[u8; 128]; 5],
    bank: u8,
    ready_ns: u64,
    /// Time of the last change of mode, ns.
    mode_ns: Option<u64>,
    gyro_on_ns: Option<u64>,
    accel_on_ns: Option<u64>,
    gyro_held_until_ns: u64,
    gyro_was_fast: bool,
    latest: Option<ImuSample>,
    edges: u64,
    frame: Frame,
    /// Value of each byte while the data line is disconnected.
    line: Option<u8>,
}

impl Sampling for Chip {
    fn schedule(&mut self) -> &mut Schedule {
        &mut self.schedule
    }

    fn restart(&mut self, at_ns: u64) {
        self.banks = [[0; 128]; 5];
        for (bank, address, value) in RESET_VALUES {
            self.banks[usize::from(bank)][usize::from(address)] = value;
        }
        self.banks[0][usize::from(WHO_AM_I)] = IDENTITY;
        self.banks[0][usize::from(INT_STATUS)] = RESET_DONE_INT;
        for address in (ACCEL_DATA_X1..=GYRO_DATA_Z0).step_by(2) {
            self.banks[0][usize::from(address)] = 0x80;
        }
        self.bank = 0;
        self.ready_ns = at_ns.saturating_add(READY_NS);
        self.mode_ns = None;
        self.gyro_on_ns = None;
        self.accel_on_ns = None;
        self.schedule.next_sample_ns = None;
        self.gyro_held_until_ns = 0;
        self.gyro_was_fast = false;
        self.latest = None;
    }

    // Returns the sample period of the fastest sensor that is on, ns.
    fn period_ns(&self) -> Option<u64> {
        let period_ns = |on_ns: Option<u64>, config| {
            let period_ns = PERIOD_NS[usize::from(self.setting(config) & 0x0f)];
            (on_ns.is_some() && period_ns > 0).then_some(period_ns)
        };
        let gyro_ns = period_ns(self.gyro_on_ns, GYRO_CONFIG0);
        gyro_ns.into_iter().chain(period_ns(self.accel_on_ns, ACCEL_CONFIG0)).min()
    }

    fn store_sample(&mut self, at_ns: u64) {
        let mut sample = (self.source)(at_ns);
        self.apply_adaptive_full_scale(&mut sample, at_ns);
        let has_started = |on_ns: Option<u64>, takes_ns| on_ns.is_some_and(|on_ns| at_ns >= on_ns + takes_ns);
        let gyro = has_started(self.gyro_on_ns, GYRO_START_NS);
        let accel = has_started(self.accel_on_ns, ACCEL_START_NS);
        if gyro {
            let range = self.setting(GYRO_CONFIG0) >> 5;
            sample.gyro = self.write_counts(GYRO_DATA_X1, sample.gyro, range);
        }
        if accel {
            let range = self.setting(ACCEL_CONFIG0) >> 5 & 0b11;
            sample.accel = self.write_counts(ACCEL_DATA_X1, sample.accel, range);
        }
        if gyro || accel {
            self.banks[0][usize::from(INT_STATUS)] |= DATA_RDY_INT;
            self.raise_line();
        }
        if gyro && accel {
            self.latest = Some(sample);
        }
    }
}

impl Chip {
    /// Applies the adaptive full-scale feature, which holds the gyroscope's registers.
    fn apply_adaptive_full_scale(&mut self, sample: &mut ImuSample, at_ns: u64) {
        let fast = sample.gyro.iter().any(|counts| counts.unsigned_abs() > ADAPTIVE_STEP_COUNTS);
        if fast != self.gyro_was_fast && self.setting(INTF_CONFIG1) >> 6 == 0b10 {
            self.gyro_held_until_ns = at_ns + ADAPTIVE_HOLD_NS;
        }
        self.gyro_was_fast = fast;
        if at_ns < self.gyro_held_until_ns
            && let Some(latest) = self.latest
        {
            sample.gyro = latest.gyro;
        }
    }

    /// Writes three counts into the registers from `first` on. Returns the counts as stored. Each step of the range code
    /// halves the range.
    fn write_counts(&mut self, first: u8, counts: [i16; 3], range: u8) -> [i16; 3] {
        let counts = counts.map(|axis| (i32::from(axis) << range).clamp(MIN_COUNT, 32_767) as i16);
        let big_endian = self.setting(INTF_CONFIG0) & 0x10 != 0;
        for (axis, count) in counts.iter().enumerate() {
            let bytes = if big_endian { count.to_be_bytes() } else { count.to_le_bytes() };
            self.banks[0][usize::from(first) + 2 * axis..][..2].copy_from_slice(&bytes);
        }
        counts
    }

    fn raise_line(&mut self) {
        if self.setting(INT_SOURCE0) & 0x08 == 0 {
            return;
        }
        if self.setting(INT_CONFIG1) & 0x10 != 0 {
            self.misuse.push(Misuse::AsyncReset);
        } else if self.setting(INT_CONFIG) & 0b111 == 0b011 {
            // Pulsed, push-pull, active high: with any other setting this board gets no rising edges.
            self.edges += 1;
        }
    }

    fn setting(&self, address: u8) -> u8 {
        self.banks[0][usize::from(address)]
    }

    fn read(&mut self, address: u8) -> u8 {
        let value = match (self.bank, address) {
            (_, REG_BANK_SEL) => self.bank,
            (0, WHO_AM_I) => self.schedule.faults.identity(self.schedule.clock.now_ns()).unwrap_or(IDENTITY),
            (bank @ 0..=4, _) => self.banks[usize::from(bank)][usize::from(address)],
            _ => 0,
        };
        if (self.bank, address) == (0, INT_STATUS) {
            self.banks[0][usize::from(INT_STATUS)] = 0;
        }
        value
    }

    fn write(&mut self, address: u8, value: u8) {
        let now_ns = self.schedule.clock.now_ns();
        if self.mode_ns.is_some_and(|mode_ns| now_ns < mode_ns + MODE_CHANGE_NS) {
            self.misuse.push(Misuse::ModeChanging);
        }
        if address == REG_BANK_SEL {
            self.bank = value & 0b111;
            return;
        }
        let known = RESET_VALUES.iter().any(|(bank, known, _)| (*bank, *known) == (self.bank, address));
        if !known || self.schedule.faults.is_stuck(now_ns, self.bank, address) {
            return;
        }
        let any_time = [DEVICE_CONFIG, PWR_MGMT0, GYRO_CONFIG0, ACCEL_CONFIG0];
        let on = self.gyro_on_ns.is_some() || self.accel_on_ns.is_some();
        if on && !(self.bank == 0 && any_time.contains(&address)) {
            self.misuse.push(Misuse::Sampling);
        }
        self.banks[usize::from(self.bank)][usize::from(address)] = value;
        match (self.bank, address) {
            (0, DEVICE_CONFIG) if value & 0x01 != 0 => self.restart(now_ns),
            (0, PWR_MGMT0) => self.change_mode(value, now_ns),
            (0, GYRO_CONFIG0 | ACCEL_CONFIG0) if on => {
                self.schedule.next_sample_ns = self.period_ns().map(|period_ns| now_ns + period_ns);
            }
            _ => {}
        }
    }

    /// Changes the mode of both sensors. Low-noise mode is 0b11; every other mode counts as off.
    fn change_mode(&mut self, value: u8, now_ns: u64) {
        let switch = |since_ns: Option<u64>, on: bool| on.then(|| since_ns.unwrap_or(now_ns));
        let gyro_on_ns = switch(self.gyro_on_ns, value >> 2 & 0b11 == 0b11);
        if let (Some(since_ns), None) = (self.gyro_on_ns, gyro_on_ns)
            && now_ns < since_ns + GYRO_MIN_ON_NS
        {
            self.misuse.push(Misuse::OffTooEarly);
        }
        self.gyro_on_ns = gyro_on_ns;
        self.accel_on_ns = switch(self.accel_on_ns, value & 0b11 == 0b11);
        self.mode_ns = Some(now_ns);
        self.schedule.next_sample_ns = self.period_ns().map(|period_ns| now_ns + period_ns);
    }

    /// Exchanges one byte: returns the answer to the byte `sent`.
    fn exchange(&mut self, sent: u8) -> u8 {
        self.catch_up();
        let now_ns = self.schedule.clock.now_ns();
        let ready = now_ns >= self.ready_ns;
        // After an interruption of the supply, which the driver cannot see, an early access is not misuse.
        let driver_may_wait = self
            .schedule
            .supply_back_ns
            .is_none_or(|back_ns| self.ready_ns != back_ns.saturating_add(READY_NS));
        if !ready && driver_may_wait && matches!(self.frame, Frame::Address) {
            self.misuse.push(Misuse::NotReady);
        }
        let mut answer = 0;
        self.frame = match self.frame {
            Frame::Address if sent & 0x80 != 0 => Frame::Read(sent & 0x7f),
            Frame::Address => Frame::Write(sent),
            Frame::Read(address) => {
                if ready {
                    answer = self.read(address);
                }
                Frame::Read((address + 1) & 0x7f)
            }
            Frame::Write(address) => {
                if ready {
                    self.write(address, sent);
                }
                Frame::Written
            }
            Frame::Written => Frame::Written,
        };
        self.schedule.clock.advance_ns(BYTE_NS);
        self.line.unwrap_or(answer)
    }
}

impl ErrorType for Icm42688p {
    type Error = ErrorKind;
}

impl SpiDevice for Icm42688p {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), ErrorKind> {
        let mut chip = self.now();
        let now_ns = chip.schedule.clock.now_ns();
        if chip.schedule.faults.next_transaction_fails(now_ns) {
            return Err(ErrorKind::Other);
        }
        chip.line = chip.schedule.faults.no_answer(now_ns);
        chip.frame = Frame::Address;
        for operation in operations {
            match operation {
                Operation::Read(received) => received.fill_with(|| chip.exchange(0)),
                Operation::Write(sent) => sent.iter().for_each(|byte| {
                    chip.exchange(*byte);
                }),
                Operation::Transfer(received, sent) => {
                    for n in 0..received.len().max(sent.len()) {
                        let answer = chip.exchange(sent.get(n).copied().unwrap_or(0));
                        if let Some(byte) = received.get_mut(n) {
                            *byte = answer;
                        }
                    }
                }
                Operation::TransferInPlace(bytes) => {
                    bytes.iter_mut().for_each(|byte| *byte = chip.exchange(*byte));
                }
                Operation::DelayNs(ns) => chip.schedule.clock.advance_ns(u64::from(*ns)),
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;
    const SAMPLE: ImuSample = ImuSample { gyro: [100, -200, 300], accel: [-1_000, 2_000, -3_000] };

    /// Returns a ready chip that always takes the same sample.
    fn chip() -> (Clock, Icm42688p) {
        let clock = Clock::default();
        let chip = Icm42688p::new(&clock, Box::new(|_| SAMPLE));
        clock.advance_ns(MS);
        (clock, chip)
    }

    fn write(chip: &Icm42688p, address: u8, value: u8) {
        chip.clone().write(&[address, value]).unwrap();
    }

    fn read<const N: usize>(chip: &Icm42688p, address: u8) -> [u8; N] {
        let mut values = [0; N];
        let mut operations = [Operation::Write(&[0x80 | address]), Operation::Read(&mut values)];
        chip.clone().transaction(&mut operations).unwrap();
        values
    }

    #[test]
    fn range_scales_the_counts() {
        for (code, factor) in [(0, 1), (1, 2), (2, 4), (3, 8)] {
            let (clock, chip) = chip();
            write(&chip, GYRO_CONFIG0, code << 5 | 6);
            write(&chip, ACCEL_CONFIG0, code << 5 | 6);
            write(&chip, PWR_MGMT0, 0x0f);
            clock.advance_ns(50 * MS);
            let ImuSample { gyro, accel } = SAMPLE;
            let scaled = ImuSample { gyro: gyro.map(|n| n * factor), accel: accel.map(|n| n * factor) };
            assert_eq!(chip.latest(), Some(scaled));
            assert_eq!(read(&chip, ACCEL_DATA_X1), scaled.accel[0].to_be_bytes());
        }
    }

    #[test]
    fn rate_sets_the_period() {
        for (code, period_ns) in
            [(1, 31_250), (3, 125_000), (6, MS), (15, 2 * MS), (7, 5 * MS), (11, 80 * MS)]
        {
            let (clock, chip) = chip();
            write(&chip, GYRO_CONFIG0, code);
            write(&chip, ACCEL_CONFIG0, code);
            write(&chip, PWR_MGMT0, 0x0f);
            let first_ns = chip.next_sample_ns().unwrap();
            clock.advance_ns(first_ns - clock.now_ns());
            assert_eq!(chip.next_sample_ns(), Some(first_ns + period_ns));
        }
    }

    #[test]
    fn data_is_invalid_until_the_sensors_have_started() {
        let (clock, chip) = chip();
        assert_eq!(read(&chip, INT_STATUS), [RESET_DONE_INT]);
        write(&chip, PWR_MGMT0, 0x0f);
        for (after_ms, accel, gyro) in [(5, false, false), (20, true, false), (40, true, true)] {
            clock.advance_ns(after_ms * MS - (clock.now_ns() - MS));
            assert_eq!(read(&chip, ACCEL_DATA_X1) != [0x80, 0x00], accel, "after {after_ms} ms");
            assert_eq!(read(&chip, GYRO_DATA_X1) != [0x80, 0x00], gyro, "after {after_ms} ms");
            assert_eq!(read(&chip, INT_STATUS), [if accel { DATA_RDY_INT } else { 0 }]);
            assert_eq!(read(&chip, INT_STATUS), [0], "reading clears it");
        }
    }

    #[test]
    fn each_bank_has_its_own_registers() {
        let (_, chip) = chip();
        write(&chip, REG_BANK_SEL, 1);
        write(&chip, 0x0d, 36);
        write(&chip, WHO_AM_I, 36);
        assert_eq!((read(&chip, 0x0d), read(&chip, WHO_AM_I)), ([36], [0]));
        write(&chip, REG_BANK_SEL, 0);
        assert_eq!((read(&chip, 0x0d), read(&chip, WHO_AM_I)), ([0], [IDENTITY]));
    }

    #[test]
    fn forbidden_accesses_are_recorded_as_misuse() {
        let misuse = |drive: fn(&Clock, &Icm42688p)| {
            let (clock, chip) = chip();
            drive(&clock, &chip);
            chip.misuse()
        };
        let early = |_: &Clock, chip: &Icm42688p| {
            write(chip, DEVICE_CONFIG, 0x01);
            assert_eq!(read(chip, WHO_AM_I), [0]);
        };
        assert_eq!(misuse(early), [Misuse::NotReady]);
        let hasty = |clock: &Clock, chip: &Icm42688p| {
            write(chip, PWR_MGMT0, 0x0f);
            clock.advance_ns(190_000);
            write(chip, GYRO_CONFIG0, 0x05);
        };
        assert_eq!(misuse(hasty), [Misuse::ModeChanging]);
        let running = |clock: &Clock, chip: &Icm42688p| {
            write(chip, PWR_MGMT0, 0x0f);
            clock.advance_ns(MS);
            write(chip, INT_CONFIG, 0x03);
        };
        assert_eq!(misuse(running), [Misuse::Sampling]);
        let short = |clock: &Clock, chip: &Icm42688p| {
            write(chip, PWR_MGMT0, 0x0f);
            clock.advance_ns(44 * MS);
            write(chip, PWR_MGMT0, 0x00);
        };
        assert_eq!(misuse(short), [Misuse::OffTooEarly]);
        let line = |clock: &Clock, chip: &Icm42688p| {
            write(chip, INT_SOURCE0, 0x08);
            write(chip, PWR_MGMT0, 0x0f);
            clock.advance_ns(10 * MS);
            assert_eq!(chip.data_ready_edges(), 0);
        };
        assert_eq!(misuse(line), [Misuse::AsyncReset]);
    }
}
