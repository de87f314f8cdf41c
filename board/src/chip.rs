//! The STM32F405RG's connections of signals to pins, and of DMA streams to peripherals.
//!
//! The pins are from the data sheet DS8626, table 9, and the DMA streams from the reference manual RM0090, tables 42
//! and
//! 43. The firmware's build compares the used entries with the tables of `stm32f4xx-hal`, so a pin or a stream that
//!     these do not have does not compile.

use crate::Pin;

/// A signal of a peripheral, with the pins that can carry it.
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

/// The signals in the package with 64 pins: ports A to C, and PD2.
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

/// The pins with a channel of ADC1, by channel number.
const ANALOG: [&str; 16] = [
    "PA0", "PA1", "PA2", "PA3", "PA4", "PA5", "PA6", "PA7", "PB0", "PB1", "PC0", "PC1", "PC2", "PC3", "PC4",
    "PC5",
];

/// The debug probe's pins. Without them, the chip can only be flashed through the boot loader.
pub const DEBUG: [&str; 2] = ["PA13", "PA14"];

/// Motor timers with the DMA streams and channels of their update event. TIM5 also has one, but counts the firmware's
/// time.
const UPDATES: &[(&str, Stream)] = &[
    ("TIM1", Stream { controller: 2, number: 5, channel: 6 }),
    ("TIM2", Stream { controller: 1, number: 1, channel: 3 }),
    ("TIM2", Stream { controller: 1, number: 7, channel: 3 }),
    ("TIM3", Stream { controller: 1, number: 2, channel: 5 }),
    ("TIM4", Stream { controller: 1, number: 6, channel: 2 }),
    ("TIM8", Stream { controller: 2, number: 1, channel: 7 }),
];

/// DMA streams of SPI1: first for reception, then for transmission. The firmware's control loop is bound to the vector
/// of the reception.
const SPI1: [&[Stream]; 2] = [
    &[Stream { controller: 2, number: 0, channel: 3 }],
    &[Stream { controller: 2, number: 3, channel: 3 }, Stream { controller: 2, number: 5, channel: 3 }],
];

/// A stream of a DMA controller, with the request channel of its peripheral.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stream {
    /// Number of the controller, 1 or 2.
    pub controller: u8,
    /// Number of the stream, 0 to 7.
    pub number: u8,
    /// Request channel, 0 to 7.
    pub channel: u8,
}

/// A request for a stream, with the streams that can serve it.
#[derive(Clone, Debug)]
pub struct StreamRequest {
    /// Name for error messages, such as `TIM1 update`.
    pub name: String,
    /// The streams that can serve it, the preferred one first.
    pub options: Vec<Stream>,
}

/// Returns the request of a motor timer.
pub fn timer_request(timer: &str) -> StreamRequest {
    let options = UPDATES.iter().filter(|(name, _)| *name == timer).map(|(_, stream)| *stream).collect();
    StreamRequest { name: format!("{timer} update"), options }
}

/// Returns the requests of SPI1, for reception and transmission.
pub fn spi1_requests() -> [StreamRequest; 2] {
    let [receive, send] = SPI1;
    [
        StreamRequest { name: "SPI1 receive".into(), options: receive.into() },
        StreamRequest { name: "SPI1 send".into(), options: send.into() },
    ]
}

/// Assigns a different stream to each request; earlier requests get their preferred stream if possible.
///
/// # Errors
/// No assignment exists: the error names two conflicting requests and their stream.
pub fn assign(requests: &[StreamRequest]) -> Result<Vec<Stream>, String> {
    /// Assigns streams to `requests` that are not in `taken`, and returns whether that is possible.
    fn assign_rest(requests: &[StreamRequest], taken: &mut Vec<Stream>) -> bool {
        let [request, others @ ..] = requests else { return true };
        request.options.iter().any(|stream| {
            let free = !taken.iter().any(|other| same_stream(other, stream));
            taken.push(*stream);
            let fits = free && assign_rest(others, taken);
            if !fits {
                taken.pop();
            }
            fits
        })
    }
    let mut taken = Vec::new();
    if assign_rest(requests, &mut taken) {
        return Ok(taken);
    }
    // For the error: find the first request whose streams are all taken.
    let mut owners: Vec<(&str, Stream)> = Vec::new();
    for request in requests {
        let owner = |stream: &Stream| owners.iter().find(|(_, other)| same_stream(other, stream));
        match request.options.iter().find(|stream| owner(stream).is_none()) {
            Some(stream) => owners.push((&request.name, *stream)),
            None => {
                let clash = request.options.iter().find_map(|stream| Some((stream, owner(stream)?.0)));
                let Some((stream, other)) = clash else { break };
                return Err(format!(
                    "{other} and {} need the same DMA{} stream {}",
                    request.name, stream.controller, stream.number
                ));
            }
        }
    }
    Err("needs more DMA streams than the chip has".into())
}

fn same_stream(one: &Stream, other: &Stream) -> bool {
    (one.controller, one.number) == (other.controller, other.number)
}

/// Returns the number of the alternate function with which `pin` carries `peripheral`'s `signal`; otherwise the pins
/// that can.
pub fn function(pin: Pin, peripheral: &str, signal: &str) -> Result<u8, Vec<&'static str>> {
    let name = pin.to_string();
    let found: Vec<&Signal> =
        SIGNALS.iter().filter(|candidate| candidate.name == (peripheral, signal)).collect();
    match found.iter().find(|candidate| candidate.pins.contains(&name.as_str())) {
        Some(found) => Ok(found.function),
        None => Err(found.iter().flat_map(|candidate| candidate.pins).copied().collect()),
    }
}

/// Returns the channel of `timer` at `pin`, 1 to 4; whether it is the complementary output; and the alternate function.
pub fn timer_channel(pin: Pin, timer: &str) -> Option<(u8, bool, u8)> {
    let name = pin.to_string();
    SIGNALS.iter().find(|signal| signal.name.0 == timer && signal.pins.contains(&name.as_str())).map(
        |signal| {
            let text = signal.name.1;
            (text.as_bytes()[2] - b'0', text.ends_with('N'), signal.function)
        },
    )
}

/// Returns the motor timers with a channel at `pin`.
pub fn timers_at(pin: Pin) -> Vec<&'static str> {
    let name = pin.to_string();
    let timers = SIGNALS.iter().filter(|signal| signal.name.0.starts_with("TIM"));
    timers.filter(|signal| signal.pins.contains(&name.as_str())).map(|signal| signal.name.0).collect()
}

/// Returns all motor timers.
pub fn timers() -> Vec<&'static str> {
    let mut names: Vec<&str> = UPDATES.iter().map(|(name, _)| *name).collect();
    names.dedup();
    names
}

/// Returns the peripherals that have `signal`, and whose names begin with one of `kinds`.
pub fn peripherals(kinds: &[&str], signal: &str) -> Vec<&'static str> {
    let found = SIGNALS
        .iter()
        .map(|candidate| candidate.name)
        .filter(|(name, of)| *of == signal && kinds.iter().any(|kind| name.starts_with(kind)));
    found.map(|(name, _)| name).collect()
}

/// Returns the channel of ADC1 at `pin`.
pub fn analog_channel(pin: Pin) -> Option<u8> {
    let name = pin.to_string();
    ANALOG.iter().position(|candidate| *candidate == name).map(|channel| channel as u8)
}

/// Returns the vector of an external interrupt line (RM0090, table 61).
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
