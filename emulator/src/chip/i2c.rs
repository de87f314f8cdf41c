//! An I2C interface whose data line can be held low from outside.

use rigless::device::{Device, DeviceContext, RegisterFile};
use rigless::soc::stm32f427::generated::i2c3::Register;
use rigless::soc::stm32f427::peripherals::i2c::I2c as Interface;
use rigless::time::EventId;

/// The interface.
#[derive(Debug)]
pub struct I2c {
    /// Model of the interface on a free bus.
    pub interface: Interface,
    /// Whether the data line is held low. The interface can then make no start condition, so writes have no effect.
    pub held_low: bool,
}

impl Device for I2c {
    type Register = Register;

    fn read(
        &mut self,
        register: Register,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) -> Option<u64> {
        if self.held_low { None } else { self.interface.read(register, registers, context) }
    }

    fn write(
        &mut self,
        register: Register,
        value: u64,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) {
        if !self.held_low {
            self.interface.write(register, value, registers, context);
        }
    }

    fn on_event(&mut self, event: EventId, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        if !self.held_low {
            self.interface.on_event(event, registers, context);
        }
    }

    fn on_clock(&mut self, hz: u64, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        self.interface.on_clock(hz, registers, context);
    }

    fn reset(&mut self) {
        self.interface.reset();
    }

    fn reset_line(&mut self, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        self.interface.reset_line(registers, context);
    }
}
