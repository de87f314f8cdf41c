//! The ESCs at the motor pads: they decode commands from the edges.
//!
//! | protocol | command |
//! |---|---|
//! | PWM | a pulse of 0.8 to 2.6 ms |
//! | OneShot125 | a pulse of 100 to 320 µs, an eighth of PWM's |
//! | DShot | 16 pulses of less than 5 µs: 11 bits of throttle, telemetry request, 4 bits of checksum |
//!
//! The widths of the pulses identify the protocol. A bit of DShot is a one if the line is high for more than half of the bit
//! (nominal: 37.5 % for a zero, 75 % for a one). The length of a bit is measured in the frame itself. The decoder uses only
//! the edges at the pads, and no register of the timers.

use rigless::device::Level;

/// Number of motor pads, and of rotors.
pub const PADS: usize = 4;

/// Time for which an ESC continues with its last command when it receives no more, ns; then it stops. ESCs differ; a quarter
/// of a second is among the longest times of ESC firmware.
const SIGNAL_LOST_NS: u64 = 250_000_000;

/// Pause after which a new DShot frame begins, ns: two bits of the slowest variant.
const FRAME_GAP_NS: u64 = 14_000;

/// State of a pad.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Line {
    /// Neither driven nor pulled by a resistor.
    #[default]
    Floating,
    /// Low.
    Low,
    /// High.
    High,
}

impl From<Level> for Line {
    fn from(level: Level) -> Self {
        if level == Level::High { Self::High } else { Self::Low }
    }
}

/// An ESC protocol.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Protocol {
    /// Servo pulses.
    Pwm,
    /// Pulses of an eighth of PWM's length.
    OneShot125,
    /// Bits of 6⅔ µs.
    DShot150,
    /// Bits of 3⅓ µs.
    DShot300,
    /// Bits of 1⅔ µs.
    DShot600,
}

impl Protocol {
    /// Returns the name to display.
    pub fn name(self) -> &'static str {
        match self {
            Self::Pwm => "PWM",
            Self::OneShot125 => "OneShot125",
            Self::DShot150 => "DShot150",
            Self::DShot300 => "DShot300",
            Self::DShot600 => "DShot600",
        }
    }
}

/// A command as the ESC received it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Command {
    /// Time of its end, ns.
    pub at_ns: u64,
    /// Throttle as a share of full speed, 0 to 1; 0 is the stop.
    pub throttle: f64,
    /// Protocol.
    pub protocol: Protocol,
}

/// The ESC at one pad.
#[derive(Clone, Debug, Default)]
pub struct Esc {
    line: Line,
    rose_ns: u64,
    /// Rise time and width of the pulses of the present DShot frame, ns.
    bits: Vec<(u64, u64)>,
    last: Option<Command>,
    /// Time of the last command other than a stop, ns.
    pub last_driven_ns: Option<u64>,
    /// All commands.
    pub commands: Vec<Command>,
    /// Number of invalid pulses and frames.
    pub invalid: u64,
}

impl Esc {
    /// Processes a change of the line at `at_ns`, and returns the command that it completes.
    pub fn on_edge(&mut self, at_ns: u64, line: Line) -> Option<Command> {
        let was = std::mem::replace(&mut self.line, line);
        if line == Line::High {
            if self.bits.last().is_some_and(|(rise, _)| at_ns - rise > FRAME_GAP_NS) {
                self.bits.clear();
                self.invalid += 1;
            }
            self.rose_ns = at_ns;
            return None;
        }
        if was != Line::High {
            return None;
        }
        let width = at_ns - self.rose_ns;
        let servo = |us: f64, protocol| {
            let throttle = ((us - 1_000.0) / 1_000.0).clamp(0.0, 1.0);
            Some(Command { at_ns, throttle, protocol })
        };
        let command = match width {
            0..5_000 => {
                self.bits.push((self.rose_ns, width));
                if self.bits.len() < 16 {
                    return None;
                }
                self.decode_frame(at_ns)
            }
            100_000..320_000 => servo(width as f64 * 8e-3, Protocol::OneShot125),
            800_000..2_600_000 => servo(width as f64 * 1e-3, Protocol::Pwm),
            _ => None,
        };
        match command {
            Some(command) => {
                self.commands.push(command);
                if command.throttle > 0.0 {
                    self.last_driven_ns = Some(at_ns);
                }
                self.last = Some(command);
            }
            None => self.invalid += 1,
        }
        command
    }

    /// Decodes the 16 bits of a DShot frame.
    fn decode_frame(&mut self, at_ns: u64) -> Option<Command> {
        let bits = std::mem::take(&mut self.bits);
        let bit_ns = (bits[15].0 - bits[0].0) / 15;
        let protocol = match bit_ns {
            1_600..=1_750 => Protocol::DShot600,
            3_200..=3_500 => Protocol::DShot300,
            6_400..=7_000 => Protocol::DShot150,
            _ => return None,
        };
        let word = bits.iter().fold(0_u16, |word, (_, width)| word << 1 | u16::from(2 * width > bit_ns));
        let value = word >> 4;
        if (value ^ value >> 4 ^ value >> 8) & 0xf != word & 0xf {
            return None;
        }
        // 0 is the stop, 1 to 47 are special commands for a stopped motor, 48 to 2,047 are throttle.
        let throttle = f64::from((value >> 1).saturating_sub(47)) / 2_000.0;
        Some(Command { at_ns, throttle, protocol })
    }

    /// Returns the throttle with which the ESC drives its motor at `now_ns`, as a share of full speed.
    pub fn throttle(&self, now_ns: u64) -> f64 {
        self.last
            .filter(|command| now_ns.saturating_sub(command.at_ns) <= SIGNAL_LOST_NS)
            .map_or(0.0, |command| command.throttle)
    }

    /// Returns the last command.
    pub fn last(&self) -> Option<Command> {
        self.last
    }

    /// Returns the state of the pad.
    pub fn line(&self) -> Line {
        self.line
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pulse(esc: &mut Esc, rise: u64, width: u64) -> Option<Command> {
        esc.on_edge(rise, Line::High);
        esc.on_edge(rise + width, Line::Low)
    }

    #[test]
    fn pulse_width_gives_protocol_and_throttle() {
        let mut esc = Esc::default();
        let command = pulse(&mut esc, 1_000_000, 1_500_000).unwrap();
        assert_eq!((command.throttle, command.protocol), (0.5, Protocol::Pwm));
        let command = pulse(&mut esc, 4_000_000, 218_750).unwrap();
        assert_eq!((command.throttle, command.protocol), (0.75, Protocol::OneShot125));
        assert_eq!(pulse(&mut esc, 6_000_000, 50_000), None);
        assert_eq!(esc.invalid, 1);
        assert_eq!(esc.throttle(6_100_000), 0.75);
        assert_eq!(esc.throttle(4_218_750 + SIGNAL_LOST_NS + 1), 0.0);
    }

    /// The example in the description of DShot (Betaflight, "DSHOT ESC Protocol"): throttle 1046 without telemetry request
    /// is 10000010110 0 with checksum 0110.
    #[test]
    fn dshot_frame_is_decoded_and_checked() {
        let word = 0b1000_0010_1100_0110_u16;
        let mut esc = Esc::default();
        let mut last = None;
        for bit in 0..16 {
            let one = word >> (15 - bit) & 1 == 1;
            last = pulse(&mut esc, 10_000 + 3_333 * bit, if one { 2_500 } else { 1_250 });
        }
        let command = last.unwrap();
        assert_eq!(command.protocol, Protocol::DShot300);
        assert!((command.throttle - 999.0 / 2_000.0).abs() < 1e-12);
        // A frame with one wrong bit is invalid.
        for bit in 0..16 {
            let one = (word ^ 0x20) >> (15 - bit) & 1 == 1;
            last = pulse(&mut esc, 1_000_000 + 3_333 * bit, if one { 2_500 } else { 1_250 });
        }
        assert_eq!((last, esc.invalid), (None, 1));
    }
}
