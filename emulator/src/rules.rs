//! What data sheets and the reference manual ask of a set-up, and no model misses: whom a pin is connected to, how
//! fast a bus runs, how long a converter samples, in which order a DMA stream is set up.
//!
//! The models answer whatever a register says; a chip on a board does not. What is broken here counts as a gap.

use std::collections::BTreeMap;
use std::sync::Arc;

use rigless::mcu::Mcu as _;
use rigless::soc::stm32f427::generated::{adc1, c_adc, dbg, dma2, gpioa, i2c3, spi1, usart6};
use rigless::soc::stm32f427::peripherals::ADC_COMMON;

use crate::board::{Connection, Drive, Machine, Wire, Wiring};
use crate::chip::stm32f405::PORTS;

/// Clock of APB1, at which I2C1 and USART2 run, and of APB2, Hz: 168 MHz over 4 and over 2.
const APB1_HZ: u64 = 42_000_000;
const APB2_HZ: u64 = 84_000_000;

/// Something is broken if it stands for so many looks, a millisecond apart: a driver may be in the middle of it.
const LOOKS: u32 = 4;

/// Channel of the reference, and how long it must be sampled (DS8626, table 71: 10 µs at least).
const REFERENCE: u64 = 17;
const REFERENCE_SAMPLED_S: f64 = 10e-6;
/// Largest clock of the converters, Hz (DS8626, table 67).
const CONVERTER_MAX_HZ: u64 = 36_000_000;
/// Cycles of SMPx (RM0090, 13.13.4).
const SAMPLE_CYCLES: [u64; 8] = [3, 15, 28, 56, 84, 112, 144, 480];

/// The rules, and which were broken.
pub struct Rules {
    wiring: Arc<Wiring>,
    standing: BTreeMap<String, u32>,
    broken: BTreeMap<String, f64>,
    /// Streams of both controllers that were on at the last access since the last reset.
    streams_on: u32,
    resets: usize,
}

impl Rules {
    /// The rules of a board.
    pub fn new(wiring: Arc<Wiring>) -> Self {
        Self { wiring, standing: BTreeMap::new(), broken: BTreeMap::new(), streams_on: 0, resets: 0 }
    }

    /// Looks at the set-up: once a millisecond.
    pub fn look(&mut self, machine: &Machine, now_s: f64) {
        let found = [
            self.pins(machine),
            magnetometer_bus(machine, &self.wiring),
            imu_bus(machine, &self.wiring),
            converter(machine),
            halts(machine, &self.wiring),
        ];
        let found: Vec<String> = found.into_iter().flatten().collect();
        self.standing.retain(|what, _| found.contains(what));
        for what in found {
            let looks = self.standing.entry(what.clone()).or_insert(0);
            *looks += 1;
            if *looks == LOOKS {
                self.broken.entry(what).or_insert(now_s);
            }
        }
    }

    /// The microcontroller has been reset so often: a reset switches all streams off.
    pub fn restarted(&mut self, resets: usize) {
        if resets != self.resets {
            self.resets = resets;
            self.streams_on = 0;
        }
    }

    /// A register of a DMA controller was accessed, and written to if `written`: a stream that is switched on has no flag of
    /// an earlier transfer (RM0090, 10.3.17, "before setting EN"), its count and addresses are not written to while it is on
    /// (10.5.6 to 10.5.8), and the inertial sensor's streams come before all others of their controller.
    pub fn dma_accessed(&mut self, machine: &Machine, address: u64, written: bool, now_s: f64) {
        use dma2::Register::{Hisr, Lisr, S0cr, S1cr, S2cr, S3cr, S4cr, S5cr, S6cr, S7cr};
        const CONTROLS: [dma2::Register; 8] = [S0cr, S1cr, S2cr, S3cr, S4cr, S5cr, S6cr, S7cr];
        /// Where the six flags of streams 0 to 3 begin in LISR, of 4 to 7 in HISR.
        const FLAGS: [u32; 4] = [0, 6, 16, 22];
        for (controller, name) in ["DMA1", "DMA2"].into_iter().enumerate() {
            let Some(registers) = machine.bus().registers(name) else { continue };
            let number = controller as u8 + 1;
            // Control, count, two addresses: from 0x10 on, 24 bytes for each stream.
            let place = address.wrapping_sub(0x4002_6000 + 0x400 * controller as u64 + 0x10);
            for (stream, control) in CONTROLS.into_iter().enumerate() {
                let bit = 1 << (8 * controller + stream);
                let on = dma2::s0cr::EN.is_set(registers.get(control));
                let status = registers.get(if stream < 4 { Lisr } else { Hisr });
                let its = place / 24 == stream as u64 && (4..20).contains(&(place % 24));
                if written && its && self.streams_on & bit != 0 {
                    self.broken
                        .entry(format!("{name} stream {stream} is set up anew while it is on"))
                        .or_insert(now_s);
                }
                let sensors = self.wiring.board.imu.streams;
                let of_sensor =
                    sensors.iter().any(|s| (s.controller, usize::from(s.number)) == (number, stream));
                if on && of_sensor && dma2::s0cr::PL.get(registers.get(control)) != 3 {
                    self.broken
                        .entry(format!("{name} stream {stream} must have the highest priority"))
                        .or_insert(now_s);
                }
                if on && self.streams_on & bit == 0 && status >> FLAGS[stream % 4] & 0x3d != 0 {
                    self.broken
                        .entry(format!(
                            "{name} stream {stream} is switched on with flags of an earlier transfer"
                        ))
                        .or_insert(now_s);
                }
                self.streams_on = if on { self.streams_on | bit } else { self.streams_on & !bit };
            }
        }
    }

    /// Whether any was broken so far.
    pub fn is_broken(&self) -> bool {
        !self.broken.is_empty()
    }

    /// What was broken, a line each.
    pub fn violations(&self) -> Vec<String> {
        self.broken.iter().map(|(what, at_s)| format!("{what}, since {at_s:.3} s")).collect()
    }

    fn pins(&self, machine: &Machine) -> Vec<String> {
        let wrong =
            self.wiring.connections.iter().filter(|connection| {
                is_on(machine, &connection.instance) && !is_connected(machine, connection)
            });
        wrong
            .map(|connection| {
                let port = PORTS[connection.wire.port].trim_start_matches("GPIO");
                let drive = match connection.drive {
                    Drive::PushPull => "",
                    Drive::OpenDrain => ", with an open drain",
                    Drive::PulledUp => ", with a pull-up",
                };
                format!(
                    "P{port}{} is not {} of {} (alternate function {}{drive})",
                    connection.wire.pin, connection.signal, connection.instance, connection.function
                )
            })
            .collect()
    }
}

/// Whether an instance is switched on.
fn is_on(machine: &Machine, instance: &str) -> bool {
    let Some(registers) = machine.bus().registers(instance) else { return false };
    match &instance[..instance.len() - 1] {
        "I2C" => i2c3::cr1::PE.is_set(registers.get(i2c3::Register::Cr1)),
        "SPI" => spi1::cr1::SPE.is_set(registers.get(spi1::Register::Cr1)),
        "USART" | "UART" => usart6::cr1::UE.is_set(registers.get(usart6::Register::Cr1)),
        _ => false,
    }
}

fn is_connected(machine: &Machine, connection: &Connection) -> bool {
    let (_, port) = machine.part.port(connection.wire.port);
    let pin = connection.wire.pin;
    let mode = port.get(gpioa::Register::Moder) >> (2 * pin) & 3;
    let functions = if pin < 8 { gpioa::Register::Afrl } else { gpioa::Register::Afrh };
    let function = port.get(functions) >> (4 * (pin % 8)) & 0xf;
    let open_drain = port.get(gpioa::Register::Otyper) >> pin & 1 == 1;
    let pull = port.get(gpioa::Register::Pupdr) >> (2 * pin) & 3;
    mode == 2
        && function == connection.function
        && match connection.drive {
            Drive::PushPull => !open_drain,
            Drive::OpenDrain => open_drain,
            Drive::PulledUp => pull == 1,
        }
}

/// RM0090, 27.6.2, 27.6.8 and 27.6.9; a transfer is short, and ends with a stop.
fn magnetometer_bus(machine: &Machine, wiring: &Wiring) -> Vec<String> {
    let instance = wiring.board.magnetometer.scl.peripheral.as_str();
    if !is_on(machine, instance) {
        return Vec::new();
    }
    let Some(registers) = machine.bus().registers(instance) else { return Vec::new() };
    let mut broken = Vec::new();
    let get = |register| registers.get(register);
    if i2c3::cr2::FREQ.get(get(i2c3::Register::Cr2)) != APB1_HZ / 1_000_000 {
        broken.push(format!("{instance}.CR2: FREQ is not APB1's clock in MHz"));
    }
    let ccr = get(i2c3::Register::Ccr);
    let fast = i2c3::ccr::F_S.is_set(ccr);
    let periods = match (fast, i2c3::ccr::DUTY.is_set(ccr)) {
        (false, _) => 2,
        (true, false) => 3,
        (true, true) => 25,
    };
    let rate_hz = APB1_HZ.checked_div(periods * i2c3::ccr::CCR.get(ccr)).unwrap_or(0);
    if rate_hz.abs_diff(wiring.magnetometer_hz) * 20 > wiring.magnetometer_hz {
        broken.push(format!(
            "{instance} runs at {rate_hz} bits a second; the bus at {}",
            wiring.magnetometer_hz
        ));
    }
    // Rise times up to 300 ns in fast mode, 1,000 ns in standard mode (UM10204, table 10).
    let rise = APB1_HZ / 1_000_000 * if fast { 300 } else { 1_000 } / 1_000 + 1;
    if i2c3::trise::TRISE.get(get(i2c3::Register::Trise)) != rise {
        broken.push(format!("{instance}.TRISE is not the bus's rise time, {rise}"));
    }
    // 32 bytes take less than a millisecond.
    if i2c3::sr2::BUSY.is_set(get(i2c3::Register::Sr2)) && machine.magnetometer_bus_is_free() {
        broken.push(format!("{instance}: a transfer does not end with a stop"));
    }
    if machine.magnetometer_bus_is_free() && machine.magnetometer_sends_on() {
        broken.push(format!(
            "{instance} acknowledged the last byte of a transfer, and the sensor goes on to send"
        ));
    }
    broken
}

/// The inertial sensor takes mode 0 and mode 3.
fn imu_bus(machine: &Machine, wiring: &Wiring) -> Vec<String> {
    let instance = wiring.board.imu.bus[0].peripheral.as_str();
    let Some(registers) = machine.bus().registers(instance).filter(|_| is_on(machine, instance)) else {
        return Vec::new();
    };
    let mut broken = Vec::new();
    let control = registers.get(spi1::Register::Cr1);
    let rate_hz = APB2_HZ >> (spi1::cr1::BR.get(control) + 1);
    if rate_hz > wiring.imu_max_hz {
        broken.push(format!(
            "{instance} runs at {rate_hz} bits a second; the sensor takes {}",
            wiring.imu_max_hz
        ));
    }
    if spi1::cr1::CPOL.is_set(control) != spi1::cr1::CPHA.is_set(control) {
        broken.push(format!("{instance} is neither in mode 0 nor in mode 3"));
    }
    for &pin in &wiring.board.imu.deselect {
        let wire = Wire::from(pin);
        let (_, port) = machine.part.port(wire.port);
        let output = port.get(gpioa::Register::Moder) >> (2 * wire.pin) & 3 == 1;
        let high = port.get(gpioa::Register::Odr) >> wire.pin & 1 == 1;
        if !output || !high {
            broken.push(format!("{pin} selects another chip on {instance}, and is not held high"));
        }
    }
    broken
}

fn converter(machine: &Machine) -> Vec<String> {
    let bus = machine.bus();
    let (Some(adc), Some(common)) = (bus.registers("ADC1"), bus.registers(ADC_COMMON)) else {
        return Vec::new();
    };
    if !adc1::cr2::ADON.is_set(adc.get(adc1::Register::Cr2)) {
        return Vec::new();
    }
    let mut broken = Vec::new();
    let common = common.get(c_adc::Register::Ccr);
    let clock_hz = APB2_HZ / (2 * (c_adc::ccr::ADCPRE.get(common) + 1));
    if clock_hz > CONVERTER_MAX_HZ {
        broken.push(format!("ADC1 runs at {clock_hz} Hz; it may at {CONVERTER_MAX_HZ}"));
    }
    let sequence = adc.get(adc1::Register::Jsqr);
    let length = adc1::jsqr::JL.get(sequence) + 1;
    let channels: Vec<u64> = (4 - length..4).map(|place| sequence >> (5 * place) & 0x1f).collect();
    if length > 1 && !adc1::cr1::SCAN.is_set(adc.get(adc1::Register::Cr1)) {
        broken.push("ADC1 converts several channels without SCAN".into());
    }
    if channels.contains(&REFERENCE) {
        // SMPR1 holds channels 10 to 18, three bits each.
        let field = adc.get(adc1::Register::Smpr1) >> (3 * (REFERENCE - 10)) & 7;
        let sampled_s = SAMPLE_CYCLES[field as usize] as f64 / clock_hz as f64;
        if sampled_s < REFERENCE_SAMPLED_S {
            broken.push(format!("the reference is sampled for {:.1} us; it needs 10", sampled_s * 1e6));
        }
        if !c_adc::ccr::TSVREFE.is_set(common) {
            broken.push("the reference is converted, and not switched on".into());
        }
    }
    broken
}

/// While a debug probe halts the core the motors' timers and the watchdog stand, and the core's clock runs on in its
/// sleep (docs/hardware.md). From when the inertial sensor's bus is set up, which comes later.
fn halts(machine: &Machine, wiring: &Wiring) -> Vec<String> {
    let Some(debug) = machine.bus().registers("DBG").filter(|_| is_on(machine, "SPI1")) else {
        return Vec::new();
    };
    let on_apb1 = debug.get(dbg::Register::DbgmcuApb1Fz);
    let on_apb2 = debug.get(dbg::Register::DbgmcuApb2Fz);
    let control = debug.get(dbg::Register::DbgmcuCr);
    let mut broken = Vec::new();
    let motors = wiring.board.timers.iter().map(|timer| timer.name.as_str());
    for name in motors.chain(["IWDG"]) {
        // RM0090, 38.16.4 and 38.16.5.
        let held = match name {
            "TIM1" => on_apb2 & 1,
            "TIM8" => on_apb2 >> 1 & 1,
            "TIM2" => on_apb1 & 1,
            "TIM3" => on_apb1 >> 1 & 1,
            "TIM4" => on_apb1 >> 2 & 1,
            _ => on_apb1 >> 12 & 1,
        };
        if held == 0 {
            broken.push(format!("{name} goes on while a probe halts the core"));
        }
    }
    if control & 1 == 0 {
        broken.push("a probe can't read the memory while the core sleeps".into());
    }
    broken
}
