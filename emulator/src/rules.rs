//! Rules of the data sheets and of the reference manual for the settings of the peripherals: the function of a pin, the
//! rate of a bus, the sampling time of the converter, the order in which a DMA stream is set up.
//!
//! The models accept any settings; a chip on a board does not. A broken rule therefore counts as a gap.

use std::collections::BTreeMap;
use std::sync::Arc;

use rigless::mcu::Mcu as _;
use rigless::soc::stm32f427::generated::{adc1, c_adc, dbg, dma2, gpioa, i2c3, spi1, usart6};
use rigless::soc::stm32f427::peripherals::ADC_COMMON;

use crate::board::{Connection, Drive, Machine, Wire, Wiring};
use crate::chip::stm32f405::PORTS;

/// Clock of APB1, which drives I2C1 and USART2, Hz: 168 MHz / 4.
const APB1_HZ: u64 = 42_000_000;
/// Clock of APB2, Hz: 168 MHz / 2.
const APB2_HZ: u64 = 84_000_000;

/// Number of consecutive checks, a millisecond apart, after which a violation counts: until then, the driver may still be
/// changing the settings.
const CHECKS: u32 = 4;

/// ADC channel of the internal reference.
const REFERENCE: u64 = 17;
/// Minimum sampling time of the internal reference, s (DS8626, table 71).
const REFERENCE_SAMPLED_S: f64 = 10e-6;
/// Maximum clock of the converters, Hz (DS8626, table 67).
const CONVERTER_MAX_HZ: u64 = 36_000_000;
/// Sampling times of the values of SMPx, cycles (RM0090, 13.13.4).
const SAMPLE_CYCLES: [u64; 8] = [3, 15, 28, 56, 84, 112, 144, 480];

/// The rules of a board, and those that were broken.
pub struct Rules {
    wiring: Arc<Wiring>,
    /// Present violations, with the number of consecutive checks that found them.
    pending: BTreeMap<String, u32>,
    /// Broken rules, with the time of the violation, s.
    broken: BTreeMap<String, f64>,
    /// The DMA streams of both controllers that were enabled at the last access, one bit for each. A reset clears the
    /// bits.
    streams_on: u32,
    resets: usize,
}

impl Rules {
    /// Returns the rules of a board.
    pub fn new(wiring: Arc<Wiring>) -> Self {
        Self { wiring, pending: BTreeMap::new(), broken: BTreeMap::new(), streams_on: 0, resets: 0 }
    }

    /// Checks the settings; call it once a millisecond.
    pub fn check(&mut self, machine: &Machine, now_s: f64) {
        let found = [
            self.pins(machine),
            magnetometer_bus(machine, &self.wiring),
            imu_bus(machine, &self.wiring),
            converter(machine),
            halts(machine, &self.wiring),
        ];
        let found: Vec<String> = found.into_iter().flatten().collect();
        self.pending.retain(|violation, _| found.contains(violation));
        for violation in found {
            let checks = self.pending.entry(violation.clone()).or_insert(0);
            *checks += 1;
            if *checks == CHECKS {
                self.broken.entry(violation).or_insert(now_s);
            }
        }
    }

    /// Updates the number of resets of the microcontroller. A reset disables all streams.
    pub fn update_resets(&mut self, resets: usize) {
        if resets != self.resets {
            self.resets = resets;
            self.streams_on = 0;
        }
    }

    /// Checks the DMA streams after an access to a register of a DMA controller; `written` says whether it was a write.
    ///
    /// Checks three rules. A stream has no flag of an earlier transfer when it is enabled (RM0090, 10.3.17, "before
    /// setting EN"). Its count and addresses are not written while it is enabled (10.5.6 to 10.5.8). The IMU's streams
    /// have the highest priority of their controller.
    pub fn on_dma_access(&mut self, machine: &Machine, address: u64, written: bool, now_s: f64) {
        use dma2::Register::{Hisr, Lisr, S0cr, S1cr, S2cr, S3cr, S4cr, S5cr, S6cr, S7cr};
        const CONTROLS: [dma2::Register; 8] = [S0cr, S1cr, S2cr, S3cr, S4cr, S5cr, S6cr, S7cr];
        /// Position of the first of a stream's six flags: streams 0 to 3 in LISR, 4 to 7 in HISR.
        const FLAGS: [u32; 4] = [0, 6, 16, 22];
        for (controller, name) in ["DMA1", "DMA2"].into_iter().enumerate() {
            let Some(registers) = machine.bus().registers(name) else { continue };
            let number = controller as u8 + 1;
            // The registers of the streams begin at offset 0x10, 24 bytes for each: control, count, three addresses, FIFO.
            let offset = address.wrapping_sub(0x4002_6000 + 0x400 * controller as u64 + 0x10);
            for (stream, control) in CONTROLS.into_iter().enumerate() {
                let bit = 1 << (8 * controller + stream);
                let on = dma2::s0cr::EN.is_set(registers.get(control));
                let status = registers.get(if stream < 4 { Lisr } else { Hisr });
                let is_count_or_address = offset / 24 == stream as u64 && (4..20).contains(&(offset % 24));
                if written && is_count_or_address && self.streams_on & bit != 0 {
                    self.broken
                        .entry(format!(
                            "{name} stream {stream}: count or address is written while it is enabled"
                        ))
                        .or_insert(now_s);
                }
                let sensors = self.wiring.board.imu.streams;
                let of_sensor =
                    sensors.iter().any(|s| (s.controller, usize::from(s.number)) == (number, stream));
                if on && of_sensor && dma2::s0cr::PL.get(registers.get(control)) != 3 {
                    self.broken
                        .entry(format!("{name} stream {stream}: must have the highest priority"))
                        .or_insert(now_s);
                }
                if on && self.streams_on & bit == 0 && status >> FLAGS[stream % 4] & 0x3d != 0 {
                    self.broken
                        .entry(format!(
                            "{name} stream {stream}: is enabled with flags of an earlier transfer"
                        ))
                        .or_insert(now_s);
                }
                self.streams_on = if on { self.streams_on | bit } else { self.streams_on & !bit };
            }
        }
    }

    /// Returns whether a rule was broken.
    pub fn is_broken(&self) -> bool {
        !self.broken.is_empty()
    }

    /// Returns the violations, one line each.
    pub fn violations(&self) -> Vec<String> {
        self.broken.iter().map(|(violation, at_s)| format!("{violation}, since {at_s:.3} s")).collect()
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
                    "P{port}{}: must be {} of {} (alternate function {}{drive})",
                    connection.wire.pin, connection.signal, connection.instance, connection.function
                )
            })
            .collect()
    }
}

/// Returns whether an instance is enabled.
fn is_on(machine: &Machine, instance: &str) -> bool {
    let Some(registers) = machine.bus().registers(instance) else { return false };
    match &instance[..instance.len() - 1] {
        "I2C" => i2c3::cr1::PE.is_set(registers.get(i2c3::Register::Cr1)),
        "SPI" => spi1::cr1::SPE.is_set(registers.get(spi1::Register::Cr1)),
        "USART" | "UART" => usart6::cr1::UE.is_set(registers.get(usart6::Register::Cr1)),
        _ => false,
    }
}

/// Returns whether the pin of a connection has the right mode, function, output type and pull.
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

/// Checks the magnetometer's I2C: its clock settings (RM0090, 27.6.2, 27.6.8 and 27.6.9), and that each transfer is short
/// and ends with a stop condition.
fn magnetometer_bus(machine: &Machine, wiring: &Wiring) -> Vec<String> {
    let instance = wiring.board.magnetometer.scl.peripheral.as_str();
    if !is_on(machine, instance) {
        return Vec::new();
    }
    let Some(registers) = machine.bus().registers(instance) else { return Vec::new() };
    let mut broken = Vec::new();
    let get = |register| registers.get(register);
    if i2c3::cr2::FREQ.get(get(i2c3::Register::Cr2)) != APB1_HZ / 1_000_000 {
        broken.push(format!("{instance}.CR2: FREQ must be APB1's clock, {} MHz", APB1_HZ / 1_000_000));
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
        broken.push(format!("{instance}: bit rate is {rate_hz} Hz, must be {} Hz", wiring.magnetometer_hz));
    }
    // The rise time is at most 300 ns in fast mode and 1,000 ns in standard mode (UM10204, table 10).
    let rise = APB1_HZ / 1_000_000 * if fast { 300 } else { 1_000 } / 1_000 + 1;
    if i2c3::trise::TRISE.get(get(i2c3::Register::Trise)) != rise {
        broken.push(format!("{instance}.TRISE: must be the bus's rise time, {rise}"));
    }
    // 32 bytes take less than a millisecond.
    if i2c3::sr2::BUSY.is_set(get(i2c3::Register::Sr2)) && machine.magnetometer_bus_is_free() {
        broken.push(format!("{instance}: a transfer does not end with a stop condition"));
    }
    if machine.magnetometer_bus_is_free() && machine.magnetometer_sends_on() {
        broken.push(format!(
            "{instance}: the last byte of a transfer was acknowledged, so the sensor continues to send"
        ));
    }
    broken
}

/// Checks the IMU's SPI: its bit rate, its mode (the sensor supports modes 0 and 3), and the chip selects of other
/// chips on the bus.
fn imu_bus(machine: &Machine, wiring: &Wiring) -> Vec<String> {
    let instance = wiring.board.imu.bus[0].peripheral.as_str();
    let Some(registers) = machine.bus().registers(instance).filter(|_| is_on(machine, instance)) else {
        return Vec::new();
    };
    let mut broken = Vec::new();
    let control = registers.get(spi1::Register::Cr1);
    let rate_hz = APB2_HZ >> (spi1::cr1::BR.get(control) + 1);
    if rate_hz > wiring.imu_max_hz {
        broken
            .push(format!("{instance}: bit rate is {rate_hz} Hz, must be at most {} Hz", wiring.imu_max_hz));
    }
    if spi1::cr1::CPOL.is_set(control) != spi1::cr1::CPHA.is_set(control) {
        broken.push(format!("{instance}: must be in SPI mode 0 or 3"));
    }
    for &pin in &wiring.board.imu.deselect {
        let wire = Wire::from(pin);
        let (_, port) = machine.part.port(wire.port);
        let output = port.get(gpioa::Register::Moder) >> (2 * wire.pin) & 3 == 1;
        let high = port.get(gpioa::Register::Odr) >> wire.pin & 1 == 1;
        if !output || !high {
            broken.push(format!("{pin}: must be high, because it selects another chip on {instance}"));
        }
    }
    broken
}

/// Checks ADC1: its clock, its scan mode and the sampling of the internal reference.
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
        broken.push(format!("ADC1: clock is {clock_hz} Hz, must be at most {CONVERTER_MAX_HZ} Hz"));
    }
    let sequence = adc.get(adc1::Register::Jsqr);
    let length = adc1::jsqr::JL.get(sequence) + 1;
    let channels: Vec<u64> = (4 - length..4).map(|place| sequence >> (5 * place) & 0x1f).collect();
    if length > 1 && !adc1::cr1::SCAN.is_set(adc.get(adc1::Register::Cr1)) {
        broken.push("ADC1: must have SCAN set to convert several channels".into());
    }
    if channels.contains(&REFERENCE) {
        // SMPR1 holds channels 10 to 18, three bits each.
        let field = adc.get(adc1::Register::Smpr1) >> (3 * (REFERENCE - 10)) & 7;
        let sampled_s = SAMPLE_CYCLES[field as usize] as f64 / clock_hz as f64;
        if sampled_s < REFERENCE_SAMPLED_S {
            broken.push(format!(
                "ADC1: the reference is sampled for {:.1} us, must be at least 10 us",
                sampled_s * 1e6
            ));
        }
        if !c_adc::ccr::TSVREFE.is_set(common) {
            broken.push("ADC1: the reference is converted but not enabled (TSVREFE)".into());
        }
    }
    broken
}

/// Checks the debug settings (docs/hardware.md): while a debug probe halts the core, the motors' timers and the watchdog stop,
/// and the core's clock continues in sleep mode. The check begins when SPI1 is enabled, because the firmware makes these
/// settings before that.
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
            broken.push(format!("{name}: must stop while a probe halts the core"));
        }
    }
    if control & 1 == 0 {
        broken.push(
            "DBGMCU_CR: DBG_SLEEP must be set, so that a probe can read the memory while the core sleeps"
                .into(),
        );
    }
    broken
}
