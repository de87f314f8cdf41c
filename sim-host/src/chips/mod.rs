//! Register-level models of chips, for tests of drivers.
//!
//! In a simulated flight a sample is counts. On a board it is bytes in registers, behind a bus that may fail, in a
//! chip that may be the wrong one, not be ready, or have lost its supply. These models simulate that part through
//! embedded-hal's traits, so that tests run the same drivers as the firmware.
//!
//! A model answers as the datasheet says, and records as [`Misuse`] what the datasheet forbids. Where the datasheet
//! does not say anything, the model assumes the worst case for the driver, and its documentation says so.
//!
//! Time is a [`Clock`], in integer nanoseconds. The test, the driver's delays and every byte on a bus advance it. At
//! every access a chip catches up with the clock: it takes the samples that have become due, each for its own time,
//! from the closure that it was created with.

pub mod icm42688p;
pub mod qmc5883l;

use std::cell::Cell;
use std::ops::Range;
use std::rc::Rc;

use embedded_hal::delay::DelayNs;

/// The time, ns, shared by chips, buses and delays.
#[derive(Clone, Debug, Default)]
pub struct Clock(Rc<Cell<u64>>);

impl Clock {
    /// Returns the time since the start, ns.
    pub fn now_ns(&self) -> u64 {
        self.0.get()
    }

    /// Advances the time.
    pub fn advance_ns(&self, ns: u64) {
        self.0.set(self.0.get() + ns);
    }
}

impl DelayNs for Clock {
    fn delay_ns(&mut self, ns: u32) {
        self.advance_ns(ns.into());
    }
}

/// A fault of a chip or its bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// Every nth transaction, counted from the chip's first, fails. On I2C the address is not acknowledged.
    Bus {
        /// The period n, transactions.
        every: u32,
    },
    /// The data line is disconnected for transactions that begin during the fault: every byte reads the same value. On
    /// I2C a high line never acknowledges, so only a low line gives any data.
    NoAnswer {
        /// The value of each byte: 0x00 or 0xff, for a line that is pulled low or high.
        reads: u8,
    },
    /// The supply is off. When it comes back, the chip restarts.
    NoPower,
    /// The identity register reads this value.
    Identity(u8),
    /// A register ignores writes.
    StuckRegister {
        /// Bank of the register, 0 in a chip without banks.
        bank: u8,
        /// Address of the register.
        address: u8,
    },
    /// The chip takes no samples: its registers keep their contents.
    Stalled,
}

/// An action of a driver that the datasheet forbids.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Misuse {
    /// An access before the chip was ready, after power-up or a reset.
    NotReady,
    /// A write within the time after a change of mode in which writes are forbidden.
    ModeChanging,
    /// A change of a setting that must not change while the sensors are on.
    Sampling,
    /// Switching a sensor off before its minimum on-time.
    OffTooEarly,
    /// Use of the data-ready line without clearing INT_ASYNC_RESET, which the datasheet requires.
    AsyncReset,
}

/// The faults of a chip, each with its time range.
#[derive(Debug, Default)]
struct Faults {
    list: Vec<(Range<u64>, Fault)>,
    transactions: u32,
}

impl Faults {
    /// Returns the first result of `pick` for the faults at this time.
    fn find<T>(&self, at_ns: u64, pick: impl Fn(Fault) -> Option<T>) -> Option<T> {
        self.list.iter().filter(|(during, _)| during.contains(&at_ns)).find_map(|(_, fault)| pick(*fault))
    }

    fn stalled(&self, at_ns: u64) -> bool {
        self.find(at_ns, |fault| (fault == Fault::Stalled).then_some(())).is_some()
    }

    fn identity(&self, at_ns: u64) -> Option<u8> {
        self.find(at_ns, |fault| if let Fault::Identity(reads) = fault { Some(reads) } else { None })
    }

    fn no_answer(&self, at_ns: u64) -> Option<u8> {
        self.find(at_ns, |fault| if let Fault::NoAnswer { reads } = fault { Some(reads) } else { None })
    }

    fn is_stuck(&self, at_ns: u64, bank: u8, address: u8) -> bool {
        self.find(at_ns, |fault| (fault == Fault::StuckRegister { bank, address }).then_some(())).is_some()
    }

    /// Counts a transaction that begins now. Returns true if it fails.
    fn next_transaction_fails(&mut self, at_ns: u64) -> bool {
        self.transactions += 1;
        let every =
            self.find(at_ns, |fault| if let Fault::Bus { every } = fault { Some(every) } else { None });
        every.is_some_and(|every| self.transactions.is_multiple_of(every))
    }

    /// Returns the last interruption of the supply that had begun by this time.
    fn power_cut(&self, by_ns: u64) -> Option<Range<u64>> {
        let cuts =
            self.list.iter().filter(|(during, fault)| *fault == Fault::NoPower && during.start <= by_ns);
        cuts.map(|(during, _)| during.clone()).max_by_key(|during| during.end)
    }
}

/// The sampling times and the faults of a chip.
struct Schedule {
    clock: Clock,
    faults: Faults,
    /// End of the last interruption of the supply, ns; it may be in the future.
    supply_back_ns: Option<u64>,
    next_sample_ns: Option<u64>,
}

impl Schedule {
    fn new(clock: &Clock) -> Self {
        Self { clock: clock.clone(), faults: Faults::default(), supply_back_ns: None, next_sample_ns: None }
    }
}

/// The common behaviour of the chips: they take samples when these are due, and restart when the supply comes back.
trait Sampling {
    fn schedule(&mut self) -> &mut Schedule;

    /// Sets the state after a power-up or a reset at this time.
    fn restart(&mut self, at_ns: u64);

    /// Returns the sample period of the present configuration, ns, if the chip samples.
    fn period_ns(&self) -> Option<u64>;

    /// Stores the sample of this time in the registers.
    fn store_sample(&mut self, at_ns: u64);

    /// Handles everything that has become due.
    fn catch_up(&mut self) {
        let Schedule { clock, faults, supply_back_ns, .. } = self.schedule();
        let now_ns = clock.now_ns();
        if let Some(cut) = faults.power_cut(now_ns)
            && supply_back_ns.is_none_or(|back_ns| cut.end > back_ns)
        {
            *supply_back_ns = Some(cut.end);
            self.sample_until(cut.start);
            self.restart(cut.end);
        }
        self.sample_until(now_ns);
    }

    fn sample_until(&mut self, until_ns: u64) {
        while let Some(due_ns) = self.schedule().next_sample_ns
            && due_ns <= until_ns
        {
            self.schedule().next_sample_ns = self.period_ns().map(|period_ns| due_ns + period_ns);
            if !self.schedule().faults.stalled(due_ns) {
                self.store_sample(due_ns);
            }
        }
    }
}
