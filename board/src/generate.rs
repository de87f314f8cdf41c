//! Generator of the firmware's wiring: constants, the peripherals and pins by purpose, and the interrupt handlers whose
//! vectors depend on the board.
//!
//! The generated text is as small as possible: `firmware/src/stm32f405` documents the constants and uses them. Each pin
//! and each DMA stream also appears as a type that exists only if the tables of `stm32f4xx-hal` have the same
//! connection.

use std::fmt::Write as _;

use input::axes::Axes;

use crate::{Board, Connection, Motor, OnLevel, Pin, Stream, Timer};

/// Returns the first channel that DMA writes, counted from 0, and the number of channel pairs: the two neighbouring
/// channels that include all pads of the timer, or all four channels.
fn channels(timer: &Timer, motors: &[Motor; 4]) -> (u8, u8) {
    let used = motors.iter().filter(|motor| motor.connection.peripheral == timer.name);
    let used: Vec<u8> = used.map(|motor| motor.channel - 1).collect();
    match (used.iter().min(), used.iter().max()) {
        (Some(&first), Some(&last)) if last - first <= 1 => (first.min(2), 1),
        _ => (0, 2),
    }
}

/// Returns the letters of the pins' ports, sorted.
fn ports(pins: impl Iterator<Item = Pin>) -> Vec<char> {
    let mut letters: Vec<char> = pins.map(|pin| char::from(b'A' + pin.port)).collect();
    letters.sort_unstable();
    letters.dedup();
    letters
}

/// Returns the pin's field name: `pa5`.
fn field(pin: Pin) -> String {
    pin.to_string().to_lowercase()
}

fn stream(stream: Stream) -> String {
    format!("Stream::new(pac::DMA{}::PTR, {}, {})", stream.controller, stream.number, stream.channel)
}

fn line(pin: Pin) -> String {
    format!("Pin::new(pac::GPIO{}::PTR.cast(), {})", char::from(b'A' + pin.port), pin.number)
}

fn matrix(axes: &Axes) -> String {
    let rows = axes.rows().map(|row| {
        let [x, y, z] = row.map(|value| format!("{value}.0"));
        format!("vec3({x}, {y}, {z})")
    });
    format!("Mat3 {{ rows: [{}] }}", rows.join(", "))
}

/// Writes a function that calls `pac::NAME::METHOD_unchecked` for each name.
fn unchecked(
    out: &mut String,
    function: &str,
    safety: &str,
    method: &str,
    names: &[impl std::fmt::Display],
) -> std::fmt::Result {
    writeln!(out, "/// # Safety\n/// {safety}\npub unsafe fn {function}() {{")?;
    writeln!(out, "    // SAFETY: the caller meets the condition above.\n    unsafe {{")?;
    for name in names {
        writeln!(out, "        pac::{name}::{method}_unchecked();")?;
    }
    writeln!(out, "    }}\n}}")
}

impl Board {
    /// Returns the text of the firmware's `wiring` module.
    pub fn wiring(&self) -> String {
        let mut text = String::new();
        // Writing to a string cannot fail.
        self.write(&mut text).ok();
        text
    }

    fn write(&self, out: &mut String) -> std::fmt::Result {
        let imu = &self.imu;
        let sck = &imu.bus[0];
        let [receive, send] = imu.streams;
        let (i2c, serial) = (&self.magnetometer.scl.peripheral, &self.receiver.peripheral);
        writeln!(out, "pub const TITLE: &str = {:?};", self.title)?;
        writeln!(out, "pub const CRYSTAL_MHZ: u32 = {};", self.crystal_mhz)?;
        writeln!(out, "pub const IMU_MOUNTING: Mat3<f32> = {};", matrix(&imu.axes))?;
        writeln!(out, "pub const IMU: burst::Wiring = burst::Wiring {{")?;
        writeln!(out, "    spi: pac::{}::PTR,", sck.peripheral)?;
        writeln!(out, "    receive: {},", stream(receive))?;
        writeln!(out, "    send: {},", stream(send))?;
        writeln!(out, "    select: {},\n}};", line(imu.select))?;
        let others: Vec<String> = imu.deselect.iter().map(|&pin| line(pin)).collect();
        writeln!(out, "pub const IMU_DESELECT: [Pin; {}] = [{}];", others.len(), others.join(", "))?;
        writeln!(out, "pub const MAGNETOMETER: bus::Wiring = bus::Wiring {{")?;
        writeln!(out, "    i2c: pac::{i2c}::PTR,")?;
        writeln!(out, "    scl: {},", line(self.magnetometer.scl.pin))?;
        writeln!(out, "    sda: {},\n}};", line(self.magnetometer.sda.pin))?;
        let on_apb2 = matches!(serial.as_str(), "USART1" | "USART6");
        writeln!(
            out,
            "pub const RECEIVER: port::Wiring = port::Wiring {{ serial: pac::{serial}::PTR.cast(), on_apb2: {on_apb2} }};"
        )?;
        writeln!(out, "pub const RECEIVER_INTERRUPT: Interrupt = Interrupt::{serial};")?;
        writeln!(out, "pub const READY_LINE: u8 = {};", imu.ready.number)?;
        let vector = self.ready_vector();
        writeln!(out, "pub const READY_INTERRUPT: Interrupt = Interrupt::{vector};")?;
        writeln!(out, "pub const BATTERY_CHANNEL: u8 = {};", self.battery.channel)?;
        writeln!(out, "pub const BATTERY_RATIO: f32 = {:?};", self.battery.ratio)?;
        let on_level = self.led.map_or(OnLevel::Low, |led| led.on_level);
        writeln!(out, "pub const LED_ON: PinState = PinState::{on_level:?};")?;
        self.write_motors(out)?;
        self.write_parts(out)?;
        self.write_checks(out)?;
        writeln!(out, "#[interrupt]\nfn {vector}() {{\n    data_ready();\n}}")?;
        writeln!(out, "#[interrupt]\nfn {serial}() {{\n    receive();\n}}")
    }

    fn write_motors(&self, out: &mut String) -> std::fmt::Result {
        let advanced = |name: &str| matches!(name, "TIM1" | "TIM8");
        writeln!(out, "pub const TIMERS: [Timer; {}] = [", self.timers.len())?;
        for timer in &self.timers {
            let (first, pairs) = channels(timer, &self.motors);
            writeln!(
                out,
                "    Timer {{ registers: pac::{}::PTR.cast(), advanced: {}, stream: {}, first: {first}, pairs: {pairs} }},",
                timer.name,
                advanced(&timer.name),
                stream(timer.stream),
            )?;
        }
        writeln!(out, "];\npub const PADS: [Pad; 4] = [")?;
        for motor in &self.motors {
            writeln!(
                out,
                "    Pad {{ pin: {}, function: {}, timer: pac::{}::PTR.cast(), channel: {}, complementary: {} }},",
                line(motor.connection.pin),
                motor.connection.function,
                motor.connection.peripheral,
                motor.channel - 1,
                motor.complementary
            )?;
        }
        let rotors = self.motors.each_ref().map(|motor| motor.rotor);
        writeln!(out, "];\npub const ROTORS: [usize; 4] = {rotors:?};")?;

        let names: Vec<&str> = self.timers.iter().map(|timer| timer.name.as_str()).collect();
        let mut controllers: Vec<String> =
            self.timers.iter().map(|timer| format!("DMA{}", timer.stream.controller)).collect();
        controllers.sort();
        controllers.dedup();
        let timers = "The caller must be the only user of the timers.";
        let clocked: Vec<&str> =
            names.iter().copied().chain(controllers.iter().map(String::as_str)).collect();
        unchecked(out, "enable_motor_timers", timers, "enable", &clocked)?;
        unchecked(out, "reset_motor_timers", timers, "reset", &names)?;
        let ports = ports(self.motors.iter().map(|motor| motor.connection.pin));
        let ports: Vec<String> = ports.into_iter().map(|letter| format!("GPIO{letter}")).collect();
        unchecked(
            out,
            "enable_motor_ports",
            "The caller must be the only user of the ports.",
            "enable",
            &ports,
        )?;
        writeln!(out, "pub fn hold_motor_timers_in_debug_halts(debug: &pac::DBGMCU) {{")?;
        for name in &names {
            let freeze = if advanced(name) { "apb2_fz" } else { "apb1_fz" };
            let bit = name.to_lowercase();
            writeln!(out, "    debug.{freeze}().modify(|_, w| w.dbg_{bit}_stop().set_bit());")?;
        }
        writeln!(out, "}}")
    }

    /// Writes the struct of the peripherals and pins by purpose. A second use of the same one would not compile,
    /// because it would be moved twice.
    fn write_parts(&self, out: &mut String) -> std::fmt::Result {
        let imu = &self.imu;
        let [sck, miso, mosi] = &imu.bus;
        let pins = [
            ("imu_sck", sck.pin),
            ("imu_miso", miso.pin),
            ("imu_mosi", mosi.pin),
            ("imu_select", imu.select),
            ("imu_ready", imu.ready),
            ("magnetometer_scl", self.magnetometer.scl.pin),
            ("magnetometer_sda", self.magnetometer.sda.pin),
            ("receiver_rx", self.receiver.pin),
            ("battery", self.battery.pin),
        ];
        let peripherals = [
            ("imu_spi", sck.peripheral.as_str()),
            ("_magnetometer_i2c", self.magnetometer.scl.peripheral.as_str()),
            ("_receiver_serial", self.receiver.peripheral.as_str()),
        ];
        let fixed = [
            ("adc1", "ADC1"),
            ("adc_common", "ADC_COMMON"),
            ("dbgmcu", "DBGMCU"),
            ("exti", "EXTI"),
            ("flash", "FLASH"),
            ("iwdg", "IWDG"),
            ("pwr", "PWR"),
            ("syscfg", "SYSCFG"),
            ("tim5", "TIM5"),
        ];
        writeln!(out, "pub struct Parts {{")?;
        for (name, peripheral) in peripherals.into_iter().chain(fixed) {
            writeln!(out, "    pub {name}: pac::{peripheral},")?;
        }
        for (name, pin) in pins {
            writeln!(out, "    pub {name}: gpio::{pin},")?;
        }
        // Without an LED the option is always `None`, and its type may be that of any pin.
        let led = self.led.map_or(imu.select, |led| led.pin);
        writeln!(out, "    pub led: Option<gpio::{led}>,")?;
        let motor_pins: Vec<String> =
            self.motors.iter().map(|motor| format!("gpio::{}", motor.connection.pin)).collect();
        writeln!(out, "    pub _motors: ({}),", motor_pins.join(", "))?;
        writeln!(out, "}}\npub fn split(device: pac::Peripherals) -> (Rcc, Parts) {{")?;
        writeln!(out, "    let mut rcc = device.RCC.constrain();")?;
        let all = pins
            .map(|(_, pin)| pin)
            .into_iter()
            .chain(imu.deselect.iter().copied())
            .chain(self.led.map(|led| led.pin))
            .chain(self.motors.iter().map(|motor| motor.connection.pin));
        for letter in ports(all) {
            let name = format!("gpio{}", letter.to_ascii_lowercase());
            writeln!(out, "    let {name} = device.GPIO{letter}.split(&mut rcc);")?;
        }
        writeln!(out, "    let parts = Parts {{")?;
        for (name, peripheral) in peripherals.into_iter().chain(fixed) {
            writeln!(out, "        {name}: device.{peripheral},")?;
        }
        let taken = |pin: Pin| {
            let letter = char::from(b'a' + pin.port);
            // After a reset these pins belong to the JTAG debug port.
            let jtag = ["PA15", "PB3", "PB4"].contains(&pin.to_string().as_str());
            format!("gpio{letter}.{}{}", field(pin), if jtag { ".into_floating_input()" } else { "" })
        };
        for (name, pin) in pins {
            writeln!(out, "        {name}: {},", taken(pin))?;
        }
        match self.led {
            Some(led) => writeln!(out, "        led: Some({}),", taken(led.pin))?,
            None => writeln!(out, "        led: None,")?,
        }
        let motor_pins: Vec<String> = self.motors.iter().map(|motor| taken(motor.connection.pin)).collect();
        writeln!(out, "        _motors: ({}),", motor_pins.join(", "))?;
        writeln!(out, "    }};\n    (rcc, parts)\n}}")?;
        let Connection { pin, peripheral, function, .. } = &self.receiver;
        writeln!(out, "pub fn connect_receiver(rx: gpio::{pin}, rcc: &mut Rcc) {{")?;
        writeln!(out, "    rx.into_alternate::<{function}>().set_internal_resistor(gpio::Pull::Up);")?;
        writeln!(out, "    pac::{peripheral}::enable(rcc);\n}}")?;
        let (scl, sda) = (&self.magnetometer.scl, &self.magnetometer.sda);
        writeln!(
            out,
            "pub fn connect_magnetometer(scl: gpio::{}, sda: gpio::{}, rcc: &mut Rcc) {{",
            scl.pin, sda.pin
        )?;
        writeln!(out, "    scl.into_alternate_open_drain::<{}>();", scl.function)?;
        writeln!(out, "    sda.into_alternate_open_drain::<{}>();", sda.function)?;
        writeln!(out, "    pac::{}::enable(rcc);\n}}", scl.peripheral)
    }

    /// Writes checks of the connections against the tables of the hardware abstraction layer.
    fn write_checks(&self, out: &mut String) -> std::fmt::Result {
        let [sck, miso, mosi] = &self.imu.bus;
        let camel = |text: &str| {
            let mut letters = text.chars();
            let first = letters.next().into_iter();
            first.chain(letters.map(|letter| letter.to_ascii_lowercase())).collect::<String>()
        };
        let fits = |connection: &Connection, signal: &str| {
            let module = connection.peripheral.to_lowercase();
            format!("    pin_has_signal::<gpio::{}, gpio::alt::{module}::{signal}>();", connection.pin)
        };
        writeln!(out, "const _: () = {{")?;
        for connection in [sck, miso, mosi, &self.magnetometer.scl, &self.magnetometer.sda, &self.receiver] {
            writeln!(out, "{}", fits(connection, &camel(connection.signal)))?;
        }
        for motor in &self.motors {
            let signal = format!("Ch{}{}", motor.channel, if motor.complementary { "N" } else { "" });
            writeln!(out, "{}", fits(&motor.connection, &signal))?;
        }
        let mut served = |peripheral: &str, stream: Stream, direction: &str| {
            writeln!(
                out,
                "    stream_serves::<{peripheral}, dma::Stream{}<pac::DMA{}>, {}, dma::{direction}>();",
                stream.number, stream.controller, stream.channel
            )
        };
        let [receive, send] = self.imu.streams;
        let spi = format!("pac::{}", sck.peripheral);
        served(&spi, receive, "PeripheralToMemory")?;
        served(&spi, send, "MemoryToPeripheral")?;
        for timer in &self.timers {
            served(&format!("DMAR<pac::{}>", timer.name), timer.stream, "MemoryToPeripheral")?;
        }
        writeln!(out, "}};")
    }
}
