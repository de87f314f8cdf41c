//! What an STM32F405RG connects to which pin, and which DMA stream serves whom.
//!
//! Pins: data sheet DS8626, table 9. DMA: reference manual RM0090, tables 42 and 43. The firmware's build holds both to the
//! tables of `stm32f4xx-hal`: a pin or a stream that is not in them does not compile.

use crate::Pin;

/// A signal of a peripheral, and how a pin gets it.
struct Signal {
    /// Peripheral and signal: `SPI1.SCK`.
    name: (&'static str, &'static str),
    /// Number of the alternate function.
    function: u8,
    /// The pins that can carry it.
    pins: &'static [&'static str],
}

const fn signal(
    peripheral: &'static str,
    signal: &'static str,
    function: u8,
    pins: &'static [&'static str],
) -> Signal {
    Signal { name: (peripheral, signal), function, pins }
}

/// Of the package with 64 pins: ports A to C, and PD2.
const SIGNALS: &[Signal] = &[
    signal("TIM1", "CH1", 1, &["PA8"]),
    signal("TIM1", "CH1N", 1, &["PA7", "PB13"]),
    signal("TIM1", "CH2", 1, &["PA9"]),
    signal("TIM1", "CH2N", 1, &["PB0", "PB14"]),
    signal("TIM1", "CH3", 1, &["PA10"]),
    signal("TIM1", "CH3N", 1, &["PB1", "PB15"]),
    signal("TIM1", "CH4", 1, &["PA11"]),
    signal("TIM2", "CH1", 1, &["PA0", "PA5", "PA15"]),
    signal("TIM2", "CH2", 1, &["PA1", "PB3"]),
    signal("TIM2", "CH3", 1, &["PA2", "PB10"]),
    signal("TIM2", "CH4", 1, &["PA3", "PB11"]),
    signal("TIM3", "CH1", 2, &["PA6", "PB4", "PC6"]),
    signal("TIM3", "CH2", 2, &["PA7", "PB5", "PC7"]),
    signal("TIM3", "CH3", 2, &["PB0", "PC8"]),
    signal("TIM3", "CH4", 2, &["PB1", "PC9"]),
    signal("TIM4", "CH1", 2, &["PB6"]),
    signal("TIM4", "CH2", 2, &["PB7"]),
    signal("TIM4", "CH3", 2, &["PB8"]),
    signal("TIM4", "CH4", 2, &["PB9"]),
    signal("TIM8", "CH1", 3, &["PC6"]),
    signal("TIM8", "CH1N", 3, &["PA5", "PA7"]),
    signal("TIM8", "CH2", 3, &["PC7"]),
    signal("TIM8", "CH2N", 3, &["PB0", "PB14"]),
    signal("TIM8", "CH3", 3, &["PC8"]),
    signal("TIM8", "CH3N", 3, &["PB1", "PB15"]),
    signal("TIM8", "CH4", 3, &["PC9"]),
    signal("SPI1", "SCK", 5, &["PA5", "PB3"]),
    signal("SPI1", "MISO", 5, &["PA6", "PB4"]),
    signal("SPI1", "MOSI", 5, &["PA7", "PB5"]),
    signal("I2C1", "SCL", 4, &["PB6", "PB8"]),
    signal("I2C1", "SDA", 4, &["PB7", "PB9"]),
    signal("I2C2", "SCL", 4, &["PB10"]),
    signal("I2C2", "SDA", 4, &["PB11"]),
    signal("I2C3", "SCL", 4, &["PA8"]),
    signal("I2C3", "SDA", 4, &["PC9"]),
    signal("USART1", "RX", 7, &["PA10", "PB7"]),
    signal("USART2", "RX", 7, &["PA3"]),
    signal("USART3", "RX", 7, &["PB11", "PC11"]),
    signal("UART4", "RX", 8, &["PA1", "PC11"]),
    signal("UART5", "RX", 8, &["PD2"]),
    signal("USART6", "RX", 8, &["PC7"]),
];

/// The pins that ADC1 measures, by their channel.
const ANALOG: [&str; 16] = [
    "PA0", "PA1", "PA2", "PA3", "PA4", "PA5", "PA6", "PA7", "PB0", "PB1", "PC0", "PC1", "PC2", "PC3", "PC4",
    "PC5",
];

/// The debug probe's pins: without them nothing can be flashed any more but through the boot loader.
pub const DEBUG: [&str; 2] = ["PA13", "PA14"];

/// Timers whose update DMA serves, each with stream and channel. TIM5, which has one too, counts the firmware's time.
const UPDATES: &[(&str, Stream)] = &[
    ("TIM1", Stream { controller: 2, number: 5, channel: 6 }),
    ("TIM2", Stream { controller: 1, number: 1, channel: 3 }),
    ("TIM2", Stream { controller: 1, number: 7, channel: 3 }),
    ("TIM3", Stream { controller: 1, number: 2, channel: 5 }),
    ("TIM4", Stream { controller: 1, number: 6, channel: 2 }),
    ("TIM8", Stream { controller: 2, number: 1, channel: 7 }),
];

/// Reception comes first: its end is the vector to which the firmware's control loop is bound.
const SPI1: [&[Stream]; 2] = [
    &[Stream { controller: 2, number: 0, channel: 3 }],
    &[Stream { controller: 2, number: 3, channel: 3 }, Stream { controller: 2, number: 5, channel: 3 }],
];

/// A stream of a DMA controller, on the channel by which a peripheral asks for it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stream {
    /// 1 or 2.
    pub controller: u8,
    /// 0 to 7.
    pub number: u8,
    /// 0 to 7.
    pub channel: u8,
}

/// A need for a stream, and the streams that can serve it, the preferred one first.
#[derive(Clone, Debug)]
pub struct Need {
    /// For people: `TIM1 update`.
    pub who: String,
    /// The choice.
    pub choice: Vec<Stream>,
}

/// What a motor timer needs.
pub fn update_of(timer: &str) -> Need {
    let choice = UPDATES.iter().filter(|(name, _)| *name == timer).map(|(_, stream)| *stream).collect();
    Need { who: format!("{timer} update"), choice }
}

/// What SPI1 needs, to receive and to send.
pub fn spi1() -> [Need; 2] {
    let [receive, send] = SPI1;
    [
        Need { who: "SPI1 receive".into(), choice: receive.into() },
        Need { who: "SPI1 send".into(), choice: send.into() },
    ]
}

/// Gives each need a stream of its own, the needs in their order as far as that is possible.
///
/// # Errors
/// It is not: the two that want the same, and the stream.
pub fn assign(needs: &[Need]) -> Result<Vec<Stream>, String> {
    /// The streams of `needs`, if none is taken twice.
    fn rest(needs: &[Need], taken: &mut Vec<Stream>) -> bool {
        let [need, others @ ..] = needs else { return true };
        need.choice.iter().any(|stream| {
            let free = !taken.iter().any(|other| same(other, stream));
            taken.push(*stream);
            let fits = free && rest(others, taken);
            if !fits {
                taken.pop();
            }
            fits
        })
    }
    let mut taken = Vec::new();
    if rest(needs, &mut taken) {
        return Ok(taken);
    }
    // For people: the first one for which nothing is left.
    let mut owners: Vec<(&str, Stream)> = Vec::new();
    for need in needs {
        let wanted = |stream: &Stream| owners.iter().find(|(_, other)| same(other, stream));
        match need.choice.iter().find(|stream| wanted(stream).is_none()) {
            Some(stream) => owners.push((&need.who, *stream)),
            None => {
                let clash = need.choice.iter().find_map(|stream| Some((stream, wanted(stream)?.0)));
                let Some((stream, other)) = clash else { break };
                return Err(format!(
                    "DMA{} stream {} is needed by {other} and by {}",
                    stream.controller, stream.number, need.who
                ));
            }
        }
    }
    Err("has more needs for DMA than there are streams".into())
}

fn same(one: &Stream, other: &Stream) -> bool {
    (one.controller, one.number) == (other.controller, other.number)
}

/// Number of the alternate function by which `pin` carries `peripheral`'s `signal`; or the pins that do.
pub fn function(pin: Pin, peripheral: &str, signal: &str) -> Result<u8, Vec<&'static str>> {
    let name = pin.to_string();
    let found: Vec<&Signal> =
        SIGNALS.iter().filter(|candidate| candidate.name == (peripheral, signal)).collect();
    match found.iter().find(|candidate| candidate.pins.contains(&name.as_str())) {
        Some(found) => Ok(found.function),
        None => Err(found.iter().flat_map(|candidate| candidate.pins).copied().collect()),
    }
}

/// The channel of `timer` at `pin`: 1 to 4, and whether it is the complementary output; with the alternate function.
pub fn timer_channel(pin: Pin, timer: &str) -> Option<(u8, bool, u8)> {
    let name = pin.to_string();
    SIGNALS.iter().find(|signal| signal.name.0 == timer && signal.pins.contains(&name.as_str())).map(
        |signal| {
            let text = signal.name.1;
            (text.as_bytes()[2] - b'0', text.ends_with('N'), signal.function)
        },
    )
}

/// The motor timers with a channel at `pin`.
pub fn timers_at(pin: Pin) -> Vec<&'static str> {
    let name = pin.to_string();
    let timers = SIGNALS.iter().filter(|signal| signal.name.0.starts_with("TIM"));
    timers.filter(|signal| signal.pins.contains(&name.as_str())).map(|signal| signal.name.0).collect()
}

/// All motor timers.
pub fn timers() -> Vec<&'static str> {
    let mut names: Vec<&str> = UPDATES.iter().map(|(name, _)| *name).collect();
    names.dedup();
    names
}

/// Peripherals with `signal`, whose name begins with one of `kinds`.
pub fn peripherals(kinds: &[&str], signal: &str) -> Vec<&'static str> {
    let found = SIGNALS
        .iter()
        .map(|candidate| candidate.name)
        .filter(|(name, of)| *of == signal && kinds.iter().any(|kind| name.starts_with(kind)));
    found.map(|(name, _)| name).collect()
}

/// Channel of ADC1 at `pin`.
pub fn analog_channel(pin: Pin) -> Option<u8> {
    let name = pin.to_string();
    ANALOG.iter().position(|candidate| *candidate == name).map(|channel| channel as u8)
}

/// The vector of an external interrupt line (RM0090, table 61).
pub fn line_vector(line: u8) -> &'static str {
    match line {
        0 => "EXTI0",
        1 => "EXTI1",
        2 => "EXTI2",
        3 => "EXTI3",
        4 => "EXTI4",
        5..=9 => "EXTI9_5",
        _ => "EXTI15_10",
    }
}
