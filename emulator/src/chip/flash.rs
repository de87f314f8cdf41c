//! The flash array and its interface, RM0090 rev 22 chapter 3.
//!
//! The interface's registers, keys, protection and errors and the duration of an erase are from `rigless`. This module adds
//! the effect of an erase and of a store on the content of the array.
//!
//! - **Program** (3.6.3): while `PG` is set, a store of the width in `PSIZE` clears bits. It takes 16 µs (DS8626 rev 9,
//!   table 41, typical), during which `BSY` is set. A store without `PG`, or while locked, sets `PGSERR`; a store of
//!   another width sets `PGPERR`. In both cases the array is unchanged.
//! - **Erase** (3.6.3): at the end of the operation the sector reads as ones.
//!
//! Not modelled: a real core stalls when it fetches from the array while it is busy; the emulated core continues. A
//! power cut during an operation leaves the array unchanged.

use rigless::device::{Device, DeviceContext, RegisterFile};
use rigless::soc::Width;
use rigless::soc::stm32f427::generated::flash::{Register, cr, sr};
use rigless::soc::stm32f427::peripherals::flash::{Flash, LOCK};
use rigless::time::{EventId, VirtualNanos};

/// First address of the array.
pub const BASE: u64 = 0x0800_0000;

/// Duration of a store, ns.
const PROGRAM_NS: u64 = 16_000;

/// Returns the size of sector `n` of the STM32F405RG, bytes (RM0090, table 5); `None` after the last sector.
pub const fn sector_bytes(n: u64) -> Option<u64> {
    match n {
        0..=3 => Some(16 << 10),
        4 => Some(64 << 10),
        5..=11 => Some(128 << 10),
        _ => None,
    }
}

fn sector_start(n: u64) -> Option<u64> {
    (0..n).try_fold(BASE, |address, before| Some(address + sector_bytes(before)?))
}

/// The flash interface and its array.
#[derive(Debug, serde::Serialize, serde::Deserialize)]
pub struct FlashArray {
    /// The registers.
    pub interface: Flash,
    erasing: Option<u64>,
    /// The store that waits for the old content of the array: address, width in bytes, value.
    storing: Option<(u64, u32, u64)>,
    stored: Option<EventId>,
}

impl FlashArray {
    /// Returns the interface after a reset.
    pub fn new(interface: Flash) -> Self {
        Self { interface, erasing: None, storing: None, stored: None }
    }

    fn erase(sector: u64, context: &mut DeviceContext<'_>) {
        let (Some(start), Some(bytes)) = (sector_start(sector), sector_bytes(sector)) else { return };
        for address in (start..start + bytes).step_by(4) {
            context.program(address, Width::W32, 0xffff_ffff, 0);
        }
    }
}

/// Token of the read before a store.
const BEFORE_STORE: u64 = 1;

fn width_of(bytes: u32) -> Width {
    match bytes {
        1 => Width::W8,
        2 => Width::W16,
        _ => Width::W32,
    }
}

impl Device for FlashArray {
    type Register = Register;

    fn read(
        &mut self,
        register: Register,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) -> Option<u64> {
        self.interface.read(register, registers, context)
    }

    fn write(
        &mut self,
        register: Register,
        value: u64,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) {
        let was_busy = sr::BSY.is_set(registers.get(Register::Sr));
        self.interface.write(register, value, registers, context);
        let busy = sr::BSY.is_set(registers.get(Register::Sr));
        let control = registers.get(Register::Cr);
        if busy && !was_busy && cr::SER.is_set(control) {
            self.erasing = Some(cr::SNB.get(control));
        }
    }

    fn on_event(&mut self, event: EventId, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        if self.stored == Some(event) {
            self.stored = None;
            registers.set(Register::Sr, sr::BSY.set(registers.get(Register::Sr), 0));
            return;
        }
        self.interface.on_event(event, registers, context);
        if !sr::BSY.is_set(registers.get(Register::Sr))
            && let Some(sector) = self.erasing.take()
        {
            Self::erase(sector, context);
        }
    }

    fn write_region(
        &mut self,
        address: u64,
        width: Width,
        value: u64,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) -> bool {
        let control = registers.get(Register::Cr);
        let status = registers.get(Register::Sr);
        if LOCK.is_set(control) || !cr::PG.is_set(control) {
            registers.set(Register::Sr, sr::PGSERR.set(status, 1));
            context.tell("CR", "RM0090 3.6.5: a store into the array without PG");
        } else if 1 << cr::PSIZE.get(control) != width.bytes() {
            registers.set(Register::Sr, sr::PGPERR.set(status, 1));
            context.tell("CR", "RM0090 3.6.5: a store into the array of another width than PSIZE");
        } else {
            self.storing = Some((address, width.bytes(), value));
            context.read_from(address, width, BEFORE_STORE);
            registers.set(Register::Sr, sr::BSY.set(status, 1));
            self.stored = Some(context.schedule(VirtualNanos(context.now().0 + PROGRAM_NS)));
        }
        true
    }

    fn on_access(&mut self, token: u64, value: u64, _: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        if token == BEFORE_STORE
            && let Some((address, bytes, wanted)) = self.storing.take()
        {
            // Programming can only clear bits.
            context.program(address, width_of(bytes), value & wanted, 0);
        }
    }

    fn on_clock(&mut self, hz: u64, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        self.interface.on_clock(hz, registers, context);
    }
}
