//! An I2C for sensors that may not be there, on wires that may be short or open.
//!
//! `stm32f4xx-hal` 0.23 waits for start, stop and address without a limit (`i2c.rs`, `prepare_write` and
//! `prepare_read`): a line that is held low would keep its caller for ever. Here every wait ends when the time of
//! the run is up, which the task sets with [`begin_run`].
//!
//! Reception is the method of RM0090, 27.3.3, in which the clock is stretched while two bytes wait: no step of it
//! has to come within a byte's time, so that interrupts may come between any two. A single byte is the exception,
//! and takes a few instructions with interrupts off.

use core::marker::PhantomData;
use core::sync::atomic::{AtomicU32, Ordering};

use embedded_hal::delay::DelayNs;
use embedded_hal::i2c::{self, ErrorKind, ErrorType, I2c, NoAcknowledgeSource, Operation};
use stm32f4xx_hal::pac::i2c1;

use super::deadline::{Wait, now_us};
use super::pin::Pin;

/// How the sensors are connected.
#[derive(Clone, Copy)]
pub struct Wiring {
    /// Their I2C.
    pub i2c: *const i2c1::RegisterBlock,
    /// Its clock.
    pub scl: Pin,
    /// Its data.
    pub sda: Pin,
}

/// A board's wiring as a type: so that all of it is constant where it is used.
pub trait HasWiring {
    /// It.
    const MAGNETOMETER: Wiring;
}

/// Time that a run has on the bus, its delays included, µs.
const RUN_US: u32 = 4_000;
/// Bits a second.
const RATE_HZ: u32 = 400_000;
/// From one look at the status to the next, cycles of the core: a microsecond or two, of the 22 µs that a byte takes.
/// Looking without a pause would load the peripheral bus, which the inertial sensor's DMA shares, and gain nothing.
const LOOK_CYCLES: u32 = 200;

static RUN_BEGAN_US: AtomicU32 = AtomicU32::new(0);

/// The bus's time begins to run.
pub fn begin_run() {
    RUN_BEGAN_US.store(now_us(), Ordering::Relaxed);
}

/// Why an access failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BusError {
    /// Nobody answers at the address, or takes the byte.
    NotAcknowledged,
    /// The run's time is up: a line is held, or a wire is off.
    TimeUp,
    /// Somebody else pulls at the lines.
    Disturbed,
    /// Two bytes cannot be read, nor none.
    Length,
}

impl i2c::Error for BusError {
    fn kind(&self) -> ErrorKind {
        match self {
            Self::NotAcknowledged => ErrorKind::NoAcknowledge(NoAcknowledgeSource::Unknown),
            Self::Disturbed => ErrorKind::Bus,
            Self::TimeUp | Self::Length => ErrorKind::Other,
        }
    }
}

/// The bus. Its copies are one bus: the task that has them uses one at a time.
pub struct Bus<W> {
    /// APB1's clock.
    apb1_mhz: u32,
    wiring: PhantomData<W>,
}

impl<W> Clone for Bus<W> {
    fn clone(&self) -> Self {
        Self { apb1_mhz: self.apb1_mhz, wiring: PhantomData }
    }
}

impl<W: HasWiring> Bus<W> {
    /// The bus, whose pins are connected, and whose clock is that of APB1.
    pub fn new(apb1_mhz: u32) -> Self {
        let bus = Self { apb1_mhz, wiring: PhantomData };
        bus.set_up();
        bus
    }

    /// Frees the data line, resets the peripheral and sets it up: fast mode, low twice as long as high, rise time
    /// 300 ns.
    fn set_up(&self) {
        W::MAGNETOMETER.free_data_line();
        let regs = W::MAGNETOMETER.regs();
        regs.cr1().write(|w| w.swrst().set_bit());
        regs.cr1().reset();
        // SAFETY: APB1's clock in MHz, within the field's range; the other fields as computed here.
        unsafe {
            regs.cr2().write(|w| w.freq().bits(self.apb1_mhz as u8));
            regs.ccr()
                .write(|w| w.f_s().set_bit().ccr().bits((self.apb1_mhz * 1_000_000 / (3 * RATE_HZ)) as u16));
        }
        regs.trise().write(|w| w.trise().set((self.apb1_mhz * 300 / 1_000 + 1) as u8));
        regs.cr1().write(|w| w.pe().set_bit());
    }
}

fn in_time() -> Result<(), BusError> {
    let since_us = now_us().wrapping_sub(RUN_BEGAN_US.load(Ordering::Relaxed));
    if since_us > RUN_US { Err(BusError::TimeUp) } else { Ok(()) }
}

impl Wiring {
    fn regs(&self) -> &'static i2c1::RegisterBlock {
        // SAFETY: only the task that has the bus uses it.
        unsafe { &*self.i2c }
    }

    /// A sensor that was cut off in the middle of a byte may hold the data line, waiting for the clock: it gets the
    /// clocks to finish, up to nine, from the pin itself. Takes up to 0.1 ms.
    fn free_data_line(&self) {
        self.scl.set_high();
        self.scl.make_output();
        for _ in 0..9 {
            if !self.sda.is_low() {
                break;
            }
            self.scl.set_low();
            Wait.delay_us(5);
            self.scl.set_high();
            Wait.delay_us(5);
        }
        self.scl.make_alternate();
    }

    fn write(&self, address: u8, bytes: &[u8]) -> Result<(), BusError> {
        self.start(false)?;
        self.send_address(address << 1)?;
        self.regs().sr2().read();
        for byte in bytes {
            self.wait(|status| status.tx_e().bit_is_set())?;
            // SAFETY: a byte.
            self.regs().dr().write(|w| unsafe { w.bits(u16::from(*byte)) });
        }
        self.wait(|status| status.btf().bit_is_set())
    }

    fn read(&self, address: u8, bytes: &mut [u8]) -> Result<(), BusError> {
        match bytes {
            [only] => {
                self.start(false)?;
                self.send_address(address << 1 | 1)?;
                // The end must be ordered before the byte is complete.
                cortex_m::interrupt::free(|_| {
                    self.regs().sr2().read();
                    self.stop();
                });
                *only = self.receive()?;
                Ok(())
            }
            [first @ .., third_last, second_last, last] => {
                self.start(true)?;
                self.send_address(address << 1 | 1)?;
                self.regs().sr2().read();
                for byte in first {
                    *byte = self.receive()?;
                }
                // Two bytes wait, and the clock stands. The next one is the last.
                self.wait(|status| status.btf().bit_is_set())?;
                self.regs().cr1().modify(|_, w| w.ack().clear_bit());
                *third_last = self.regs().dr().read().bits() as u8;
                self.wait(|status| status.btf().bit_is_set())?;
                self.stop();
                *second_last = self.regs().dr().read().bits() as u8;
                *last = self.receive()?;
                Ok(())
            }
            _ => Err(BusError::Length),
        }
    }

    /// Waits for `done` of the status; ends at an error, and when the run's time is up. A bus error is no error: the
    /// chip sees some that are none (errata sheet ES0182, "Spurious bus error detection in master mode").
    fn wait(&self, done: impl Fn(&i2c1::sr1::R) -> bool) -> Result<(), BusError> {
        loop {
            let status = self.regs().sr1().read();
            if status.af().bit_is_set() {
                return Err(BusError::NotAcknowledged);
            }
            if status.arlo().bit_is_set() {
                return Err(BusError::Disturbed);
            }
            if done(&status) {
                return Ok(());
            }
            in_time()?;
            cortex_m::asm::delay(LOOK_CYCLES);
        }
    }

    fn start(&self, acknowledge: bool) -> Result<(), BusError> {
        // The register must not be written to before the last stop is through.
        while self.regs().cr1().read().stop().bit_is_set() {
            in_time()?;
        }
        self.regs().cr1().modify(|_, w| w.start().set_bit().ack().bit(acknowledge));
        self.wait(|status| status.sb().bit_is_set())
    }

    fn send_address(&self, address: u8) -> Result<(), BusError> {
        // SAFETY: a byte.
        self.regs().dr().write(|w| unsafe { w.bits(u16::from(address)) });
        self.wait(|status| status.addr().bit_is_set())
    }

    fn stop(&self) {
        self.regs().cr1().modify(|_, w| w.stop().set_bit());
    }

    fn receive(&self) -> Result<u8, BusError> {
        self.wait(|status| status.rx_ne().bit_is_set())?;
        Ok(self.regs().dr().read().bits() as u8)
    }
}

impl<W> ErrorType for Bus<W> {
    type Error = BusError;
}

impl<W: HasWiring> I2c for Bus<W> {
    fn transaction(&mut self, address: u8, operations: &mut [Operation<'_>]) -> Result<(), BusError> {
        let wiring = W::MAGNETOMETER;
        let mut result = Ok(());
        let mut ends_itself = false;
        for operation in operations {
            result = match operation {
                Operation::Write(bytes) => {
                    ends_itself = false;
                    wiring.write(address, bytes)
                }
                Operation::Read(bytes) => {
                    ends_itself = true;
                    wiring.read(address, bytes)
                }
            };
            if result.is_err() {
                break;
            }
        }
        match result {
            Ok(()) if ends_itself => {}
            Ok(()) => wiring.stop(),
            // An answer that does not come is common, and leaves the bus in order.
            Err(BusError::NotAcknowledged) => {
                wiring.stop();
                wiring.regs().sr1().modify(|_, w| w.af().clear_bit());
            }
            // Whatever state the peripheral is in, it begins anew.
            Err(_) => self.set_up(),
        }
        result
    }
}
