//! An I2C bus for sensors that may be missing, on wires that may be shorted or open.
//!
//! `stm32f4xx-hal` 0.23 waits for start, stop and address without a limit (`i2c.rs`, `prepare_write` and
//! `prepare_read`): a line held low would block its caller without end. Here every wait ends when the run's time is up.
//! The task starts that time with [`begin_run`].
//!
//! Reception follows RM0090, 27.3.3: the clock is stretched while two bytes wait, so no step must come within a byte's
//! time, and interrupts may come between any two steps. Only the reception of a single byte needs a few instructions
//! with interrupts disabled.

use core::marker::PhantomData;
use core::sync::atomic::{AtomicU32, Ordering};

use embedded_hal::delay::DelayNs;
use embedded_hal::i2c::{self, ErrorKind, ErrorType, I2c, NoAcknowledgeSource, Operation};
use stm32f4xx_hal::pac::i2c1;

use super::deadline::{Delay, now_us};
use super::pin::Pin;

/// Connections of the bus.
#[derive(Clone, Copy)]
pub struct Wiring {
    /// The bus's I2C peripheral.
    pub i2c: *const i2c1::RegisterBlock,
    /// The clock pin.
    pub scl: Pin,
    /// The data pin.
    pub sda: Pin,
}

/// A board's wiring as a type, so that its values are compile-time constants where they are used.
pub trait HasWiring {
    /// The wiring.
    const MAGNETOMETER: Wiring;
}

/// Time of one run on the bus, including its delays, µs.
const RUN_US: u32 = 4_000;
/// Bit rate, bit/s.
const RATE_HZ: u32 = 400_000;
/// Delay between two polls of the status, core cycles: one to two microseconds of the 22 µs that a byte takes. Polling
/// without a delay would load the peripheral bus, which the IMU's DMA shares, with no benefit.
const POLL_CYCLES: u32 = 200;

static RUN_BEGAN_US: AtomicU32 = AtomicU32::new(0);

/// Starts the run's time.
pub fn begin_run() {
    RUN_BEGAN_US.store(now_us(), Ordering::Relaxed);
}

/// Reason why an access failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BusError {
    /// No device acknowledges the address or the byte.
    NotAcknowledged,
    /// The run's time is up: a line is held low, or a wire is open.
    Timeout,
    /// Arbitration was lost: another device drives the lines.
    ArbitrationLost,
    /// Reads of zero or two bytes are not supported.
    Length,
}

impl i2c::Error for BusError {
    fn kind(&self) -> ErrorKind {
        match self {
            Self::NotAcknowledged => ErrorKind::NoAcknowledge(NoAcknowledgeSource::Unknown),
            Self::ArbitrationLost => ErrorKind::Bus,
            Self::Timeout | Self::Length => ErrorKind::Other,
        }
    }
}

/// The bus. All copies are the same bus: their task uses one at a time.
pub struct Bus<W> {
    /// Clock of APB1, MHz.
    apb1_mhz: u32,
    wiring: PhantomData<W>,
}

impl<W> Clone for Bus<W> {
    fn clone(&self) -> Self {
        Self { apb1_mhz: self.apb1_mhz, wiring: PhantomData }
    }
}

impl<W: HasWiring> Bus<W> {
    /// Sets up the bus. Its pins must be connected and its clock enabled.
    pub fn new(apb1_mhz: u32) -> Self {
        let bus = Self { apb1_mhz, wiring: PhantomData };
        bus.set_up();
        bus
    }

    /// Frees the data line, resets the peripheral and configures it: fast mode, low twice as long as high, rise time
    /// 300 ns.
    fn set_up(&self) {
        W::MAGNETOMETER.free_data_line();
        let regs = W::MAGNETOMETER.regs();
        regs.cr1().write(|w| w.swrst().set_bit());
        regs.cr1().reset();
        // SAFETY: APB1's clock in MHz is within the field's range; the other fields are computed here.
        unsafe {
            regs.cr2().write(|w| w.freq().bits(self.apb1_mhz as u8));
            regs.ccr()
                .write(|w| w.f_s().set_bit().ccr().bits((self.apb1_mhz * 1_000_000 / (3 * RATE_HZ)) as u16));
        }
        regs.trise().write(|w| w.trise().set((self.apb1_mhz * 300 / 1_000 + 1) as u8));
        regs.cr1().write(|w| w.pe().set_bit());
    }
}

fn check_time() -> Result<(), BusError> {
    let since_us = now_us().wrapping_sub(RUN_BEGAN_US.load(Ordering::Relaxed));
    if since_us > RUN_US { Err(BusError::Timeout) } else { Ok(()) }
}

impl Wiring {
    fn regs(&self) -> &'static i2c1::RegisterBlock {
        // SAFETY: only the task that owns the bus uses it.
        unsafe { &*self.i2c }
    }

    /// Frees the data line: a sensor that was interrupted in the middle of a byte may hold it low while it waits for
    /// the clock. The clock pin gives up to nine clocks, with which the sensor finishes the byte. Takes up to 0.1 ms.
    fn free_data_line(&self) {
        self.scl.set_high();
        self.scl.make_output();
        for _ in 0..9 {
            if !self.sda.is_low() {
                break;
            }
            self.scl.set_low();
            Delay.delay_us(5);
            self.scl.set_high();
            Delay.delay_us(5);
        }
        self.scl.make_alternate();
    }

    fn write(&self, address: u8, bytes: &[u8]) -> Result<(), BusError> {
        self.start(false)?;
        self.send_address(address << 1)?;
        self.regs().sr2().read();
        for byte in bytes {
            self.wait(|status| status.tx_e().bit_is_set())?;
            // SAFETY: the value is a byte.
            self.regs().dr().write(|w| unsafe { w.bits(u16::from(*byte)) });
        }
        self.wait(|status| status.btf().bit_is_set())
    }

    fn read(&self, address: u8, bytes: &mut [u8]) -> Result<(), BusError> {
        match bytes {
            [byte] => {
                self.start(false)?;
                self.send_address(address << 1 | 1)?;
                // The stop must be requested before the byte is complete.
                cortex_m::interrupt::free(|_| {
                    self.regs().sr2().read();
                    self.stop();
                });
                *byte = self.receive()?;
                Ok(())
            }
            [first @ .., third_last, second_last, last] => {
                self.start(true)?;
                self.send_address(address << 1 | 1)?;
                self.regs().sr2().read();
                for byte in first {
                    *byte = self.receive()?;
                }
                // Two bytes wait, and the clock is stretched. The next byte is the last.
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

    /// Waits until `done` is true of the status, an error occurs, or the run's time is up. A bus error is ignored,
    /// because the chip reports false ones (errata sheet ES0182, "Spurious bus error detection in master mode").
    fn wait(&self, done: impl Fn(&i2c1::sr1::R) -> bool) -> Result<(), BusError> {
        loop {
            let status = self.regs().sr1().read();
            if status.af().bit_is_set() {
                return Err(BusError::NotAcknowledged);
            }
            if status.arlo().bit_is_set() {
                return Err(BusError::ArbitrationLost);
            }
            if done(&status) {
                return Ok(());
            }
            check_time()?;
            cortex_m::asm::delay(POLL_CYCLES);
        }
    }

    fn start(&self, acknowledge: bool) -> Result<(), BusError> {
        // The register must not be written before the previous stop is finished.
        while self.regs().cr1().read().stop().bit_is_set() {
            check_time()?;
        }
        self.regs().cr1().modify(|_, w| w.start().set_bit().ack().bit(acknowledge));
        self.wait(|status| status.sb().bit_is_set())
    }

    fn send_address(&self, address: u8) -> Result<(), BusError> {
        // SAFETY: the value is a byte.
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
        let mut stop_sent = false;
        for operation in operations {
            result = match operation {
                Operation::Write(bytes) => {
                    stop_sent = false;
                    wiring.write(address, bytes)
                }
                Operation::Read(bytes) => {
                    stop_sent = true;
                    wiring.read(address, bytes)
                }
            };
            if result.is_err() {
                break;
            }
        }
        match result {
            Ok(()) if stop_sent => {}
            Ok(()) => wiring.stop(),
            // A missing acknowledge is common, and leaves the bus in a defined state.
            Err(BusError::NotAcknowledged) => {
                wiring.stop();
                wiring.regs().sr1().modify(|_, w| w.af().clear_bit());
            }
            // The peripheral may be in any state: set it up again.
            Err(_) => self.set_up(),
        }
        result
    }
}
