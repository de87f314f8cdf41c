//! The microcontroller: its peripheral instances with their addresses, clocks and requests.
//!
//! The instances' addresses, register layouts and clock outputs are those of the STM32F427, without the instances that the
//! F405 lacks. The memory map, the DMA requests of the timers, the external interrupts and the flash array are described
//! here for the F405. The source is RM0090 rev 22, which covers both parts.
//!
//! | Region | Address | Size | |
//! |---|---|---|---|
//! | flash | 0x0800_0000 | 1 MiB | programmed through FLASH |
//! | CCM | 0x1000_0000 | 64 KiB | DMA cannot reach it: [`Stm32f405::unreachable_by_dma`] |
//! | system | 0x1FFF_0000 | 32 KiB | factory calibration |
//! | SRAM | 0x2000_0000 | 112 + 16 KiB | |
//! | backup SRAM | 0x4002_4000 | 4 KiB | |
//!
//! An access to another address is a bus fault.

use std::num::{NonZeroU32, NonZeroU64};
use std::ops::Range;
use std::sync::LazyLock;

use rigless::chip::Timeline;
use rigless::cpu::armv7m::{self, Dwt};
use rigless::device::{DeviceContext, ErasedDevice, Level, RegisterFile, ResetCause};
use rigless::mcu::{Mcu, Operate};
use rigless::snapshot::{self, Store};
use rigless::soc::stm32f427::generated::{self, dbg, pwr, rcc as rcc_registers, rtc as rtc_registers};
use rigless::soc::stm32f427::peripherals::{
    self as parts, ADC_COMMON, ADVANCED_TIMERS, CONTROLLERS, CONVERTERS, I2C_INTERFACES, SERIAL_PORTS, TIMERS,
};
use rigless::soc::stm32f427::{self, CPU};
use rigless::soc::{Bus, EraseBlocks, Error, Gate, Peripheral, Region, WriteModify, find_field};
use rigless::time::VirtualNanos;

use parts::adc::{Adc, AdcCommon};
use parts::dbg::Dbg;
use parts::dma::{Dma, Wire};
use parts::flash::{self, Flash};
use parts::gpio::Gpio;
use parts::i2c::I2c as I2cInterface;
use parts::iwdg::Iwdg;
use parts::pwr::Pwr;
use parts::rcc::{self, Rcc};
use parts::rtc::Rtc;
use parts::spi::Spi;
use parts::tim::{Advanced, General, Tim, UPDATE_REQUEST};
use parts::usart::Usart;

use super::exti::{self, Exti, Syscfg};
use super::flash::FlashArray;
use super::i2c::I2c;
use super::timer::Timer;

const fn sectors(bytes: u64, count: u32) -> EraseBlocks {
    match (NonZeroU64::new(bytes), NonZeroU32::new(count)) {
        (Some(size), Some(count)) => EraseBlocks { size, count },
        _ => panic!("a sector has bytes"),
    }
}

static SECTORS: [EraseBlocks; 3] = [sectors(16 << 10, 4), sectors(64 << 10, 1), sectors(128 << 10, 7)];

/// The core-coupled memory: first address and size, bytes.
const CCM: (u64, u64) = (0x1000_0000, 64 << 10);

static MEMORY: [Region; 5] = [
    Region::flash("flash", super::flash::BASE, 1 << 20)
        .erased_in(&SECTORS)
        .erased_to(0xff)
        .programmed_by("FLASH"),
    Region::ram("ccm", CCM.0, CCM.1),
    Region::system("system", 0x1fff_0000, 32 << 10),
    Region::ram("sram", 0x2000_0000, (112 + 16) << 10),
    Region::ram("backup_sram", 0x4002_4000, 4 << 10),
];

/// Instances of the STM32F427 that the F405 lacks (RM0090, table 1).
const ABSENT: [&str; 12] =
    ["UART7", "UART8", "SPI4", "SPI5", "SPI6", "SAI1", "GPIOJ", "GPIOK", "DMA2D", "CRYP", "HASH", "FMC"];

/// The ports, in the order of [`Stm32f405::gpio`].
pub const PORTS: [&str; 9] =
    ["GPIOA", "GPIOB", "GPIOC", "GPIOD", "GPIOE", "GPIOF", "GPIOG", "GPIOH", "GPIOI"];
const SERIAL_INTERFACES: [&str; 3] = ["SPI1", "SPI2", "SPI3"];

/// Clock enable registers and their reset registers (RM0090, 7.3.5 to 7.3.14).
const ENABLES: [(&str, &str); 5] = [
    ("AHB1ENR", "AHB1RSTR"),
    ("AHB2ENR", "AHB2RSTR"),
    ("AHB3ENR", "AHB3RSTR"),
    ("APB1ENR", "APB1RSTR"),
    ("APB2ENR", "APB2RSTR"),
];

/// DMA update requests of the timers, first of DMA1, then of DMA2: instance, channel, streams (RM0090, tables 42 and 43).
const TIMER_UPDATES: [&[(&str, usize, &[usize])]; 2] = [
    &[("TIM2", 3, &[1, 7]), ("TIM3", 5, &[2]), ("TIM4", 2, &[6]), ("TIM5", 6, &[0, 6])],
    &[("TIM1", 6, &[5]), ("TIM8", 7, &[1])],
];

static DMA_WIRING: LazyLock<[Vec<Wire>; 2]> = LazyLock::new(|| {
    std::array::from_fn(|n| {
        let updates = TIMER_UPDATES[n].iter().map(|&(instance, channel, streams)| Wire {
            instance,
            request: UPDATE_REQUEST,
            channel,
            streams,
        });
        CONTROLLERS[n].wiring.iter().copied().chain(updates).collect()
    })
});

/// Clock after a reset, Hz: the internal oscillator.
const RESET_HZ: u64 = rcc::HSI_HZ;

/// The model of a slot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Field {
    None,
    Rcc,
    Pwr,
    Gpio(usize),
    Spi(usize),
    Usart(usize),
    I2c(usize),
    Flash,
    Adc(usize),
    AdcCommon,
    Tim(usize),
    Advanced(usize),
    Dma(usize),
    Rtc,
    Dbg,
    Iwdg,
    Dwt,
    Exti,
    Syscfg,
}

/// Returns the model of an instance.
fn field_of(instance: &str) -> Field {
    let nth = |list: &[&str]| list.iter().position(|&name| name == instance);
    let timer = |list: &[parts::Timer]| list.iter().position(|timer| timer.instance == instance);
    match instance {
        "RCC" => return Field::Rcc,
        "PWR" => return Field::Pwr,
        "FLASH" => return Field::Flash,
        "RTC" => return Field::Rtc,
        "DBG" => return Field::Dbg,
        "IWDG" => return Field::Iwdg,
        "EXTI" => return Field::Exti,
        "SYSCFG" => return Field::Syscfg,
        ADC_COMMON => return Field::AdcCommon,
        armv7m::DWT => return Field::Dwt,
        _ => {}
    }
    nth(&PORTS)
        .map(Field::Gpio)
        .or_else(|| nth(&SERIAL_INTERFACES).map(Field::Spi))
        .or_else(|| SERIAL_PORTS.iter().position(|port| port.instance == instance).map(Field::Usart))
        .or_else(|| nth(&I2C_INTERFACES).map(Field::I2c))
        .or_else(|| nth(&CONVERTERS).map(Field::Adc))
        .or_else(|| timer(&TIMERS).map(Field::Tim))
        .or_else(|| timer(&ADVANCED_TIMERS).map(Field::Advanced))
        .or_else(|| CONTROLLERS.iter().position(|dma| dma.instance == instance).map(Field::Dma))
        .unwrap_or(Field::None)
}

/// A timer, by its index among the timers of its family.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TimerIndex {
    /// TIM2 to TIM5.
    General(usize),
    /// TIM1 and TIM8.
    Advanced(usize),
}

impl TimerIndex {
    /// Returns the timer with this name in RM0090.
    pub fn of(name: &str) -> Option<Self> {
        let place = |list: &[parts::Timer]| list.iter().position(|timer| timer.instance == name);
        place(&TIMERS).map(Self::General).or_else(|| place(&ADVANCED_TIMERS).map(Self::Advanced))
    }
}

/// The microcontroller. A board attaches its chips to the fields.
#[derive(Debug)]
pub struct Stm32f405 {
    /// Clocks and resets.
    pub rcc: Rcc,
    /// Supply.
    pub pwr: Pwr,
    /// Ports A to I.
    pub gpio: [Gpio; PORTS.len()],
    /// SPI1 to SPI3.
    pub spi: [Spi; SERIAL_INTERFACES.len()],
    /// The serial ports, in the order of `SERIAL_PORTS`.
    pub usart: [Usart; SERIAL_PORTS.len()],
    /// I2C1 to I2C3.
    pub i2c: [I2c; I2C_INTERFACES.len()],
    /// Flash.
    pub flash: FlashArray,
    /// ADC1 to ADC3.
    pub adc: [Adc; CONVERTERS.len()],
    adc_common: AdcCommon,
    /// TIM2 to TIM5.
    pub tim: [Timer<General>; TIMERS.len()],
    /// TIM1 and TIM8.
    advanced: [Timer<Advanced>; ADVANCED_TIMERS.len()],
    dma: [Dma; CONTROLLERS.len()],
    rtc: Rtc,
    dbg: Dbg,
    /// The independent watchdog.
    pub iwdg: Iwdg,
    dwt: Dwt,
    /// External interrupts.
    pub exti: Exti,
    syscfg: Syscfg,
    bus: Bus,
    wiring: Box<[Field]>,
    slots: Slots,
}

/// Slots of the instances that are driven from outside, or that keep state through a reset.
#[derive(Clone, Copy, Debug)]
struct Slots {
    rcc: usize,
    pwr: usize,
    rtc: usize,
    dbg: usize,
    flash: usize,
    exti: usize,
    gpio: [usize; PORTS.len()],
    tim: [usize; TIMERS.len()],
    advanced: [usize; ADVANCED_TIMERS.len()],
    dma: [usize; CONTROLLERS.len()],
    usart: [usize; SERIAL_PORTS.len()],
    spi: [usize; SERIAL_INTERFACES.len()],
}

fn assemble() -> Result<Bus, Error> {
    let f427 = stm32f427::builder().build()?;
    let instances: Vec<Peripheral> = f427
        .peripherals()
        .filter(|instance| !ABSENT.contains(&instance.name))
        .map(|&instance| match instance.name {
            "EXTI" => Peripheral { interrupts: &exti::INTERRUPTS, ..instance },
            _ => instance,
        })
        .collect();
    let names: Vec<&'static str> = instances.iter().map(|instance| instance.name).collect();
    let mut builder = Bus::builder(CPU, &MEMORY, instances)
        // The F405's identity is 0x413 (RM0090, 38.6.1), and revision Z is 0x1001 (errata sheet ES0182).
        .reset("DBG", "DBGMCU_IDCODE", 0x1001_6413)
        .aborts_in("nothing", 0, 0xe000_0000);

    // These are corrections, because ST's machine-readable description differs from its manual.
    for &name in &names {
        let gate = |registers: fn((&'static str, &'static str)) -> &'static str, field: &str| {
            ENABLES.into_iter().map(registers).find_map(|register| {
                let found = find_field(&generated::rcc::REGISTERS, register, field)?;
                Some(Gate::by("RCC", register, found.name))
            })
        };
        let (enable, reset) = match name {
            ADC_COMMON => ("ADC1EN".into(), "ADCRST".into()),
            "ADC1" | "ADC2" | "ADC3" => (format!("{name}EN"), "ADCRST".into()),
            // The description has UART2RST and UART3RST.
            "USART2" | "USART3" => (format!("{name}EN"), format!("{}RST", &name[1..])),
            _ => (format!("{name}EN"), format!("{name}RST")),
        };
        if let Some(gate) = gate(|pair| pair.0, &enable) {
            builder = builder.gate(name, gate);
        }
        if let Some(gate) = gate(|pair| pair.1, &reset) {
            builder = builder.reset_by(name, gate);
        }
        if let Some(clock) = f427.clock_of(name) {
            builder = builder.clocked_by(name, clock);
        }
        match field_of(name) {
            // RM0090, 30.6.1: TXE and TC are set.
            Field::Usart(_) => builder = builder.reset(name, "SR", 0xc0),
            // RM0090, 28.5.9.
            Field::Spi(_) => builder = builder.reset(name, "I2SPR", 0x0002),
            // RM0090, 27.6.6: error flags are cleared by writing zero.
            Field::I2c(_) => builder = builder.write_modify(name, "SR1", WriteModify::ZeroToClear),
            // RM0090, 18.4.5: flags are cleared by writing zero. RM0090, 18.4.12: the period is all ones.
            Field::Tim(n) => {
                builder = builder.write_modify(name, "SR", WriteModify::ZeroToClear).reset(
                    name,
                    "ARR",
                    TIMERS[n].counter.mask(),
                );
            }
            Field::Advanced(_) => {
                builder =
                    builder.write_modify(name, "SR", WriteModify::ZeroToClear).reset(name, "ARR", 0xffff);
            }
            Field::Gpio(n) => {
                // RM0090, 8.4.1, 8.4.3 and 8.4.4: ports A and B start with the debug port's pins.
                let [mode, speed, pull] = match n {
                    0 => [0xa800_0000, 0x0c00_0000, 0x6400_0000],
                    1 => [0x0280, 0x00c0, 0x0100],
                    _ => [0; 3],
                };
                builder = builder
                    .reset(name, "MODER", mode)
                    .reset(name, "OSPEEDR", speed)
                    .reset(name, "PUPDR", pull);
            }
            // RM0090, 12.3.6: writing a one clears a bit.
            Field::Exti => builder = builder.write_modify(name, "PR", WriteModify::OneToClear),
            // RM0090, 3.9.5, 3.9.7 and 3.9.9. The model is that of the F427, with four bits of latency and RDERR.
            Field::Flash => {
                builder = builder
                    .field(name, "ACR", "LATENCY", flash::LATENCY)
                    .field(name, "CR", "LOCK", flash::LOCK)
                    .field(name, "CR", "STRT", flash::STRT)
                    .field(name, "OPTCR", "OPTLOCK", flash::OPTLOCK)
                    .field(name, "OPTCR", "OPTSTRT", flash::OPTSTRT)
                    .declare(name, "SR", &flash::RDERR)
                    .write_modify(name, "SR", WriteModify::OneToClear);
            }
            _ => {}
        }
    }
    // RM0090, 5.4.1: the backup domain is write-protected until DBP is set.
    builder = builder.gate_writes("RCC", &["BDCR"], Gate::by("PWR", "CR", "DBP"));
    builder = builder.gate_writes("RTC", &[], Gate::by("PWR", "CR", "DBP"));
    // These instances receive requests: see each model.
    let sinks = ["RTC", "RCC", ADC_COMMON, CONVERTERS[0], "EXTI"]
        .into_iter()
        .chain(SERIAL_INTERFACES)
        .chain(ADVANCED_TIMERS.iter().map(|timer| timer.instance))
        .chain(CONTROLLERS.iter().map(|dma| dma.instance));
    sinks.fold(builder, |builder, sink| builder.reads_requests(sink)).build()
}

impl Stm32f405 {
    /// Returns a part after a reset, with nothing connected to its pins.
    ///
    /// # Errors
    /// The description is inconsistent.
    pub fn new() -> Result<Self, Error> {
        let bus = assemble()?;
        let wiring = bus.slots().iter().map(|slot| field_of(slot.peripheral().name)).collect();
        let slot = |name| bus.slot(name);
        let mut slots = Slots {
            rcc: slot("RCC")?,
            pwr: slot("PWR")?,
            rtc: slot("RTC")?,
            dbg: slot("DBG")?,
            flash: slot("FLASH")?,
            exti: slot("EXTI")?,
            gpio: [0; _],
            tim: [0; _],
            advanced: [0; _],
            dma: [0; _],
            usart: [0; _],
            spi: [0; _],
        };
        for (n, interface) in SERIAL_INTERFACES.into_iter().enumerate() {
            slots.spi[n] = slot(interface)?;
        }
        for (n, port) in SERIAL_PORTS.iter().enumerate() {
            // The F405 has neither UART7 nor UART8, so they have no slot.
            slots.usart[n] = bus.slot_of(port.instance).unwrap_or(usize::MAX);
        }
        for (n, port) in PORTS.into_iter().enumerate() {
            slots.gpio[n] = slot(port)?;
        }
        for (n, timer) in TIMERS.iter().enumerate() {
            slots.tim[n] = slot(timer.instance)?;
        }
        for (n, timer) in ADVANCED_TIMERS.iter().enumerate() {
            slots.advanced[n] = slot(timer.instance)?;
        }
        for (n, controller) in CONTROLLERS.iter().enumerate() {
            slots.dma[n] = slot(controller.instance)?;
        }
        let adc_common = AdcCommon::with_clock(RESET_HZ);
        let mut part = Self {
            rcc: Rcc::new(),
            pwr: Pwr::new(),
            gpio: std::array::from_fn(|_| Gpio::default()),
            spi: std::array::from_fn(|_| Spi::with_clock(RESET_HZ)),
            usart: std::array::from_fn(|n| Usart::with_clock(SERIAL_PORTS[n].kind, RESET_HZ)),
            i2c: std::array::from_fn(|_| I2c {
                interface: I2cInterface::with_clock(RESET_HZ),
                held_low: false,
            }),
            flash: FlashArray::new(Flash::with_clock(RESET_HZ)),
            adc: std::array::from_fn(|_| Adc::with_clock(RESET_HZ / 2)),
            adc_common,
            tim: std::array::from_fn(|n| Timer::new(Tim::with_clock(RESET_HZ, TIMERS[n].counter), RESET_HZ)),
            advanced: std::array::from_fn(|n| {
                let timer = Tim::with_clock(RESET_HZ, ADVANCED_TIMERS[n].counter);
                Timer::new(timer.breaks_on("RCC", rcc::CLOCK_FAILURE), RESET_HZ)
            }),
            dma: [
                Dma::new(&DMA_WIRING[0], &[], false),
                Dma::new(&DMA_WIRING[1], CONTROLLERS[1].last_data, true),
            ],
            rtc: Rtc,
            dbg: Dbg,
            iwdg: Iwdg::new(),
            dwt: Dwt::with_clock(RESET_HZ),
            exti: Exti::default(),
            syscfg: Syscfg,
            bus,
            wiring,
            slots,
        };
        part.check()?;
        Ok(part)
    }

    /// Sets the supply of the part, mV.
    pub fn set_supply(&mut self, millivolts: u32) {
        let registers = self.bus.slot_mut(self.slots.pwr).registers_mut();
        self.pwr.set_supply(millivolts, registers);
        if let Some(millivolts) = NonZeroU32::new(millivolts) {
            self.flash.interface.set_supply(millivolts);
        }
    }

    /// Returns whether the voltage detector reports a low supply.
    pub fn supply_is_low(&self) -> bool {
        let csr = self.bus.slots()[self.slots.pwr].registers().get(pwr::Register::Csr);
        pwr::csr::PVDO.is_set(csr)
    }

    /// Drives an input of port `n`.
    pub fn drive_port<T>(
        &mut self,
        at: VirtualNanos,
        n: usize,
        input: impl FnOnce(&mut Gpio, &mut RegisterFile, &mut DeviceContext<'_>) -> T,
    ) -> T {
        let (registers, mut context) = self.bus.drive(at, self.slots.gpio[n]);
        input(&mut self.gpio[n], registers, &mut context)
    }

    /// Drives a line of the external interrupts that is not a pin.
    pub fn drive_exti(&mut self, at: VirtualNanos, line: usize, high: bool) {
        let (registers, mut context) = self.bus.drive(at, self.slots.exti);
        self.exti.drive_internal(line, high, registers, &mut context);
    }

    /// Switches the part's supply on or off.
    pub fn power(&mut self, at: VirtualNanos, on: bool) {
        let (_, mut context) = self.bus.drive(at, self.slots.pwr);
        context.request_power(on);
    }

    /// Stops the crystal.
    pub fn fail_crystal(&mut self, at: VirtualNanos) {
        let (registers, mut context) = self.bus.drive(at, self.slots.rcc);
        self.rcc.fail_hse(registers, &mut context);
    }

    /// Returns port `n` and its registers.
    pub fn port(&self, n: usize) -> (&Gpio, &RegisterFile) {
        (&self.gpio[n], self.bus.slots()[self.slots.gpio[n]].registers())
    }

    /// Notifies the chips at the SPI interfaces of a reset of the part, which cancelled their scheduled events.
    pub fn notify_chips_of_reset(&mut self, at: VirtualNanos) {
        for (n, spi) in self.spi.iter_mut().enumerate() {
            let (_, mut context) = self.bus.drive(at, self.slots.spi[n]);
            for chip in 0.. {
                let Some(peer) = spi.peer_mut(chip) else { break };
                peer.restarted(&mut Timeline::new(&mut context));
            }
        }
    }

    /// Returns the addresses of an instance's registers; the range is empty if the instance does not exist.
    pub fn addresses(&self, instance: &str) -> Range<u64> {
        let slot = self.bus.slot_of(instance).map(|slot| self.bus.slots()[slot].peripheral());
        slot.map_or(0..0, |peripheral| peripheral.base..peripheral.base + peripheral.size)
    }

    /// Returns the bus slot of port `n`.
    pub fn port_slot(&self, n: usize) -> usize {
        self.slots.gpio[n]
    }

    /// Returns the level that a timer drives on a pin of its channel (1 to 4), if it drives it.
    pub fn timer_output(&self, timer: TimerIndex, channel: u8, complementary: bool) -> Option<Level> {
        match timer {
            TimerIndex::General(n) => {
                let registers = self.bus.slots()[self.slots.tim[n]].registers();
                self.tim[n].output(channel, complementary, registers)
            }
            TimerIndex::Advanced(n) => {
                let registers = self.bus.slots()[self.slots.advanced[n]].registers();
                self.advanced[n].output(channel, complementary, registers)
            }
        }
    }

    /// Returns whether a timer's outputs can have changed since the last call.
    pub fn take_touched(&mut self, timer: TimerIndex) -> bool {
        match timer {
            TimerIndex::General(n) => self.tim[n].take_touched(),
            TimerIndex::Advanced(n) => self.advanced[n].take_touched(),
        }
    }

    /// Makes the memory address of a stream of DMA2 an unmapped one, or restores it.
    pub fn set_stream_address_unmapped(&mut self, stream: usize, unmapped: bool) {
        use generated::dma2::Register;
        const UNMAPPED: u64 = 0x4000_0000;
        let register = match stream {
            0 => Register::S0m0ar,
            3 => Register::S3m0ar,
            _ => panic!("stream {stream} moves nothing of the IMU"),
        };
        let registers = self.bus.slot_mut(self.slots.dma[1]).registers_mut();
        let address = registers.get(register);
        registers.set(register, if unmapped { address | UNMAPPED } else { address & !UNMAPPED });
    }

    /// Returns the enabled streams whose memory address is in the CCM, which DMA can't reach: controller (1 or 2) and stream.
    pub fn unreachable_by_dma(&self) -> Vec<(usize, usize)> {
        use generated::dma2::{Register, s0cr};
        type Stream = (Register, Register);
        const STREAMS: [Stream; 8] = [
            (Register::S0cr, Register::S0m0ar),
            (Register::S1cr, Register::S1m0ar),
            (Register::S2cr, Register::S2m0ar),
            (Register::S3cr, Register::S3m0ar),
            (Register::S4cr, Register::S4m0ar),
            (Register::S5cr, Register::S5m0ar),
            (Register::S6cr, Register::S6m0ar),
            (Register::S7cr, Register::S7m0ar),
        ];
        let mut found = Vec::new();
        for (controller, &slot) in self.slots.dma.iter().enumerate() {
            let registers = self.bus.slots()[slot].registers();
            for (stream, (control, memory)) in STREAMS.into_iter().enumerate() {
                let address = registers.get(memory);
                let in_ccm = (CCM.0..CCM.0 + CCM.1).contains(&address);
                if in_ccm && s0cr::EN.is_set(registers.get(control)) {
                    found.push((controller + 1, stream));
                }
            }
        }
        found
    }
}

/// The emulator uses no snapshots, so storing and loading always fail.
impl Store for Stm32f405 {
    fn store(&self, _: &mut snapshot::Writer) -> Result<(), snapshot::Error> {
        Err(snapshot::Error::Failed)
    }

    fn load(&mut self, _: &mut snapshot::Reader) -> Result<(), snapshot::Error> {
        Err(snapshot::Error::Failed)
    }
}

impl Mcu for Stm32f405 {
    fn bus(&self) -> &Bus {
        &self.bus
    }

    fn bus_mut(&mut self) -> &mut Bus {
        &mut self.bus
    }

    /// A system reset (RM0090, 6.1.1) keeps the backup domain, the debug settings, the option bytes and the reset flags. A
    /// power-on reset keeps the backup domain (a backup battery supplies it) and the option bytes.
    fn reset(&mut self, _: VirtualNanos, cause: ResetCause) {
        let get = |slot: usize| self.bus.slots()[slot].registers();
        let flags = get(self.slots.rcc).get(rcc_registers::Register::Csr);
        let backup_clock = get(self.slots.rcc).get(rcc_registers::Register::Bdcr);
        let regulator = get(self.slots.pwr).get(pwr::Register::Csr);
        let calendar =
            rtc_registers::Register::ALL.map(|register| (register, get(self.slots.rtc).get(register)));
        let debug = [dbg::Register::DbgmcuCr, dbg::Register::DbgmcuApb1Fz, dbg::Register::DbgmcuApb2Fz]
            .map(|register| (register, get(self.slots.dbg).get(register)));
        let options = self.flash.interface.committed_options();
        let (supply, crystals, lsi_hz) = (self.pwr.supply(), self.rcc.crystals(), self.rcc.lsi_hz());

        self.reset_every_model();

        // A new model does not have the board's settings: set them again.
        self.rcc = Rcc::new();
        self.rcc.attach_crystals(crystals.0, crystals.1);
        self.rcc.calibrate_lsi(lsi_hz);
        self.flash = FlashArray::new(Flash::with_clock(RESET_HZ));
        self.set_supply(supply);
        let registers = self.bus.slot_mut(self.slots.rcc).registers_mut();
        registers.set(rcc_registers::Register::Bdcr, backup_clock);
        if cause == ResetCause::PowerOn {
            // RM0090, 7.3.21: the flags of power-on, brown-out and pin reset are set.
            registers.set(rcc_registers::Register::Csr, 0x0e00_0000);
        } else {
            self.rcc.restarted(cause, flags, registers);
            let registers = self.bus.slot_mut(self.slots.dbg).registers_mut();
            debug.into_iter().for_each(|(register, value)| registers.set(register, value));
        }
        let registers = self.bus.slot_mut(self.slots.pwr).registers_mut();
        self.pwr.keep_backup_regulator(regulator, registers);
        let registers = self.bus.slot_mut(self.slots.rtc).registers_mut();
        calendar.into_iter().for_each(|(register, value)| registers.set(register, value));
        let registers = self.bus.slot_mut(self.slots.flash).registers_mut();
        self.flash.interface.keep_options(options.0, options.1, registers);
    }

    /// Polls only the serial ports: no other peripheral has an external source of data.
    fn poll(&mut self, now: VirtualNanos) {
        for n in 0..self.usart.len() {
            if self.usart[n].attached() {
                let (registers, mut context) = self.bus.drive(now, self.slots.usart[n]);
                rigless::device::Device::poll(&mut self.usart[n], registers, &mut context);
            }
        }
    }

    fn split(&mut self, slot: usize) -> (&mut Bus, Option<&mut dyn ErasedDevice>) {
        let field = self.wiring.get(slot).copied().unwrap_or(Field::None);
        let model: Option<&mut dyn ErasedDevice> = match field {
            Field::None => None,
            Field::Rcc => Some(&mut self.rcc),
            Field::Pwr => Some(&mut self.pwr),
            Field::Gpio(n) => Some(&mut self.gpio[n]),
            Field::Spi(n) => Some(&mut self.spi[n]),
            Field::Usart(n) => Some(&mut self.usart[n]),
            Field::I2c(n) => Some(&mut self.i2c[n]),
            Field::Flash => Some(&mut self.flash),
            Field::Adc(n) => Some(&mut self.adc[n]),
            Field::AdcCommon => Some(&mut self.adc_common),
            Field::Tim(n) => Some(&mut self.tim[n]),
            Field::Advanced(n) => Some(&mut self.advanced[n]),
            Field::Dma(n) => Some(&mut self.dma[n]),
            Field::Rtc => Some(&mut self.rtc),
            Field::Dbg => Some(&mut self.dbg),
            Field::Iwdg => Some(&mut self.iwdg),
            Field::Dwt => Some(&mut self.dwt),
            Field::Exti => Some(&mut self.exti),
            Field::Syscfg => Some(&mut self.syscfg),
        };
        (&mut self.bus, model)
    }
}
