//! Chips, register by register: what a driver meets at the other end of its bus.
//!
//! Here a scene's samples are counts; on a board they are bytes in registers, behind a bus that may fail, in
//! a chip that may not be the right one, not be ready, or have lost its supply. These models play that other
//! half, through embedded-hal's traits, so that the drivers that fly are the ones under test.
//!
//! A model answers as the datasheet says, and counts as [`Misuse`] what the datasheet forbids. Where the
//! datasheet is silent it does what is worst for the driver, and its documentation says so.
//!
//! Time is a [`Clock`], integer nanoseconds. Whoever plays the world advances it; so do the driver's delays
//! and every byte on a bus. A chip catches up with it whenever it is looked at: samples that fell due are
//! taken, each at its own time, from the closure that the chip was made with.

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
    /// Time since the start, ns.
    pub fn now_ns(&self) -> u64 {
        self.0.get()
    }

    /// Lets time pass.
    pub fn advance_ns(&self, ns: u64) {
        self.0.set(self.0.get() + ns);
    }
}

impl DelayNs for Clock {
    fn delay_ns(&mut self, ns: u32) {
        self.advance_ns(ns.into());
    }
}

/// What can be wrong with a chip or its bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// Every nth transaction, counted from the chip's first, fails. On I2C the address is not acknowledged.
    Bus {
        /// n.
        every: u32,
    },
    /// Transactions that begin meanwhile find the data line torn off: every byte reads this. On I2C, where a
    /// line that is high acknowledges nothing, only a line that is low reads anything.
    NoAnswer {
        /// 0x00 or 0xff, as the line is pulled.
        reads: u8,
    },
    /// The supply is gone. When it comes back, the chip starts anew.
    NoPower,
    /// The identity register reads this.
    Identity(u8),
    /// A register does not take what is written to it.
    StuckRegister {
        /// Its bank, 0 in a chip without banks.
        bank: u8,
        /// Its address.
        address: u8,
    },
    /// The chip takes no samples: its registers keep what they hold.
    Stalled,
}

/// What a driver did that the datasheet forbids.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Misuse {
    /// Accessed before the chip was ready, after its supply came up or it was reset.
    NotReady,
    /// Written to within the time for which a change of mode must be left alone.
    ModeChanging,
    /// A setting changed that must not be while the sensors are on.
    Sampling,
    /// Switched off before the shortest time for which it must stay on.
    OffTooEarly,
    /// The data-ready line used without clearing the bit that must be cleared for it.
    AsyncReset,
}

/// The faults of a chip, and when each of them is.
#[derive(Debug, Default)]
struct Faults {
    list: Vec<(Range<u64>, Fault)>,
    transactions: u32,
}

impl Faults {
    /// The first of the faults at this time for which `pick` has an answer.
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

    /// Whether the transaction that begins now fails.
    fn next_transaction_fails(&mut self, at_ns: u64) -> bool {
        self.transactions += 1;
        let every =
            self.find(at_ns, |fault| if let Fault::Bus { every } = fault { Some(every) } else { None });
        every.is_some_and(|every| self.transactions.is_multiple_of(every))
    }

    /// The last cut of the supply that had begun by this time.
    fn power_cut(&self, by_ns: u64) -> Option<Range<u64>> {
        let cuts =
            self.list.iter().filter(|(during, fault)| *fault == Fault::NoPower && during.start <= by_ns);
        cuts.map(|(during, _)| during.clone()).max_by_key(|during| during.end)
    }
}

/// When a chip samples, and what is wrong with it.
struct Schedule {
    clock: Clock,
    faults: Faults,
    /// When the supply came back, or will, after its last cut.
    supply_back_ns: Option<u64>,
    next_sample_ns: Option<u64>,
}

impl Schedule {
    fn new(clock: &Clock) -> Self {
        Self { clock: clock.clone(), faults: Faults::default(), supply_back_ns: None, next_sample_ns: None }
    }
}

/// What every chip here does alike: it takes samples as they fall due, and starts anew when its supply comes back.
trait Sampling {
    fn schedule(&mut self) -> &mut Schedule;

    /// Everything as after power-up or a reset that happens at this time.
    fn restart(&mut self, at_ns: u64);

    /// From one sample to the next, as it is set up.
    fn period_ns(&self) -> Option<u64>;

    /// Puts the sample of this time into the registers.
    fn land(&mut self, at_ns: u64);

    /// Does what fell due.
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
                self.land(due_ns);
            }
        }
    }
}
