//! What goes wrong in a flight.

use rigless::emulator::Host;
use rigless::soc::Width;
use rigless::time::VirtualNanos;

use crate::board::{Machine, SUPPLY_MV};
use crate::firmware::Firmware;
use crate::rc_receiver::Protocol;

/// A fault, or its end.
#[derive(Clone, Debug, PartialEq)]
pub enum Fault {
    /// The inertial sensor has no supply, or has it again.
    ImuDead(bool),
    /// It loses its settings.
    ImuResetsItself,
    /// One bit in every so many of its words is flipped.
    ImuFlips(Option<u32>),
    /// Its data-ready line stands at this level.
    ReadyStuck(Option<bool>),
    /// The magnetometer is off its connector.
    MagnetometerAbsent(bool),
    /// Something holds the magnetometer's data line low.
    MagnetometerBusHeld(bool),
    /// It was cut off in the middle of a byte, and holds its data line low until it has got so many clocks.
    MagnetometerCutOff(u32),
    /// The memory address of this stream of DMA2, which moves the inertial sensor's bytes, is one where nothing is, or is
    /// the right one again.
    StreamAstray(usize, bool),
    /// The microcontroller's reset pin is pulled.
    ResetPin,
    /// At its next entry each handler finds all other interrupts raised.
    AllInterrupts,
    /// The receiver says nothing.
    RadioSilent(bool),
    /// Bytes at random come out of the receiver, for so many milliseconds.
    RadioGarbage(u32),
    /// The battery is at this voltage, whatever the scene says.
    Battery(Option<f64>),
    /// The microcontroller's supply, mV.
    Supply(u32),
    /// The microcontroller's supply is gone, or is back.
    Power(bool),
    /// The instruction at a function's beginning becomes an endless loop: the part of the function's name.
    Hang(&'static str),
    /// The instruction at a function's beginning becomes an undefined one.
    Undefined(&'static str),
    /// A function's beginning becomes a loop that reads one address after another, from where no chip has anything.
    Strays(&'static str),
    /// The function is as it was.
    Mended(&'static str),
    /// Bit `1` of every word in RAM that points to the symbol `0` is flipped.
    FlippedPointer(&'static str, u8),
}

/// `b .`.
const ENDLESS: u64 = 0xe7fe;
/// `udf #0`.
const UNDEFINED: u64 = 0xde00;

/// `mov.w r0, #0xf0000000`, and for ever `ldr r1, [r0]`, `adds r0, #4`, back.
const STRAYING: [u64; 5] = [0xf04f, 0x4070, 0x6801, 0x3004, 0xe7fc];

const RAM: std::ops::Range<u64> = 0x2000_0000..0x2002_0000;

/// Faults that last.
pub struct Active {
    /// The magnetometer is off.
    pub magnetometer_absent: bool,
    /// The receiver is silent.
    pub radio_silent: bool,
    /// The battery's voltage.
    pub battery_v: Option<f64>,
    garbage_until_ns: u64,
    random: u32,
    /// Every symbol of the image, and its address.
    symbols: Vec<(String, u64)>,
    spoiled: Vec<(&'static str, u64, u64)>,
}

impl Active {
    /// Nothing is wrong yet.
    pub fn new(firmware: &Firmware) -> Self {
        Self {
            magnetometer_absent: false,
            radio_silent: false,
            battery_v: None,
            garbage_until_ns: 0,
            random: 1,
            symbols: firmware.demangled(),
            spoiled: Vec::new(),
        }
    }

    /// It happens.
    ///
    /// # Panics
    /// A function or variable that the image does not have: a test that tests nothing.
    pub fn apply(&mut self, fault: Fault, machine: &mut Machine, host: &mut dyn Host, now: VirtualNanos) {
        match fault {
            Fault::ImuDead(dead) => machine.imu().faults.dead = dead,
            Fault::ImuResetsItself => machine.imu().reset_itself(),
            Fault::ImuFlips(every) => machine.imu().faults.flip_every = every,
            Fault::ReadyStuck(level) => machine.imu().faults.stuck_line = level,
            Fault::MagnetometerAbsent(absent) => {
                self.magnetometer_absent = absent;
                machine.magnetometer().absent = absent;
            }
            Fault::MagnetometerBusHeld(held) => machine.hold_magnetometer_bus(held),
            Fault::MagnetometerCutOff(clocks) => machine.hold_magnetometer_bus_for(clocks),
            Fault::StreamAstray(stream, astray) => machine.part.lead_stream_astray(stream, astray),
            // Of the session, which this does not have.
            Fault::ResetPin | Fault::AllInterrupts => unreachable!("the flight carries it out"),
            Fault::RadioSilent(silent) => self.radio_silent = silent,
            Fault::RadioGarbage(ms) => self.garbage_until_ns = now.0 + u64::from(ms) * 1_000_000,
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
            Fault::Hang(function) => self.spoil(function, ENDLESS, host),
            Fault::Undefined(function) => self.spoil(function, UNDEFINED, host),
            Fault::Strays(function) => {
                let address = self.find(function).unwrap_or_else(|| panic!("no function {function}"));
                for (instruction, at) in STRAYING.into_iter().zip((address..).step_by(2)) {
                    host.program(at, Width::W16, instruction).expect("it is in flash");
                }
            }
            Fault::Mended(function) => {
                for (_, address, was) in self.spoiled.extract_if(.., |(name, ..)| *name == function) {
                    host.program(address, Width::W16, was).expect("it is in flash");
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

    /// Address of the symbol of this name, or else of the first with this in its name.
    fn find(&self, part: &str) -> Option<u64> {
        let is = self.symbols.iter().find(|(name, _)| name == part);
        is.or_else(|| self.symbols.iter().find(|(name, _)| name.contains(part))).map(|(_, address)| *address)
    }

    fn spoil(&mut self, function: &'static str, instruction: u64, host: &mut dyn Host) {
        let address = self.find(function).unwrap_or_else(|| panic!("no function {function}"));
        let was = host.read(address, Width::W16).expect("it is in flash");
        host.program(address, Width::W16, instruction).expect("it is in flash");
        self.spoiled.push((function, address, was));
    }

    /// What lasts, at each stop.
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
