//! USART6, connected to a serial port of the host.

use stm32f4xx_hal::pac::{USART6, usart1::RegisterBlock};

use crate::board::simulated::chip::USART6_HZ;

/// Baud rate, bit/s: the same as in `sim-host`.
const BAUD: u32 = 921_600;

/// The port.
pub struct Transport(());

impl Transport {
    /// Enables the port.
    pub fn open() -> Self {
        let divider = const { (USART6_HZ + BAUD / 2) / BAUD };
        // SAFETY: the register holds the divider in sixteenths, which with 16-fold oversampling is the ratio itself.
        port().brr().write(|w| unsafe { w.bits(divider as u16) });
        port().cr1().write(|w| w.ue().set_bit().te().set_bit().re().set_bit());
        Self(())
    }

    /// Receives bytes and passes them to `take` until it returns a value.
    pub fn receive<T>(&mut self, mut take: impl FnMut(u8) -> Option<T>) -> T {
        loop {
            while port().sr().read().rxne().bit_is_clear() {}
            if let Some(found) = take(port().dr().read().dr().bits() as u8) {
                return found;
            }
        }
    }

    /// Sends all bytes.
    pub fn send(&mut self, bytes: &[u8]) {
        for byte in bytes {
            while port().sr().read().txe().bit_is_clear() {}
            port().dr().write(|w| w.dr().set(u16::from(*byte)));
        }
    }
}

fn port() -> &'static RegisterBlock {
    // SAFETY: no other code uses this port.
    unsafe { &*USART6::ptr() }
}
