//! The wiring table of a board, and the microcontroller with the chips that are connected to it.

use std::num::{NonZeroU32, NonZeroU64};
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

use ::board::OnLevel;
use input::InputError;
use input::axes::Axes;
use rigless::cpu::armv7m as cpu;
use rigless::device::{ErasedDevice, Level, ResetCause};
use rigless::image::Image;
use rigless::machine::{Board, Target, armv7m};
use rigless::mcu::Mcu;
use rigless::snapshot::{self, Store};
use rigless::soc::stm32f427::peripherals::SERIAL_PORTS;
use rigless::soc::stm32f427::peripherals::adc::Channel as Analog;
use rigless::soc::stm32f427::peripherals::gpio::Pin;
use rigless::soc::stm32f427::peripherals::spi::Select;
use rigless::soc::{Bus, Error};
use rigless::time::VirtualNanos;
use sim_host::scene::Scene;
use vehicle::Vehicle;

use crate::chip::exti::PVD_LINE;
use crate::chip::stm32f405::{PORTS, Stm32f405, TimerIndex};
use crate::imu::Imu;
use crate::magnetometer::Magnetometer;
use crate::pads::{Line, PADS};
use crate::rc_receiver::{Protocol, RcReceiver};
use crate::timing::{HANDLERS, Handler, INSTRUCTIONS_PER_SECOND, handlers};

/// Clock of the core after the firmware's set-up, Hz. SysTick uses it.
const CORE_HZ: u64 = 168_000_000;

/// Index of the IMU's SPI among SPI1 to SPI3: the firmware uses SPI1.
const IMU_SPI: usize = 0;

/// Nominal supply of the microcontroller, mV.
pub const SUPPLY_MV: u32 = 3_300;

/// A pin: port (0 for A) and number.
#[derive(Clone, Copy, Debug)]
pub struct Wire {
    /// Port, 0 for port A.
    pub port: usize,
    /// Pin, 0 to 15.
    pub pin: u8,
}

impl From<::board::Pin> for Wire {
    fn from(pin: ::board::Pin) -> Self {
        Self { port: pin.port.into(), pin: pin.number }
    }
}

/// A motor pad.
#[derive(Clone, Copy, Debug)]
pub struct Pad {
    /// Name on the board.
    pub name: &'static str,
    /// Pin.
    pub wire: Wire,
    /// Alternate function that connects the pin to its timer's output.
    pub function: u8,
    /// Timer.
    pub timer: TimerIndex,
    /// Channel of the timer, 1 to 4.
    pub channel: u8,
    /// Whether the pad uses the channel's complementary output.
    pub complementary: bool,
    /// Rotor whose ESC is connected to the pad: 0 for the front left, then clockwise.
    pub rotor: usize,
}

/// Required output type or pull of a peripheral's pin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Drive {
    /// A push-pull output, or an input.
    PushPull,
    /// An open-drain output.
    OpenDrain,
    /// An input with a pull-up.
    PulledUp,
}

/// The connection of a pin to a peripheral.
#[derive(Clone, Debug)]
pub struct Connection {
    /// Pin.
    pub wire: Wire,
    /// Peripheral, by its name in RM0090.
    pub instance: String,
    /// Signal of the peripheral.
    pub signal: &'static str,
    /// Alternate function that connects the pin to the signal (DS8626, table 9).
    pub function: u64,
    /// Required output type or pull.
    pub drive: Drive,
}

/// The wiring of a board in a vehicle.
#[derive(Debug)]
pub struct Wiring {
    /// Board.
    pub board: ::board::Board,
    /// Directions of the IMU's axes in the vehicle.
    pub imu_axes: Axes,
    /// Maximum bit rate of the IMU's bus, Hz.
    pub imu_max_hz: u64,
    /// Directions of the magnetometer's axes in the vehicle.
    pub magnetometer_axes: Axes,
    /// Bit rate of the magnetometer's bus, Hz.
    pub magnetometer_hz: u64,
    /// I2C of the magnetometer, 0 for I2C1.
    pub magnetometer_i2c: usize,
    /// Serial port of the receiver, as an index into `rigless`'s list.
    pub receiver_usart: usize,
    /// Motor pads.
    pub pads: [Pad; PADS],
    /// Other pins of peripherals.
    pub connections: Vec<Connection>,
    /// Interrupt handlers that run in flight.
    pub handlers: [Handler; HANDLERS],
}

impl Wiring {
    /// Returns the wiring of a board in a vehicle.
    ///
    /// # Panics
    /// The board has a timer or a serial port that the chip does not have. The check of board files excludes this.
    pub fn new(board: ::board::Board, vehicle: &Vehicle) -> Self {
        let connection = |found: &::board::Connection, drive| Connection {
            wire: found.pin.into(),
            instance: found.peripheral.clone(),
            signal: found.signal,
            function: found.function.into(),
            drive,
        };
        let [sck, miso, mosi] = &board.imu.bus;
        let connections = vec![
            connection(sck, Drive::PushPull),
            connection(miso, Drive::PushPull),
            connection(mosi, Drive::PushPull),
            connection(&board.receiver, Drive::PulledUp),
            connection(&board.magnetometer.scl, Drive::OpenDrain),
            connection(&board.magnetometer.sda, Drive::OpenDrain),
        ];
        let pads = board.motors.each_ref().map(|motor| Pad {
            name: motor.pad,
            wire: motor.connection.pin.into(),
            function: motor.connection.function,
            timer: TimerIndex::of(&motor.connection.peripheral).expect("a timer of the chip"),
            channel: motor.channel,
            complementary: motor.complementary,
            rotor: motor.rotor,
        });
        let serial = board.receiver.peripheral.as_str();
        let magnetometer_i2c = board.magnetometer.scl.peripheral.trim_start_matches("I2C").parse::<usize>();
        Self {
            imu_axes: board.imu.axes.mounted_on(&vehicle.board_axes),
            imu_max_hz: 24_000_000,
            magnetometer_axes: vehicle.magnetometer_axes,
            magnetometer_hz: 400_000,
            magnetometer_i2c: magnetometer_i2c.expect("I2C1 to I2C3") - 1,
            receiver_usart: SERIAL_PORTS
                .iter()
                .position(|port| port.instance == serial)
                .expect("a serial port"),
            handlers: handlers(board.ready_vector(), serial),
            pads,
            connections,
            board,
        }
    }
}

/// The values of one count of the chips on the boards: the ICM-42688-P at ±2,000 °/s and ±16 g (DS-000347, tables 1 and
/// 2), rad/s and m/s²; the QMC5883L at ±8 G (its data sheet, table 2), µT.
const PER_COUNT: [(&str, f64); 3] = [
    ("gyroscope", 2_000.0 / 32_768.0 * std::f64::consts::PI / 180.0),
    ("accelerometer", 16.0 / 32_768.0 * 9.806_65),
    ("magnetometer", 100.0 / 3_000.0),
];

impl Wiring {
    /// Checks that the scene's sensors have the sensitivities of the board's chips.
    ///
    /// # Errors
    /// The sensitivities differ: a board with such chips would need another image.
    pub fn check(&self, scene: &Scene) -> Result<(), InputError> {
        let params = &scene.config.params;
        let counts = [params.gyro, params.accel, params.mag].map(|sensor| f64::from(sensor.per_count));
        for ((sensor, expected), per_count) in PER_COUNT.into_iter().zip(counts) {
            if (per_count / expected - 1.0).abs() > 1.0e-3 {
                let allowed = format!(
                    "the scene's {sensor} has another sensitivity than that of the {}, which has an ICM-42688-P and a \
                     QMC5883L: use imu = \"icm-42688-p\"",
                    self.board.title
                );
                return Err(InputError::new(allowed).file(&scene.name).field("imu"));
            }
        }
        Ok(())
    }
}

/// Converts a vector of counts from the body's axes to the chip's.
pub fn to_chip(axes: &Axes, body: [i16; 3]) -> [i16; 3] {
    axes.chip_from_body(body.map(i32::from)).map(|counts| {
        // The negative of i16::MIN does not fit into i16.
        counts.clamp(i32::from(i16::MIN), i32::from(i16::MAX)) as i16
    })
}

/// Returns whether this is the address of a register of DMA1 or DMA2.
pub fn is_dma(address: u64) -> bool {
    matches!(address, 0x4002_6000..0x4002_6800)
}

/// The microcontroller with its wired pins.
#[derive(Debug)]
pub struct Machine {
    /// Microcontroller.
    pub part: Stm32f405,
    wiring: Arc<Wiring>,
    ready: Option<bool>,
    supply_low: bool,
    data_held: bool,
    /// Clock pulses after which the magnetometer releases its data line.
    clocks_left: Option<u32>,
    magnetometer_clock: bool,
    /// Levels that the timers drive at the pads.
    functions: [Option<Level>; PADS],
    /// Whether the port models do not yet have the levels of `functions`.
    ports_outdated: bool,
    now: VirtualNanos,
    pad_ports: Vec<usize>,
    /// Addresses of the motor timers' registers.
    motor_timers: Vec<Range<u64>>,
    /// Addresses of other registers that can change the level of a motor pad: ports and RCC.
    motor_others: Vec<Range<u64>>,
    lines: [Line; PADS],
    /// Changes at the pads since the last [`Self::take_edges`]: time (ns), pad, new state.
    edges: Vec<(u64, usize, Line)>,
}

impl Machine {
    fn new(wiring: Arc<Wiring>, protocol: Protocol) -> Result<Self, Error> {
        let mut part = Stm32f405::new()?;
        part.rcc.attach_crystals(u64::from(wiring.board.crystal_mhz) * 1_000_000, 0);
        part.set_supply(SUPPLY_MV);
        let select = Wire::from(wiring.board.imu.select);
        part.spi[IMU_SPI].attach_selected(
            Imu::new(),
            Select { port: PORTS[select.port], pin: pin_of(select), active: Level::Low },
        );
        part.i2c[wiring.magnetometer_i2c].interface.attach(Magnetometer::new());
        part.usart[wiring.receiver_usart].attach(RcReceiver::new(protocol));
        for adc in &mut part.adc {
            adc.set_reference(SUPPLY_MV);
            adc.set_backup_battery(SUPPLY_MV);
        }
        let timers = wiring.board.timers.iter().map(|timer| timer.name.as_str());
        let motor_timers = timers.map(|name| part.addresses(name)).collect();
        let others = wiring.pads.iter().map(|pad| PORTS[pad.wire.port]).chain(["RCC"]);
        let motor_others = others.map(|name| part.addresses(name)).collect();
        let pad_ports = wiring.pads.iter().map(|pad| part.port_slot(pad.wire.port)).collect();
        Ok(Self {
            part,
            wiring,
            ready: None,
            supply_low: false,
            data_held: false,
            clocks_left: None,
            magnetometer_clock: true,
            functions: [None; PADS],
            ports_outdated: false,
            now: VirtualNanos(0),
            pad_ports,
            motor_timers,
            motor_others,
            lines: [Line::Floating; PADS],
            edges: Vec::new(),
        })
    }

    /// Returns whether this is the address of a register of a motor timer.
    pub fn is_motor_timer(&self, address: u64) -> bool {
        self.motor_timers.iter().any(|range| range.contains(&address))
    }

    /// Returns whether an access to this address can change the level of a motor pad: a register of the timers, the ports
    /// or the RCC.
    pub fn touches_pads(&self, address: u64) -> bool {
        self.is_motor_timer(address) || self.motor_others.iter().any(|range| range.contains(&address))
    }

    /// Returns the IMU.
    pub fn imu(&mut self) -> &mut Imu {
        self.part.spi[IMU_SPI].chip_mut(0).expect("it was attached")
    }

    /// Returns the magnetometer.
    pub fn magnetometer(&mut self) -> &mut Magnetometer {
        self.part.i2c[self.wiring.magnetometer_i2c].interface.chip_mut(0).expect("it was attached")
    }

    /// Returns whether the magnetometer continues to send ([`Magnetometer::sends_on`]).
    pub fn magnetometer_sends_on(&self) -> bool {
        let peer = self.part.i2c[self.wiring.magnetometer_i2c].interface.peer();
        let magnetometer: Option<&Magnetometer> =
            peer.and_then(|peer| (peer as &dyn std::any::Any).downcast_ref());
        magnetometer.is_some_and(Magnetometer::sends_on)
    }

    /// Returns the receiver.
    pub fn receiver(&mut self) -> &mut RcReceiver {
        self.part.usart[self.wiring.receiver_usart].chip_mut().expect("it was attached")
    }

    /// Sets the voltage of the battery, V.
    pub fn set_battery(&mut self, volts: f64) {
        let channel = Analog::new(self.wiring.board.battery.channel).expect("a channel of ADC1");
        let millivolts = (volts * 1_000.0 / self.wiring.board.battery.ratio).round().clamp(0.0, 3_300.0);
        self.part.adc[0].set_input(channel, millivolts as u32);
    }

    /// Holds the magnetometer's I2C data line low, or releases it.
    pub fn hold_magnetometer_bus(&mut self, held: bool) {
        self.part.i2c[self.wiring.magnetometer_i2c].held_low = held;
        self.clocks_left = None;
    }

    /// Simulates a magnetometer that was interrupted in the middle of a byte: it holds the data line low until it has
    /// received this number of clock pulses.
    pub fn hold_magnetometer_bus_for(&mut self, clocks: u32) {
        self.hold_magnetometer_bus(true);
        self.clocks_left = Some(clocks);
    }

    /// Returns whether the magnetometer's data line is free.
    pub fn magnetometer_bus_is_free(&self) -> bool {
        !self.part.i2c[self.wiring.magnetometer_i2c].held_low
    }

    /// Counts the clock pulses that the firmware makes on the magnetometer's clock pin as a general-purpose output.
    fn count_magnetometer_clocks(&mut self) {
        use rigless::soc::stm32f427::generated::gpioa::Register;
        let wire = Wire::from(self.wiring.board.magnetometer.scl.pin);
        let (_, registers) = self.part.port(wire.port);
        let driven = registers.get(Register::Moder) >> (2 * wire.pin) & 3 == 1;
        let high = !driven || registers.get(Register::Odr) >> wire.pin & 1 == 1;
        let was = std::mem::replace(&mut self.magnetometer_clock, high);
        let rose = high && !was;
        let Some(clocks) = self.clocks_left.filter(|_| rose) else { return };
        self.clocks_left = clocks.checked_sub(1).filter(|left| *left > 0);
        if self.clocks_left.is_none() {
            self.hold_magnetometer_bus(false);
            self.magnetometer().end_transfer();
        }
    }

    /// Returns whether the LED is lit; `false` if the board has no LED, or the firmware has not set up its pin yet.
    pub fn is_led_lit(&self) -> bool {
        use rigless::soc::stm32f427::generated::gpioa::Register;
        let Some(led) = self.wiring.board.led else { return false };
        let wire = Wire::from(led.pin);
        let (_, registers) = self.part.port(wire.port);
        let output = registers.get(Register::Moder) >> (2 * wire.pin) & 3 == 1;
        let high = registers.get(Register::Odr) >> wire.pin & 1 == 1;
        output && high == (led.on_level == OnLevel::High)
    }

    /// Sets the supply of the microcontroller, mV.
    pub fn set_supply(&mut self, millivolts: u32) {
        self.part.set_supply(millivolts);
    }

    /// Compares the settings of the receiver's port with those of its line: within 3 % of the baud rate, the same parity and
    /// stop bits. With other settings all bytes get framing errors.
    pub fn check_receiver_line(&mut self) {
        use rigless::soc::stm32f427::generated::usart6::{Register, cr1, cr2};
        let line = self.receiver().protocol.line();
        let instance = SERIAL_PORTS[self.wiring.receiver_usart].instance;
        let Some(registers) = self.part.bus().registers(instance) else { return };
        let divider = registers.get(Register::Brr);
        let (control, stop) = (registers.get(Register::Cr1), registers.get(Register::Cr2));
        let clock_hz = if instance == "USART1" || instance == "USART6" { CORE_HZ / 2 } else { CORE_HZ / 4 };
        let baud = clock_hz.checked_div(divider).unwrap_or(0);
        let wanted = u64::from(line.baud);
        let right = baud.abs_diff(wanted) * 100 <= 3 * wanted
            && cr1::PCE.is_set(control) == line.parity
            && cr1::M.is_set(control) == line.parity
            && !cr1::PS.is_set(control)
            && (cr2::STOP.get(stop) == 2) == (line.stop_bits == 2);
        let framing = &mut self.part.usart[self.wiring.receiver_usart].errors_mut().framing;
        framing.per_million = if right { 0 } else { 1_000_000 };
    }

    /// Updates the state of the pads at `now`, and records the changes.
    pub fn update_pads(&mut self, now: VirtualNanos) {
        self.count_magnetometer_clocks();
        for (n, pad) in self.wiring.pads.iter().enumerate() {
            let pin = pin_of(pad.wire);
            let output = self.part.timer_output(pad.timer, pad.channel, pad.complementary);
            let (_, port) = self.part.port(pad.wire.port);
            let carried = rigless::soc::stm32f427::peripherals::gpio::Gpio::function(pin, port);
            let function = output.filter(|_| carried == Some(pad.function));
            if function != self.functions[n] {
                self.functions[n] = function;
                self.ports_outdated = true;
            }
            let line = match function {
                Some(level) => level.into(),
                None => self.undriven_line(pad),
            };
            if line != self.lines[n] {
                self.lines[n] = line;
                self.edges.push((now.0, n, line));
            }
        }
    }

    /// Returns the state of a pad that its timer does not drive.
    fn undriven_line(&self, pad: &Pad) -> Line {
        use rigless::soc::stm32f427::generated::gpioa::Register;
        let (gpio, registers) = self.part.port(pad.wire.port);
        let field = |register| registers.get(register) >> (2 * pad.wire.pin) & 3;
        let output = field(Register::Moder) == 1;
        let analog = field(Register::Moder) == 3;
        let pulled = field(Register::Pupdr) != 0 && !analog;
        if output || pulled { gpio.level(pin_of(pad.wire), registers).into() } else { Line::Floating }
    }

    /// Passes the levels that the timers drive to the port models. This is done only before a port is accessed, and not at
    /// every edge, to save time.
    fn refresh_ports(&mut self) {
        if !std::mem::take(&mut self.ports_outdated) {
            return;
        }
        for (pad, function) in self.wiring.pads.iter().zip(self.functions) {
            self.part.drive_port(self.now, pad.wire.port, |gpio, registers, context| {
                gpio.drive_function(pin_of(pad.wire), function, registers, context);
            });
        }
    }

    /// Returns the changes at the pads since the last call.
    pub fn take_edges(&mut self) -> Vec<(u64, usize, Line)> {
        std::mem::take(&mut self.edges)
    }
}

fn pin_of(wire: Wire) -> Pin {
    Pin::new(wire.pin).expect("sixteen pins a port")
}

impl Mcu for Machine {
    fn bus(&self) -> &Bus {
        self.part.bus()
    }

    fn bus_mut(&mut self) -> &mut Bus {
        self.part.bus_mut()
    }

    fn reset(&mut self, at: VirtualNanos, cause: ResetCause) {
        self.part.reset(at, cause);
        self.part.notify_chips_of_reset(at);
        // External levels persist, but the reset port models have lost them: drive them again.
        self.ready = None;
        self.data_held = false;
        self.functions = [None; PADS];
        self.ports_outdated = false;
        self.magnetometer().end_transfer();
        self.update_pads(at);
    }

    fn poll(&mut self, now: VirtualNanos) {
        self.now = now;
        self.part.poll(now);
        let high = self.imu().int1();
        if self.ready != Some(high) {
            self.ready = Some(high);
            let wire = Wire::from(self.wiring.board.imu.ready);
            self.part.drive_port(now, wire.port, |gpio, registers, context| {
                gpio.drive(pin_of(wire), Some(Level::from(high)), registers, context);
            });
        }
        let held = self.part.i2c[self.wiring.magnetometer_i2c].held_low;
        if self.data_held != held {
            self.data_held = held;
            let wire = Wire::from(self.wiring.board.magnetometer.sda.pin);
            self.part.drive_port(now, wire.port, |gpio, registers, context| {
                gpio.drive(pin_of(wire), held.then_some(Level::Low), registers, context);
            });
        }
        let low = self.part.supply_is_low();
        if self.supply_low != low {
            self.supply_low = low;
            self.part.drive_exti(now, PVD_LINE, low);
        }
        let touched = self.wiring.pads.iter().map(|pad| pad.timer);
        if touched.fold(false, |any, timer| any | self.part.take_touched(timer)) {
            self.update_pads(now);
        }
    }

    fn split(&mut self, slot: usize) -> (&mut Bus, Option<&mut dyn ErasedDevice>) {
        if self.ports_outdated && self.pad_ports.contains(&slot) {
            self.refresh_ports();
        }
        self.part.split(slot)
    }
}

/// The board, with one microcontroller.
#[derive(Debug)]
pub struct FlightBoard {
    /// Microcontroller with its wired pins.
    pub machine: Machine,
    /// Wiring of the board.
    pub wiring: Arc<Wiring>,
    name: &'static str,
    factory: Image,
}

impl FlightBoard {
    /// Returns the board before power-on.
    ///
    /// # Errors
    /// The description of the microcontroller is inconsistent.
    pub fn new(wiring: Arc<Wiring>, protocol: Protocol) -> Result<Self, Error> {
        // VREFINT_CAL, which ST programs in the factory: the reference's count at 3.3 V (1.21 V / 3.3 V × 4,095 = 1,501.5).
        let calibration = 1_500_u16.to_le_bytes().to_vec();
        let factory = Image::new(Path::new("vrefint_cal"), calibration, Some(0x1fff_7a2a))
            .expect("two bytes at a place of their own");
        // The library requires a static name.
        let name = String::leak(wiring.board.name.clone());
        Ok(Self { machine: Machine::new(wiring.clone(), protocol)?, wiring, name, factory })
    }
}

impl Store for FlightBoard {
    fn store(&self, _: &mut snapshot::Writer) -> Result<(), snapshot::Error> {
        Err(snapshot::Error::Failed)
    }

    fn load(&mut self, _: &mut snapshot::Reader) -> Result<(), snapshot::Error> {
        Err(snapshot::Error::Failed)
    }
}

impl Board for FlightBoard {
    fn name(&self) -> &'static str {
        self.name
    }

    fn target_names(&self) -> Vec<&'static str> {
        vec!["stm32f405"]
    }

    fn mcu(&mut self, target: usize) -> Option<&mut dyn Mcu> {
        (target == 0).then_some(&mut self.machine)
    }

    fn targets(&mut self) -> Vec<Target<'_>> {
        let core = armv7m::Core {
            variant: armv7m::Variant::M4,
            clock_hz: NonZeroU64::new(CORE_HZ).expect("it is not zero"),
            interrupt_lines: NonZeroU32::new(82).expect("it is not zero"),
            priority_bits: 4,
            refclk_divider: NonZeroU32::new(8).expect("it is not zero"),
            instructions_per_second: NonZeroU64::new(INSTRUCTIONS_PER_SECOND).expect("it is not zero"),
            boot: "flash",
        };
        let windows = cpu::windows(self.machine.bus());
        let mut spec = core.spec_with_parts(&windows, armv7m::Fpu::FpV4Sp, armv7m::MpuRegions::Eight);
        spec.factory_images.push(self.factory.clone());
        vec![Target::new("stm32f405", &mut self.machine, spec)]
    }
}
