//! A flight board as a file (`boards/NAME.toml`): parser, check against the chip's tables, and resolution of everything
//! that follows.
//!
//! ```text
//!  boards/NAME.toml ─► Board ─┬─► wiring.rs: constants and interrupt handlers of the firmware (its build)
//!                             └─► the connections of the emulator's chip model
//! ```
//! The file has the choices of the board's maker: pins, peripherals, orientation of the IMU, ratio of the battery's
//! divider. This crate derives the rest from the chip's tables: alternate functions, timer channels, DMA streams,
//! interrupt vectors. An impossible connection is an error that names its field.
#![forbid(unsafe_code)]
#![warn(missing_docs)]

mod chip;
mod file;
mod generate;

use std::collections::BTreeMap;
use std::fmt;
use std::path::Path;

use input::InputError;
use input::axes::Axes;
use input::check::{in_range, unknown};
use input::layers::{Layers, built_in_or_file, read_text};

pub use chip::Stream;
pub use file::OnLevel;

macro_rules! boards {
    ($($name:literal),+ $(,)?) => {
        &[$(($name, include_str!(concat!("../../boards/", $name, ".toml")))),+]
    };
}

/// The built-in boards: name and text.
pub const BUILT_IN: &[(&str, &str)] = boards!["speedybee-f405-v4", "speedybee-f405-mini", "matek-f405-te"];

/// The board of an image that is built without naming one.
pub const DEFAULT: &str = BUILT_IN[0].0;

/// Longest name of a board's file, without its suffix: the limit for readers of the image's name.
const MAX_NAME_LEN: usize = 63;

/// The motor pads, in the firmware's order.
pub const PADS: [&str; 4] = ["M1", "M2", "M3", "M4"];

/// The rotors, in the flight controller's order.
pub const ROTORS: [&str; 4] = ["front-left", "front-right", "rear-right", "rear-left"];

/// A pin of the chip.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Pin {
    /// Port: 0 for A, 3 for D.
    pub port: u8,
    /// Number in the port, 0 to 15.
    pub number: u8,
}

impl Pin {
    /// Parses a pin name such as `PA5`, for the package with 64 pins.
    ///
    /// # Errors
    /// The package has no such pin.
    pub fn parse(field: &str, name: &str) -> Result<Self, InputError> {
        let pin = name.strip_prefix('P').and_then(|rest| {
            let (port, number) = rest.split_at_checked(1)?;
            let port = (port.as_bytes()[0]).checked_sub(b'A')?;
            let number: u8 = number.parse().ok()?;
            (number.to_string() == rest[1..] && number < 16 && port < 4).then_some(Self { port, number })
        });
        pin.filter(|pin| pin.port < 3 || pin.number == 2).ok_or_else(|| {
            InputError::new("must be a pin of the STM32F405RG: PA0 to PC15, or PD2").field(field).value(name)
        })
    }
}

impl fmt::Display for Pin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "P{}{}", char::from(b'A' + self.port), self.number)
    }
}

/// A pin connected to a peripheral's signal.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Connection {
    /// The pin.
    pub pin: Pin,
    /// The peripheral's name in the reference manual.
    pub peripheral: String,
    /// The peripheral's signal.
    pub signal: &'static str,
    /// Number of the pin's alternate function.
    pub function: u8,
}

/// The IMU's connections.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Imu {
    /// SCK, MISO and MOSI.
    pub bus: [Connection; 3],
    /// Chip select, active low.
    pub select: Pin,
    /// Chip selects of other chips on the same bus, which are kept inactive.
    pub deselect: Vec<Pin>,
    /// The data-ready line, active high.
    pub ready: Pin,
    /// DMA streams for reception and transmission.
    pub streams: [Stream; 2],
    /// Directions of the chip's x, y and z axes on the board.
    pub axes: Axes,
}

/// The magnetometer's bus.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Magnetometer {
    /// The clock line.
    pub scl: Connection,
    /// The data line.
    pub sda: Connection,
}

/// The measurement of the battery voltage.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Battery {
    /// The pin behind the divider.
    pub pin: Pin,
    /// The pin's channel of ADC1.
    pub channel: u8,
    /// Ratio of the divider: battery voltage divided by pin voltage.
    pub ratio: f64,
}

/// The LED.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Led {
    /// The LED's pin.
    pub pin: Pin,
    /// The level at which the LED lights.
    pub on_level: OnLevel,
}

/// A motor pad.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Motor {
    /// The pad's name on the board.
    pub pad: &'static str,
    /// The pad's pin on the timer's channel.
    pub connection: Connection,
    /// Channel of the timer, 1 to 4.
    pub channel: u8,
    /// Whether it is the channel's complementary output.
    pub complementary: bool,
    /// The rotor whose ESC is connected to the pad: an index into [`ROTORS`].
    pub rotor: usize,
}

/// A timer with motor pads.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Timer {
    /// The timer's name in the reference manual.
    pub name: String,
    /// DMA stream that sends its frames.
    pub stream: Stream,
}

/// A board.
#[derive(Clone, Debug, PartialEq)]
pub struct Board {
    /// Name of a built-in board, or the file's name without suffix.
    pub name: String,
    /// The board's full name, for the log.
    pub title: String,
    /// Sources of the pin assignment.
    pub sources: Vec<String>,
    /// Frequency of the high-speed crystal, MHz.
    pub crystal_mhz: u32,
    /// The IMU.
    pub imu: Imu,
    /// The magnetometer's bus.
    pub magnetometer: Magnetometer,
    /// The receiver's RX connection.
    pub receiver: Connection,
    /// The battery measurement.
    pub battery: Battery,
    /// The LED, if there is one.
    pub led: Option<Led>,
    /// The motor pads, in the order of [`PADS`].
    pub motors: [Motor; 4],
    /// The pads' timers, in the order in which the firmware starts them. The timer of the last pad comes last.
    pub timers: Vec<Timer>,
}

impl Board {
    /// Loads a built-in board by name, or a board file by path.
    ///
    /// # Errors
    /// A name that is neither, with the nearest built-in one; any error in the file.
    pub fn load(name_or_path: &str) -> Result<Self, InputError> {
        let (place, text) = built_in_or_file("board", BUILT_IN, name_or_path, Path::new(""), &read_text)
            .map_err(|(path, error)| InputError::new(format!("cannot be read: {error}")).file(path))?
            .ok_or_else(|| {
                unknown("board", name_or_path, BUILT_IN.iter().map(|board| board.0))
                    .also("; or the path of a board file, which ends in .toml")
            })?;
        // A built-in name has no suffix.
        let name = Path::new(name_or_path).file_stem().map_or("".into(), |stem| stem.to_string_lossy());
        let plain = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
        if !name.chars().all(plain) || name.len() > MAX_NAME_LEN {
            let allowed = format!(
                "the file's name must have at most {MAX_NAME_LEN} characters: letters, digits, `-`, `_` and `.` (it is part of the image's name)"
            );
            return Err(InputError::new(allowed).file(place));
        }
        Self::parse(&name, &place, &text)
    }

    /// Returns the interrupt vector of the IMU's data-ready line.
    pub fn ready_vector(&self) -> &'static str {
        chip::line_vector(self.imu.ready.number)
    }

    /// Parses a board called `name` from TOML; errors refer to the text as `place`.
    ///
    /// # Errors
    /// Any error in the text.
    pub fn parse(name: &str, place: &str, text: &str) -> Result<Self, InputError> {
        let mut layers = Layers::default();
        let table = layers.add(place, text)?;
        let file: file::File = layers.read(&table)?;
        build(name, file).map_err(|error| layers.locate(error, &table))
    }
}

/// The field that uses each pin, so that no pin is used twice.
#[derive(Default)]
struct Pins(BTreeMap<Pin, String>);

impl Pins {
    fn claim(&mut self, field: &str, name: &str) -> Result<Pin, InputError> {
        let pin = Pin::parse(field, name)?;
        if chip::DEBUG.contains(&name) {
            return Err(InputError::new("must not be a pin of the debug probe (PA13, PA14)")
                .field(field)
                .value(name));
        }
        match self.0.insert(pin, field.into()) {
            None => Ok(pin),
            Some(other) => Err(InputError::new(format!("already used by {other}")).field(field).value(name)),
        }
    }

    fn connect(
        &mut self,
        field: &str,
        name: &str,
        peripheral: &str,
        signal: &'static str,
    ) -> Result<Connection, InputError> {
        let pin = self.claim(field, name)?;
        let function = chip::function(pin, peripheral, signal).map_err(|pins| {
            let allowed = format!("must be a pin with {signal} of {peripheral}: {}", pins.join(", "));
            InputError::new(allowed).field(field).value(name)
        })?;
        Ok(Connection { pin, peripheral: peripheral.into(), signal, function })
    }
}

fn build(name: &str, file: file::File) -> Result<Board, InputError> {
    if file.mcu != "stm32f405" {
        return Err(unknown("mcu", &file.mcu, ["stm32f405"]));
    }
    in_range("crystal_mhz", f64::from(file.crystal_mhz), 4.0, 26.0, "MHz")?;
    if file.imu.chip != "icm-42688-p" {
        return Err(unknown("imu.chip", &file.imu.chip, ["icm-42688-p"]));
    }
    // The firmware's control loop is bound to the end of SPI1's bursts.
    if file.imu.spi != "SPI1" {
        return Err(unknown("imu.spi", &file.imu.spi, ["SPI1"]));
    }
    let mut pins = Pins::default();
    let spi = file.imu.spi.as_str();
    let bus = [
        pins.connect("imu.sck", &file.imu.sck, spi, "SCK")?,
        pins.connect("imu.miso", &file.imu.miso, spi, "MISO")?,
        pins.connect("imu.mosi", &file.imu.mosi, spi, "MOSI")?,
    ];
    let select = pins.claim("imu.select", &file.imu.select)?;
    let others = file.imu.deselect.iter();
    let deselect = others.map(|name| pins.claim("imu.deselect", name)).collect::<Result<_, _>>()?;
    let ready = pins.claim("imu.ready", &file.imu.ready)?;
    let axes = Axes::parse("imu.axes", &file.imu.axes)?;

    let one_of = |field: &str, value: &str, kinds: &[&str], signal: &str| {
        let valid = chip::peripherals(kinds, signal);
        if valid.contains(&value) { Ok(()) } else { Err(unknown(field, value, valid)) }
    };
    one_of("magnetometer.i2c", &file.magnetometer.i2c, &["I2C"], "SCL")?;
    let magnetometer = Magnetometer {
        scl: pins.connect("magnetometer.scl", &file.magnetometer.scl, &file.magnetometer.i2c, "SCL")?,
        sda: pins.connect("magnetometer.sda", &file.magnetometer.sda, &file.magnetometer.i2c, "SDA")?,
    };
    one_of("receiver.serial", &file.receiver.serial, &["USART", "UART"], "RX")?;
    let receiver = pins.connect("receiver.rx", &file.receiver.rx, &file.receiver.serial, "RX")?;

    let pin = pins.claim("battery.pin", &file.battery.pin)?;
    let channel = chip::analog_channel(pin).ok_or_else(|| {
        InputError::new("must be a pin with an ADC1 channel: PA0 to PA7, PB0, PB1, PC0 to PC5")
            .field("battery.pin")
            .value(&file.battery.pin)
    })?;
    in_range("battery.ratio", file.battery.ratio, 1.0, 50.0, "V/V")?;
    let battery = Battery { pin, channel, ratio: file.battery.ratio };
    let led = match &file.led {
        Some(led) => Some(Led { pin: pins.claim("led.pin", &led.pin)?, on_level: led.on_level }),
        None => None,
    };

    let motors = motors(&file.motors, &mut pins)?;
    let mut names: Vec<&str> = Vec::new();
    for motor in &motors {
        if !names.contains(&motor.connection.peripheral.as_str()) {
            names.push(&motor.connection.peripheral);
        }
    }
    let updates = names.iter().map(|timer| chip::timer_request(timer));
    let needs: Vec<chip::StreamRequest> = chip::spi1_requests().into_iter().chain(updates).collect();
    let streams = chip::assign(&needs).map_err(InputError::new)?;
    let timers = names.iter().zip(&streams[2..]);
    let timers = timers.map(|(name, stream)| Timer { name: (*name).into(), stream: *stream }).collect();

    Ok(Board {
        name: name.into(),
        title: file.title,
        sources: file.sources,
        crystal_mhz: file.crystal_mhz,
        imu: Imu { bus, select, deselect, ready, streams: [streams[0], streams[1]], axes },
        magnetometer,
        receiver,
        battery,
        led,
        motors,
        timers,
    })
}

/// Returns the motor pads in the order of [`PADS`].
fn motors(table: &BTreeMap<String, file::Motor>, pins: &mut Pins) -> Result<[Motor; 4], InputError> {
    if let Some(wrong) = table.keys().find(|name| !PADS.contains(&name.as_str())) {
        return Err(unknown("motors", wrong, PADS));
    }
    let mut rotors: BTreeMap<usize, &str> = BTreeMap::new();
    let mut channels: BTreeMap<(String, u8), &str> = BTreeMap::new();
    let mut all = Vec::new();
    for pad in PADS {
        let field = |key: &str| format!("motors.{pad}.{key}");
        let motor = table.get(pad).ok_or_else(|| {
            InputError::missing().field(format!("motors.{pad}")).also(": all of M1 to M4 are required")
        })?;
        let pin = pins.claim(&field("pin"), &motor.pin)?;
        if motor.timer == "TIM5" {
            return Err(InputError::new("must not be TIM5, which counts the firmware's microseconds")
                .field(field("timer"))
                .value("TIM5"));
        }
        if !chip::timers().contains(&motor.timer.as_str()) {
            return Err(unknown(&field("timer"), &motor.timer, chip::timers()));
        }
        let (channel, complementary, function) = chip::timer_channel(pin, &motor.timer).ok_or_else(|| {
            let others = chip::timers_at(pin);
            let options = match others.split_last() {
                None => "; no motor timer has one".into(),
                Some((only, [])) => format!(": {only}"),
                Some((last, rest)) => format!(": {} or {last}", rest.join(", ")),
            };
            InputError::new(format!("must be a timer with a channel at {pin}{options}"))
                .field(field("timer"))
                .value(&motor.timer)
        })?;
        if let Some(other) = channels.insert((motor.timer.clone(), channel), pad) {
            return Err(InputError::new(format!(
                "uses channel {channel} of {}, already used by {other}",
                motor.timer
            ))
            .field(field("pin"))
            .value(pin));
        }
        let rotor = ROTORS
            .iter()
            .position(|rotor| *rotor == motor.rotor)
            .ok_or_else(|| unknown(&field("rotor"), &motor.rotor, ROTORS))?;
        if let Some(other) = rotors.insert(rotor, pad) {
            return Err(InputError::new(format!("already used by {other}"))
                .field(field("rotor"))
                .value(&motor.rotor));
        }
        let signal = if complementary { "CHxN" } else { "CHx" };
        all.push(Motor {
            pad,
            connection: Connection { pin, peripheral: motor.timer.clone(), signal, function },
            channel,
            complementary,
            rotor,
        });
    }
    // The loop pushes one motor for each pad.
    all.try_into().map_err(|_| InputError::new("must have four motor pads").field("motors"))
}

#[cfg(test)]
mod tests;
