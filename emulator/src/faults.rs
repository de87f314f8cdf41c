//! The faults of a flight.

use rigless::emulator::Host;
use rigless::soc::Width;
use rigless::time::VirtualNanos;

use crate::board::{Machine, SUPPLY_MV};
use crate::firmware::Firmware;
use crate::rc_receiver::Protocol;

/// The start or the end of a fault. A `bool` starts the fault if true and ends it if false; `None` ends it, too. Functions
/// and symbols are given by a part of their name.
#[derive(Clone, Debug, PartialEq)]
pub enum Fault {
    /// The IMU has no supply.
    ImuDead(bool),
    /// The IMU loses its settings.
    ImuReset,
    /// One bit in this number of the IMU's words is flipped.
    ImuBitErrors(Option<u32>),
    /// The data-ready line is stuck at this level.
    ReadyStuck(Option<bool>),
    /// The magnetometer is not connected.
    MagnetometerAbsent(bool),
    /// The magnetometer's data line is held low.
    MagnetometerBusHeld(bool),
    /// The magnetometer was interrupted in the middle of a byte, and holds its data line low until it has received this
    /// number of clock pulses.
    MagnetometerInterrupted(u32),
    /// The memory address of this stream of DMA2, which moves the IMU's bytes, is unmapped.
    StreamAddressUnmapped(usize, bool),
    /// The microcontroller's reset pin is pulled.
    ResetPin,
    /// All other interrupts are raised at the next entry of each handler.
    AllInterrupts,
    /// The receiver sends nothing.
    ReceiverSilent(bool),
    /// The receiver sends random bytes for this time, ms.
    ReceiverGarbage(u32),
    /// The battery has this voltage (V) instead of the scene's.
    Battery(Option<f64>),
    /// The microcontroller's supply has this voltage, mV.
    Supply(u32),
    /// The microcontroller's supply is switched on (true) or off (false).
    Power(bool),
    /// The first instruction of a function is replaced by an endless loop.
    Hang(&'static str),
    /// The first instruction of a function is replaced by an undefined instruction.
    Undefined(&'static str),
    /// The start of a function is replaced by a loop that reads successive unmapped addresses.
    ReadUnmapped(&'static str),
    /// The first instruction of a function is restored after [`Fault::Hang`] or [`Fault::Undefined`].
    Restored(&'static str),
    /// In all words in RAM that point to the named symbol, the bit with this number is flipped.
    FlippedPointer(&'static str, u8),
}

/// `b .`.
const ENDLESS: u64 = 0xe7fe;
/// `udf #0`.
const UNDEFINED: u64 = 0xde00;

/// `mov.w r0, #0xf0000000`, then an endless loop of `ldr r1, [r0]` and `adds r0, #4`.
const READ_UNMAPPED: [u64; 5] = [0xf04f, 0x4070, 0x6801, 0x3004, 0xe7fc];

const RAM: std::ops::Range<u64> = 0x2000_0000..0x2002_0000;

/// The present faults.
pub struct ActiveFaults {
    /// Whether the magnetometer is not connected.
    pub magnetometer_absent: bool,
    /// Whether the receiver sends nothing.
    pub receiver_silent: bool,
    /// Voltage of the battery instead of the scene's, V.
    pub battery_v: Option<f64>,
    garbage_until_ns: u64,
    random: u32,
    /// Names and addresses of all symbols of the image.
    symbols: Vec<(String, u64)>,
    /// Replaced instructions: function, address, original instruction.
    replaced: Vec<(&'static str, u64, u64)>,
}

impl ActiveFaults {
    /// Returns the state without faults.
    pub fn new(firmware: &Firmware) -> Self {
        Self {
            magnetometer_absent: false,
            receiver_silent: false,
            battery_v: None,
            garbage_until_ns: 0,
            random: 1,
            symbols: firmware.demangled(),
            replaced: Vec::new(),
        }
    }

    /// Applies a fault.
    ///
    /// # Panics
    /// Panics if the image does not have the function or variable, because the test would then test nothing.
    pub fn apply(&mut self, fault: Fault, machine: &mut Machine, host: &mut dyn Host, now: VirtualNanos) {
        match fault {
            Fault::ImuDead(dead) => machine.imu().faults.dead = dead,
            Fault::ImuReset => machine.imu().request_reset(),
            Fault::ImuBitErrors(every) => machine.imu().faults.flip_every = every,
            Fault::ReadyStuck(level) => machine.imu().faults.stuck_line = level,
            Fault::MagnetometerAbsent(absent) => {
                self.magnetometer_absent = absent;
                machine.magnetometer().absent = absent;
            }
            Fault::MagnetometerBusHeld(held) => machine.hold_magnetometer_bus(held),
            Fault::MagnetometerInterrupted(clocks) => machine.hold_magnetometer_bus_for(clocks),
            Fault::StreamAddressUnmapped(stream, unmapped) => {
                machine.part.set_stream_address_unmapped(stream, unmapped);
            }
            // These two need the session, which is not available here.
            Fault::ResetPin | Fault::AllInterrupts => unreachable!("the flight driver applies it"),
            Fault::ReceiverSilent(silent) => self.receiver_silent = silent,
            Fault::ReceiverGarbage(ms) => self.garbage_until_ns = now.0 + u64::from(ms) * 1_000_000,
            Fault::Battery(volts) => {
                self.battery_v = volts;
                if let Some(volts) = volts {
                    machine.set_battery(volts);
                }
            }
            Fault::Supply(millivolts) => machine.set_supply(millivolts),
            Fault::Power(on) => {
                machine.set_supply(if on { SUPPLY_MV } else { 0 });
                machine.part.power(now, on);
            }
            Fault::Hang(function) => self.replace(function, ENDLESS, host),
            Fault::Undefined(function) => self.replace(function, UNDEFINED, host),
            Fault::ReadUnmapped(function) => {
                let address = self.find(function).unwrap_or_else(|| panic!("no function {function}"));
                for (instruction, at) in READ_UNMAPPED.into_iter().zip((address..).step_by(2)) {
                    host.program(at, Width::W16, instruction).expect("it is in flash");
                }
            }
            Fault::Restored(function) => {
                for (_, address, original) in self.replaced.extract_if(.., |(name, ..)| *name == function) {
                    host.program(address, Width::W16, original).expect("it is in flash");
                }
            }
            Fault::FlippedPointer(symbol, bit) => {
                let target = self.find(symbol).unwrap_or_else(|| panic!("no symbol {symbol}"));
                let mut flipped = 0;
                for address in RAM.step_by(4) {
                    if host.read(address, Width::W32).is_ok_and(|word| word == target) {
                        host.write(address, Width::W32, target ^ 1 << bit).expect("it is in RAM");
                        flipped += 1;
                    }
                }
                assert!(flipped > 0, "no word in RAM points to {symbol}");
            }
        }
    }

    /// Returns the address of the symbol with this name, else of the first symbol whose name contains it.
    fn find(&self, part: &str) -> Option<u64> {
        let exact = self.symbols.iter().find(|(name, _)| name == part);
        exact
            .or_else(|| self.symbols.iter().find(|(name, _)| name.contains(part)))
            .map(|(_, address)| *address)
    }

    /// Replaces the first instruction of a function.
    fn replace(&mut self, function: &'static str, instruction: u64, host: &mut dyn Host) {
        let address = self.find(function).unwrap_or_else(|| panic!("no function {function}"));
        let original = host.read(address, Width::W16).expect("it is in flash");
        host.program(address, Width::W16, instruction).expect("it is in flash");
        self.replaced.push((function, address, original));
    }

    /// Sends garbage from the receiver while that fault lasts; call it at each stop.
    pub fn run(&mut self, machine: &mut Machine, now_ns: u64) {
        if now_ns < self.garbage_until_ns && machine.receiver().is_idle() {
            // xorshift32 (Marsaglia 2003).
            self.random ^= self.random << 13;
            self.random ^= self.random >> 17;
            self.random ^= self.random << 5;
            let pause_ns = match machine.receiver().protocol {
                Protocol::Crsf => u64::from(self.random >> 24) * 10_000,
                Protocol::Sbus => u64::from(self.random >> 24) * 40_000,
            };
            let bytes = self.random.to_le_bytes();
            machine.receiver().send_bytes(bytes, now_ns + pause_ns);
        }
    }
}
