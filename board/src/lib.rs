//! A flight board as a file (`boards/NAME.toml`): read, checked against what the chip can, and resolved.
//!
//! ```text
//!  boards/NAME.toml ─► Board ─┬─► wiring.rs: constants and interrupt handlers of the firmware (its build)
//!                             └─► what the emulator solders to its model of the chip
//! ```
//! The file says what the board's maker has decided: pins, peripherals, how the sensor lies, the battery's divider. What
//! follows from that and the chip is found here: alternate functions, timer channels, DMA streams, interrupt vectors. What
//! can't be is refused, by name.
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
use input::layers::{Layers, built_in_or_file, text_of};

pub use chip::Stream;
pub use file::OnLevel;

macro_rules! boards {
    ($($name:literal),+ $(,)?) => {
        &[$(($name, include_str!(concat!("../../boards/", $name, ".toml")))),+]
    };
}

/// The built-in boards: name and text.
pub const BUILT_IN: &[(&str, &str)] = boards!["speedybee-f405-v4", "speedybee-f405-mini", "matek-f405-te"];

/// The board of an image that is built without saying which.
pub const DEFAULT: &str = BUILT_IN[0].0;

/// Longest name of a board's file, without its suffix: what is read of an image's name.
const LONGEST_NAME: usize = 63;

/// The motor pads, in the order in which the firmware counts them.
pub const PADS: [&str; 4] = ["M1", "M2", "M3", "M4"];

/// The rotors, in the order in which the flight controller counts them.
pub const ROTORS: [&str; 4] = ["front-left", "front-right", "rear-right", "rear-left"];

/// A pin of the chip.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Pin {
    /// Port, 0 for A.
    pub port: u8,
    /// 0 to 15.
    pub number: u8,
}

impl Pin {
    /// A pin by its name, such as `PA5`; of the package with 64 pins.
    ///
    /// # Errors
    /// No such pin.
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

/// A pin on a peripheral's signal.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Connection {
    /// The pin.
    pub pin: Pin,
    /// Peripheral, as the reference manual calls it.
    pub peripheral: String,
    /// Its signal.
    pub signal: &'static str,
    /// Number of the pin's alternate function.
    pub function: u8,
}

/// The inertial sensor.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Imu {
    /// Clock, data in and data out.
    pub bus: [Connection; 3],
    /// Chip select, low when selected.
    pub select: Pin,
    /// Chip selects of other chips on its bus, which are never selected.
    pub deselect: Vec<Pin>,
    /// Its data-ready line, high.
    pub ready: Pin,
    /// DMA that receives and that sends.
    pub streams: [Stream; 2],
    /// Where its x, y and z point on the board.
    pub axes: Axes,
}

/// Where a magnetometer can be plugged in.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Magnetometer {
    /// Clock.
    pub scl: Connection,
    /// Data.
    pub sda: Connection,
}

/// The battery's divider.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Battery {
    /// The pin behind it.
    pub pin: Pin,
    /// Its channel of ADC1.
    pub channel: u8,
    /// Volts of the battery for one at the pin.
    pub ratio: f64,
}

/// The LED.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Led {
    /// Its pin.
    pub pin: Pin,
    /// The level that lights it.
    pub on_level: OnLevel,
}

/// A motor pad.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Motor {
    /// Its name on the board.
    pub pad: &'static str,
    /// Its pin on the timer's channel.
    pub connection: Connection,
    /// 1 to 4.
    pub channel: u8,
    /// It is the channel's complementary output.
    pub complementary: bool,
    /// The rotor whose ESC is plugged there: a place in [`ROTORS`].
    pub rotor: usize,
}

/// A timer with motor pads.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Timer {
    /// As the reference manual calls it.
    pub name: String,
    /// DMA that plays its frames.
    pub stream: Stream,
}

/// A board.
#[derive(Clone, Debug, PartialEq)]
pub struct Board {
    /// Name of a built-in board, or the file's.
    pub name: String,
    /// For people.
    pub title: String,
    /// Whose pin maps these are.
    pub sources: Vec<String>,
    /// High-speed crystal, MHz.
    pub crystal_mhz: u32,
    /// The inertial sensor.
    pub imu: Imu,
    /// The magnetometer's bus.
    pub magnetometer: Magnetometer,
    /// Where the receiver's bytes come in.
    pub receiver: Connection,
    /// The battery.
    pub battery: Battery,
    /// The LED, if there is one.
    pub led: Option<Led>,
    /// The motor pads, in the order of [`PADS`].
    pub motors: [Motor; 4],
    /// Their timers, in the order in which the firmware starts them: the last one is that of the last pad.
    pub timers: Vec<Timer>,
}

impl Board {
    /// A built-in board by name, or a board file by path.
    ///
    /// # Errors
    /// A name that is neither, with the nearest built-in one; anything wrong in the file.
    pub fn load(name_or_path: &str) -> Result<Self, InputError> {
        let (place, text) = built_in_or_file("board", BUILT_IN, name_or_path, Path::new(""), &text_of)
            .map_err(|(path, error)| InputError::new(format!("cannot be read: {error}")).file(path))?
            .ok_or_else(|| unknown("board", name_or_path, BUILT_IN.iter().map(|board| board.0)))?;
        // A built-in name has no suffix.
        let name = Path::new(name_or_path).file_stem().map_or("".into(), |stem| stem.to_string_lossy());
        let plain = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
        if !name.chars().all(plain) || name.len() > LONGEST_NAME {
            let allowed = format!(
                "the file's name must be of at most {LONGEST_NAME} letters, digits, -, _ and dots: it is the image's name"
            );
            return Err(InputError::new(allowed).file(place));
        }
        Self::parse(&name, &place, &text)
    }

    /// The interrupt vector of the inertial sensor's data-ready line.
    pub fn ready_vector(&self) -> &'static str {
        chip::line_vector(self.imu.ready.number)
    }

    /// Reads a board called `name` from TOML; `place` is what errors call the text.
    ///
    /// # Errors
    /// Anything wrong in the text.
    pub fn parse(name: &str, place: &str, text: &str) -> Result<Self, InputError> {
        let mut layers = Layers::default();
        let table = layers.add(place, text)?;
        let file: file::File = layers.read(table)?;
        build(name, file).map_err(|error| if error.has_file() { error } else { error.file(place) })
    }
}

/// What each pin is for, so that none is for two things.
#[derive(Default)]
struct Pins(BTreeMap<Pin, String>);

impl Pins {
    fn take(&mut self, field: &str, name: &str) -> Result<Pin, InputError> {
        let pin = Pin::parse(field, name)?;
        if chip::DEBUG.contains(&name) {
            return Err(InputError::new("is a pin of the debug probe, which would lose the board")
                .field(field)
                .value(name));
        }
        match self.0.insert(pin, field.into()) {
            None => Ok(pin),
            Some(other) => Err(InputError::new(format!("is {other}'s pin already")).field(field).value(name)),
        }
    }

    fn connect(
        &mut self,
        field: &str,
        name: &str,
        peripheral: &str,
        signal: &'static str,
    ) -> Result<Connection, InputError> {
        let pin = self.take(field, name)?;
        let function = chip::function(pin, peripheral, signal).map_err(|pins| {
            let allowed = format!("is not {signal} of {peripheral}, which is at {}", pins.join(", "));
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
    // The control loop is bound to the end of its bursts.
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
    let select = pins.take("imu.select", &file.imu.select)?;
    let others = file.imu.deselect.iter();
    let deselect = others.map(|name| pins.take("imu.deselect", name)).collect::<Result<_, _>>()?;
    let ready = pins.take("imu.ready", &file.imu.ready)?;
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

    let pin = pins.take("battery.pin", &file.battery.pin)?;
    let channel = chip::analog_channel(pin).ok_or_else(|| {
        InputError::new("must be a pin that ADC1 measures: PA0 to PA7, PB0, PB1, PC0 to PC5")
            .field("battery.pin")
            .value(&file.battery.pin)
    })?;
    in_range("battery.ratio", file.battery.ratio, 1.0, 50.0, "V for one at the pin")?;
    let battery = Battery { pin, channel, ratio: file.battery.ratio };
    let led = match &file.led {
        Some(led) => Some(Led { pin: pins.take("led.pin", &led.pin)?, on_level: led.on_level }),
        None => None,
    };

    let motors = motors(&file.motors, &mut pins)?;
    let mut names: Vec<&str> = Vec::new();
    for motor in &motors {
        if !names.contains(&motor.connection.peripheral.as_str()) {
            names.push(&motor.connection.peripheral);
        }
    }
    let updates = names.iter().map(|timer| chip::update_of(timer));
    let needs: Vec<chip::Need> = chip::spi1().into_iter().chain(updates).collect();
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

/// The motor pads in the order of [`PADS`].
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
            InputError::new("is missing: a quadrotor has four").field(format!("motors.{pad}"))
        })?;
        let pin = pins.take(&field("pin"), &motor.pin)?;
        if motor.timer == "TIM5" {
            return Err(InputError::new("counts the firmware's microseconds; motors can have another")
                .field(field("timer"))
                .value("TIM5"));
        }
        if !chip::timers().contains(&motor.timer.as_str()) {
            return Err(unknown(&field("timer"), &motor.timer, chip::timers()));
        }
        let (channel, complementary, function) = chip::timer_channel(pin, &motor.timer).ok_or_else(|| {
            let others = chip::timers_at(pin);
            let there = if others.is_empty() {
                "no timer that can drive a motor has".into()
            } else {
                format!("{} has", others.join(" or "))
            };
            InputError::new(format!("{} has no channel at {pin}; {there}", motor.timer))
                .field(field("timer"))
                .value(&motor.timer)
        })?;
        if let Some(other) = channels.insert((motor.timer.clone(), channel), pad) {
            return Err(InputError::new(format!(
                "is on channel {channel} of {}, as {other} is",
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
            return Err(InputError::new(format!("is {other}'s already"))
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
    // One for each pad.
    all.try_into().map_err(|_| InputError::new("must have four pads").field("motors"))
}

#[cfg(test)]
mod tests;
