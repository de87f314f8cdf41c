//! Model of the QMC5883L: magnetometer on I2C.
//!
//! Source: QST's datasheet 1.0 (February 2016). Section numbers and quoted rules are those that the crate `rigless` 0.3
//! (`chip/qmc5883l.rs`) cites. The data-ready line, the temperature and pointer roll-over are not modelled, because the
//! driver does not use them.
//!
//! | subject | in the datasheet |
//! |---|---|
//! | address (5.4) | 0x0d; the chip acknowledges no other address |
//! | power-up (table 7) | the chip acknowledges nothing for 350 µs; then standby |
//! | access (8.2) | a write sets the pointer, then registers; reads continue from the pointer |
//! | DRDY (9.2.2) | set by a sample, cleared by reading a data register |
//! | data protection (6.2.1) | from the first read of a data register to that of 05H, samples are lost |
//! | DOR (9.2.2) | set if a sample is lost or overwrites one that was not read, cleared by reading a data register |
//! | OVL (9.2.2) | set while an axis is beyond 16 bits |
//! | SOFT_RST (9.2.4) | resets every register to its value after power-up |
//!
//! The datasheet does not specify these points, so the model assumes:
//! - A soft reset takes as long as power-up.
//! - The first sample comes one period after continuous mode is set.

use std::cell::RefCell;
use std::rc::Rc;

use embedded_hal::i2c::{ErrorKind, ErrorType, I2c, NoAcknowledgeSource, Operation};
use flight_core::sample::MagSample;

use super::{Clock, Fault, Misuse, Sampling, Schedule};

const ADDRESS: u8 = 0x0d;
const DATA_LAST: u8 = 0x05;
const STATUS: u8 = 0x06;
const CONTROL_1: u8 = 0x09;
const CONTROL_2: u8 = 0x0a;
const SET_RESET_PERIOD: u8 = 0x0b;
const CHIP_ID: u8 = 0x0d;

const IDENTITY: u8 = 0xff;
const DRDY: u8 = 0x01;
const OVL: u8 = 0x02;
const DOR: u8 = 0x04;
const SOFT_RST: u8 = 0x80;
/// The writable bits of CONTROL_2: roll-over and interrupt.
const CONTROL_2_KEPT: u8 = 0x41;
const READY_NS: u64 = 350_000;
/// Sample periods by the code of the data rate, ns.
const PERIOD_NS: [u64; 4] = [100_000_000, 20_000_000, 10_000_000, 5_000_000];

/// Time of a byte and its acknowledgement on the bus at 400 kHz, ns.
const BYTE_NS: u64 = 22_500;

/// The source of samples: returns the counts at a time, ns, for the range ±8 G. Counts beyond 16 bits are out of range.
pub type Source = Box<dyn FnMut(u64) -> [i32; 3]>;

/// A handle on the chip: the bus device for the driver, and the interface for the test.
#[derive(Clone)]
pub struct Qmc5883l(Rc<RefCell<Chip>>);

impl Qmc5883l {
    /// Creates a chip whose supply comes up now.
    pub fn new(clock: &Clock, source: Source) -> Self {
        let mut chip = Chip {
            schedule: Schedule::new(clock),
            source,
            misuse: vec![],
            registers: [0; 14],
            pointer: 0,
            locked: false,
            ready_ns: 0,
            latest: None,
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
    pub fn register(&self, address: u8) -> u8 {
        self.now().registers[usize::from(address)]
    }

    /// Returns the sample in the data registers, at the configured scale.
    pub fn latest(&self) -> Option<MagSample> {
        self.now().latest
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

struct Chip {
    schedule: Schedule,
    source: Source,
    misuse: Vec<Misuse>,
    registers: [u8; 14],
    pointer: u8,
    /// Data protection: true if a data register has been read, but not yet the last of them.
    locked: bool,
    ready_ns: u64,
    latest: Option<MagSample>,
    /// Value of each byte while the data line is disconnected.
    line: Option<u8>,
}

impl Sampling for Chip {
    fn schedule(&mut self) -> &mut Schedule {
        &mut self.schedule
    }

    fn restart(&mut self, at_ns: u64) {
        self.registers = [0; 14];
        self.registers[usize::from(CHIP_ID)] = IDENTITY;
        self.pointer = 0;
        self.locked = false;
        self.ready_ns = at_ns.saturating_add(READY_NS);
        self.schedule.next_sample_ns = None;
        self.latest = None;
    }

    fn period_ns(&self) -> Option<u64> {
        let control = self.registers[usize::from(CONTROL_1)];
        (control & 0b11 == 0b01).then(|| PERIOD_NS[usize::from(control >> 2 & 0b11)])
    }

    // Data protection loses the sample while the data registers are being read.
    fn store_sample(&mut self, at_ns: u64) {
        let status = self.registers[usize::from(STATUS)];
        if self.locked {
            self.registers[usize::from(STATUS)] = status | DOR;
            return;
        }
        // The range ±2 G has four times the counts of ±8 G.
        let scale = if self.registers[usize::from(CONTROL_1)] & 0x10 == 0 { 4 } else { 1 };
        let counts = (self.source)(at_ns).map(|axis| axis * scale);
        let ends = i32::from(i16::MIN)..=i32::from(i16::MAX);
        let overflow = if counts.iter().all(|axis| ends.contains(axis)) { 0 } else { OVL };
        let flushed = if status & DRDY == 0 { 0 } else { DOR };
        self.registers[usize::from(STATUS)] = DRDY | overflow | (status & DOR) | flushed;
        let counts = counts.map(|axis| axis.clamp(*ends.start(), *ends.end()) as i16);
        for (axis, count) in counts.iter().enumerate() {
            self.registers[2 * axis..][..2].copy_from_slice(&count.to_le_bytes());
        }
        self.latest = Some(MagSample { counts });
    }
}

impl Chip {
    fn read_next(&mut self) -> u8 {
        self.catch_up();
        let now_ns = self.schedule.clock.now_ns();
        let address = self.pointer;
        self.pointer = self.pointer.wrapping_add(1);
        self.schedule.clock.advance_ns(BYTE_NS);
        if let Some(reads) = self.line {
            return reads;
        }
        if now_ns < self.ready_ns {
            // The supply failed after the chip had acknowledged its address, so the line stays high.
            return 0xff;
        }
        let value = match address {
            CHIP_ID => self.schedule.faults.identity(now_ns).unwrap_or(IDENTITY),
            _ => self.registers.get(usize::from(address)).copied().unwrap_or(0),
        };
        if address <= DATA_LAST {
            if !self.locked {
                self.registers[usize::from(STATUS)] &= !(DRDY | DOR);
            }
            self.locked = address != DATA_LAST;
        }
        value
    }

    fn write_next(&mut self, value: u8) {
        self.catch_up();
        let now_ns = self.schedule.clock.now_ns();
        let address = self.pointer;
        self.pointer = self.pointer.wrapping_add(1);
        self.schedule.clock.advance_ns(BYTE_NS);
        if self.schedule.faults.is_stuck(now_ns, 0, address) {
            return;
        }
        match address {
            CONTROL_2 if value & SOFT_RST != 0 => self.restart(self.schedule.clock.now_ns()),
            CONTROL_2 => self.registers[usize::from(CONTROL_2)] = value & CONTROL_2_KEPT,
            SET_RESET_PERIOD => self.registers[usize::from(SET_RESET_PERIOD)] = value,
            CONTROL_1 => {
                self.registers[usize::from(CONTROL_1)] = value;
                self.schedule.next_sample_ns = self.period_ns().map(|period_ns| now_ns + period_ns);
            }
            _ => {}
        }
    }

    /// Returns true if the chip acknowledges this address now.
    fn acknowledges(&mut self, address: u8) -> bool {
        let now_ns = self.schedule.clock.now_ns();
        self.schedule.clock.advance_ns(BYTE_NS);
        let ready = now_ns >= self.ready_ns;
        // After an interruption of the supply, which the driver cannot see, an early access is not misuse.
        let driver_may_wait = self
            .schedule
            .supply_back_ns
            .is_none_or(|back_ns| self.ready_ns != back_ns.saturating_add(READY_NS));
        if !ready && driver_may_wait && address == ADDRESS {
            self.misuse.push(Misuse::NotReady);
        }
        let fails = self.schedule.faults.next_transaction_fails(now_ns);
        self.line = self.schedule.faults.no_answer(now_ns);
        match self.line {
            None => ready && address == ADDRESS && !fails,
            // A low line acknowledges any address.
            Some(reads) => reads == 0,
        }
    }
}

impl ErrorType for Qmc5883l {
    type Error = ErrorKind;
}

impl I2c for Qmc5883l {
    fn transaction(&mut self, address: u8, operations: &mut [Operation<'_>]) -> Result<(), ErrorKind> {
        let mut chip = self.now();
        if !chip.acknowledges(address) {
            return Err(ErrorKind::NoAcknowledge(NoAcknowledgeSource::Address));
        }
        for operation in operations {
            match operation {
                Operation::Read(received) => {
                    // A repeated start sends the address again, to change the direction.
                    chip.schedule.clock.advance_ns(BYTE_NS);
                    received.fill_with(|| chip.read_next());
                }
                Operation::Write(sent) => {
                    if let [first, values @ ..] = sent {
                        chip.pointer = *first;
                        chip.schedule.clock.advance_ns(BYTE_NS);
                        values.iter().for_each(|value| chip.write_next(*value));
                    }
                }
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a ready chip that always takes the same sample.
    fn chip() -> (Clock, Qmc5883l) {
        let clock = Clock::default();
        let chip = Qmc5883l::new(&clock, Box::new(|_| [1_000, -2_000, 9_000]));
        clock.advance_ns(READY_NS);
        (clock, chip)
    }

    #[test]
    fn range_and_rate_follow_the_configuration() {
        for (code, period_ns) in [(0, 100_000_000), (1, 20_000_000), (2, 10_000_000), (3, 5_000_000)] {
            let (clock, chip) = chip();
            chip.clone().write(ADDRESS, &[CONTROL_1, 0x10 | code << 2 | 1]).unwrap();
            let first_ns = chip.next_sample_ns().unwrap();
            clock.advance_ns(first_ns - clock.now_ns());
            assert_eq!(chip.latest(), Some(MagSample { counts: [1_000, -2_000, 9_000] }));
            assert_eq!(chip.next_sample_ns(), Some(first_ns + period_ns));
            assert_eq!(chip.register(STATUS), DRDY);
        }
        let (clock, chip) = chip();
        chip.clone().write(ADDRESS, &[CONTROL_1, 0x0d]).unwrap();
        clock.advance_ns(6_000_000);
        assert_eq!(chip.latest(), Some(MagSample { counts: [4_000, -8_000, i16::MAX] }), "±2 G");
        assert_eq!(chip.register(STATUS), DRDY | OVL);
    }

    #[test]
    fn ready_chip_acknowledges_its_address() {
        let (_, mut ready) = chip();
        assert_eq!(ready.write(ADDRESS, &[CHIP_ID]), Ok(()));
        assert!(ready.write(0x1e, &[CHIP_ID]).is_err());
        assert_eq!(ready.misuse(), []);
        let mut early = Qmc5883l::new(&Clock::default(), Box::new(|_| [0; 3]));
        assert!(early.write(ADDRESS, &[CHIP_ID]).is_err());
        assert_eq!(early.misuse(), [Misuse::NotReady]);
    }
}
