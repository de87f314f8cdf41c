//! A board as a wiring table, and the microcontroller with what is soldered and plugged to it.

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
use crate::chip::stm32f405::{PORTS, Stm32f405, TimerPlace};
use crate::imu::Imu;
use crate::magnetometer::Magnetometer;
use crate::pads::{Line, PADS};
use crate::rc_receiver::{Protocol, RcReceiver};
use crate::timing::{HANDLERS, Handler, INSTRUCTIONS_PER_SECOND, handlers};

/// The core's clock once the firmware has set it up, which times SysTick, Hz.
const CORE_HZ: u64 = 168_000_000;

/// Place of the inertial sensor's SPI among SPI1 to SPI3: the firmware takes SPI1.
const IMU_SPI: usize = 0;

/// Supply of the microcontroller, mV.
pub const SUPPLY_MV: u32 = 3_300;

/// A pin: port (0 for A) and number.
#[derive(Clone, Copy, Debug)]
pub struct Wire {
    /// 0 for port A.
    pub port: usize,
    /// 0 to 15.
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
    /// Its name on the board.
    pub name: &'static str,
    /// Its pin.
    pub wire: Wire,
    /// Alternate function by which the pin carries its timer's output.
    pub function: u8,
    /// Its timer.
    pub timer: TimerPlace,
    /// 1 to 4.
    pub channel: u8,
    /// It is the channel's complementary output.
    pub complementary: bool,
    /// The rotor whose ESC is plugged there, 0 for the front left, clockwise.
    pub rotor: usize,
}

/// What else a pin of a peripheral must be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Drive {
    /// Driven both ways, or an input.
    PushPull,
    /// Driven low only.
    OpenDrain,
    /// An input that is high while nobody drives it.
    PulledUp,
}

/// A pin of a peripheral.
#[derive(Clone, Debug)]
pub struct Connection {
    /// The pin.
    pub wire: Wire,
    /// The peripheral, as RM0090 calls it.
    pub instance: String,
    /// Its signal.
    pub signal: &'static str,
    /// Alternate function by which the pin carries it (DS8626, table 9).
    pub function: u64,
    /// What else the pin must be.
    pub drive: Drive,
}

/// What is wired to what: a board in a vehicle.
#[derive(Debug)]
pub struct Wiring {
    /// The board.
    pub board: ::board::Board,
    /// How the inertial sensor lies in the vehicle.
    pub imu_axes: Axes,
    /// Largest bit rate that it takes.
    pub imu_max_hz: u64,
    /// How the magnetometer lies in the vehicle.
    pub magnetometer_axes: Axes,
    /// Bits a second on its bus.
    pub magnetometer_hz: u64,
    /// Its I2C, 0 for I2C1.
    pub magnetometer_i2c: usize,
    /// Serial port of the receiver, by its place in `rigless`'s list.
    pub receiver_usart: usize,
    /// The motor pads.
    pub pads: [Pad; PADS],
    /// The other pins of peripherals.
    pub connections: Vec<Connection>,
    /// The handlers that run in flight.
    pub handlers: [Handler; HANDLERS],
}

impl Wiring {
    /// A board as it is built into a vehicle.
    ///
    /// # Panics
    /// The board has a timer or a serial port that the chip does not have: its file was not checked.
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
            timer: TimerPlace::of(&motor.connection.peripheral).expect("a timer of the chip"),
            channel: motor.channel,
            complementary: motor.complementary,
            rotor: motor.rotor,
        });
        let serial = board.receiver.peripheral.as_str();
        let magnetometer_i2c = board.magnetometer.scl.peripheral.trim_start_matches("I2C").parse::<usize>();
        Self {
            imu_axes: board.imu.axes.within(&vehicle.board_axes),
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

/// A count of the chips on the boards: the ICM-42688-P at ±2,000 °/s and ±16 g (DS-000347, tables 1 and 2), rad/s and
/// m/s²; the QMC5883L at ±8 G (its data sheet, table 2), µT.
const PER_COUNT: [(&str, f64); 3] = [
    ("gyroscope", 2_000.0 / 32_768.0 * std::f64::consts::PI / 180.0),
    ("accelerometer", 16.0 / 32_768.0 * 9.806_65),
    ("magnetometer", 100.0 / 3_000.0),
];

impl Wiring {
    /// Whether the scene's sensors are those of the board.
    ///
    /// # Errors
    /// They count in other units: a board with such chips would have another image.
    pub fn check(&self, scene: &Scene) -> Result<(), InputError> {
        let params = &scene.config.params;
        let counts = [params.gyro, params.accel, params.mag].map(|sensor| f64::from(sensor.per_count));
        for ((sensor, expected), per_count) in PER_COUNT.into_iter().zip(counts) {
            if (per_count / expected - 1.0).abs() > 1.0e-3 {
                let allowed = format!(
                    "the scene's {sensor} is not that of the {}, which has an ICM-42688-P and a QMC5883L: \
                     take imu = \"icm-42688-p\"",
                    self.board.title
                );
                return Err(InputError::new(allowed).file(&scene.name).field("imu"));
            }
        }
        Ok(())
    }
}

/// A vector of counts along the body's axes, along the chip's.
pub fn to_chip(axes: &Axes, body: [i16; 3]) -> [i16; 3] {
    axes.back(body.map(i32::from)).map(|counts| {
        // The chip's lowest value is −32,766; only the largest number has no negative.
        counts.clamp(i32::from(i16::MIN), i32::from(i16::MAX)) as i16
    })
}

/// Whether a register at this address is one of DMA1 or DMA2.
pub fn is_dma(address: u64) -> bool {
    matches!(address, 0x4002_6000..0x4002_6800)
}

/// The microcontroller with its pins wired.
#[derive(Debug)]
pub struct Machine {
    /// The microcontroller.
    pub part: Stm32f405,
    wiring: Arc<Wiring>,
    ready: Option<bool>,
    supply_low: bool,
    data_held: bool,
    /// Clocks after which the sensor lets the data line go.
    clocks_left: Option<u32>,
    magnetometer_clock: bool,
    functions: [Option<Level>; PADS],
    /// The ports do not know the functions yet.
    stale: bool,
    now: VirtualNanos,
    pad_ports: Vec<usize>,
    /// Registers by which the level of a motor pad may be changed: those of the timers, and the others.
    motor_timers: Vec<Range<u64>>,
    motor_others: Vec<Range<u64>>,
    lines: [Line; PADS],
    /// Changes at the pads since they were last taken: when (ns), pad, what.
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
            stale: false,
            now: VirtualNanos(0),
            pad_ports,
            motor_timers,
            motor_others,
            lines: [Line::Floating; PADS],
            edges: Vec::new(),
        })
    }

    /// Whether a register at this address is one of the motors' timers.
    pub fn is_motor_timer(&self, address: u64) -> bool {
        self.motor_timers.iter().any(|range| range.contains(&address))
    }

    /// Whether a register at this address may change what a motor pad carries: the timers, the ports, clocks and resets.
    pub fn touches_pads(&self, address: u64) -> bool {
        self.is_motor_timer(address) || self.motor_others.iter().any(|range| range.contains(&address))
    }

    /// The inertial sensor.
    pub fn imu(&mut self) -> &mut Imu {
        self.part.spi[IMU_SPI].chip_mut(0).expect("it was attached")
    }

    /// The magnetometer.
    pub fn magnetometer(&mut self) -> &mut Magnetometer {
        self.part.i2c[self.wiring.magnetometer_i2c].interface.chip_mut(0).expect("it was attached")
    }

    /// Whether the magnetometer goes on to send ([`Magnetometer::sends_on`]).
    pub fn magnetometer_sends_on(&self) -> bool {
        let peer = self.part.i2c[self.wiring.magnetometer_i2c].interface.peer();
        let magnetometer: Option<&Magnetometer> =
            peer.and_then(|peer| (peer as &dyn std::any::Any).downcast_ref());
        magnetometer.is_some_and(Magnetometer::sends_on)
    }

    /// The receiver.
    pub fn receiver(&mut self) -> &mut RcReceiver {
        self.part.usart[self.wiring.receiver_usart].chip_mut().expect("it was attached")
    }

    /// The battery, V.
    pub fn set_battery(&mut self, volts: f64) {
        let channel = Analog::new(self.wiring.board.battery.channel).expect("a channel of ADC1");
        let millivolts = (volts * 1_000.0 / self.wiring.board.battery.ratio).round().clamp(0.0, 3_300.0);
        self.part.adc[0].set_input(channel, millivolts as u32);
    }

    /// Something holds the I2C data line low, or lets it go.
    pub fn hold_magnetometer_bus(&mut self, held: bool) {
        self.part.i2c[self.wiring.magnetometer_i2c].held_low = held;
        self.clocks_left = None;
    }

    /// The magnetometer was cut off in the middle of a byte: it holds the data line low until it has got so many clocks.
    pub fn hold_magnetometer_bus_for(&mut self, clocks: u32) {
        self.hold_magnetometer_bus(true);
        self.clocks_left = Some(clocks);
    }

    /// Whether nobody holds the magnetometer's data line.
    pub fn magnetometer_bus_is_free(&self) -> bool {
        !self.part.i2c[self.wiring.magnetometer_i2c].held_low
    }

    /// Follows the magnetometer's clock line where the firmware moves it by the pin itself.
    fn follow_magnetometer_clock(&mut self) {
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
            self.magnetometer().finish();
        }
    }

    /// Whether the LED is lit; nobody drives it before the firmware does, and a board may have none.
    pub fn lit(&self) -> bool {
        use rigless::soc::stm32f427::generated::gpioa::Register;
        let Some(led) = self.wiring.board.led else { return false };
        let wire = Wire::from(led.pin);
        let (_, registers) = self.part.port(wire.port);
        let output = registers.get(Register::Moder) >> (2 * wire.pin) & 3 == 1;
        let high = registers.get(Register::Odr) >> wire.pin & 1 == 1;
        output && high == (led.on_level == OnLevel::High)
    }

    /// The supply of the microcontroller, mV.
    pub fn set_supply(&mut self, millivolts: u32) {
        self.part.set_supply(millivolts);
    }

    /// Whether the receiver's port is set up as its line is: within 3 % of the baud rate, the same parity and stop
    /// bits. Bytes that arrive at another port are garbled.
    pub fn check_radio_line(&mut self) {
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

    /// Follows the pads at `now`.
    pub fn follow_pads(&mut self, now: VirtualNanos) {
        self.follow_magnetometer_clock();
        for (n, pad) in self.wiring.pads.iter().enumerate() {
            let pin = pin_of(pad.wire);
            let output = self.part.timer_output(pad.timer, pad.channel, pad.complementary);
            let (_, port) = self.part.port(pad.wire.port);
            let carried = rigless::soc::stm32f427::peripherals::gpio::Gpio::function(pin, port);
            let function = output.filter(|_| carried == Some(pad.function));
            if function != self.functions[n] {
                self.functions[n] = function;
                self.stale = true;
            }
            let line = match function {
                Some(level) => level.into(),
                None => self.line(pad),
            };
            if line != self.lines[n] {
                self.lines[n] = line;
                self.edges.push((now.0, n, line));
            }
        }
    }

    /// What a pad carries that its timer does not drive.
    fn line(&self, pad: &Pad) -> Line {
        use rigless::soc::stm32f427::generated::gpioa::Register;
        let (gpio, registers) = self.part.port(pad.wire.port);
        let field = |register| registers.get(register) >> (2 * pad.wire.pin) & 3;
        let output = field(Register::Moder) == 1;
        let analog = field(Register::Moder) == 3;
        let pulled = field(Register::Pupdr) != 0 && !analog;
        if output || pulled { gpio.level(pin_of(pad.wire), registers).into() } else { Line::Floating }
    }

    /// Tells the ports what the timers drive: for whoever reads the pins. Not at every edge, which nobody reads.
    fn refresh_ports(&mut self) {
        if !std::mem::take(&mut self.stale) {
            return;
        }
        for (pad, function) in self.wiring.pads.iter().zip(self.functions) {
            self.part.drive_port(self.now, pad.wire.port, |gpio, registers, context| {
                gpio.drive_function(pin_of(pad.wire), function, registers, context);
            });
        }
    }

    /// Changes at the pads since this was last asked.
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
        self.part.tell_chips(at);
        // Levels that are put on pins from outside stand; the ports have forgotten them.
        self.ready = None;
        self.data_held = false;
        self.functions = [None; PADS];
        self.stale = false;
        self.magnetometer().finish();
        self.follow_pads(at);
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
            self.follow_pads(now);
        }
    }

    fn split(&mut self, slot: usize) -> (&mut Bus, Option<&mut dyn ErasedDevice>) {
        if self.stale && self.pad_ports.contains(&slot) {
            self.refresh_ports();
        }
        self.part.split(slot)
    }
}

/// The board: one microcontroller.
#[derive(Debug)]
pub struct FlightBoard {
    /// It.
    pub machine: Machine,
    /// What is wired to what.
    pub wiring: Arc<Wiring>,
    name: &'static str,
    factory: Image,
}

impl FlightBoard {
    /// The board with its supply off.
    ///
    /// # Errors
    /// The description does not hold together.
    pub fn new(wiring: Arc<Wiring>, protocol: Protocol) -> Result<Self, Error> {
        // VREFINT_CAL, which ST's factory writes: the reference's count at 3.3 V (1.21 V of 3.3 V in 4,095).
        let calibration = 1_500_u16.to_le_bytes().to_vec();
        let factory = Image::new(Path::new("vrefint_cal"), calibration, Some(0x1fff_7a2a))
            .expect("two bytes at a place of their own");
        // Boards have names that stand, for the library.
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
