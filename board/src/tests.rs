use super::*;

fn text(name: &str) -> &'static str {
    BUILT_IN.iter().find(|board| board.0 == name).unwrap().1
}

fn parsed(text: &str) -> Result<Board, String> {
    Board::parse("x", "x.toml", text).map_err(|error| error.to_string())
}

/// Returns the error of a built-in board's file after a replacement.
#[track_caller]
fn refused(of: &str, old: &str, new: &str) -> String {
    let text = text(of);
    assert!(text.contains(old), "{old}");
    parsed(&text.replace(old, new)).unwrap_err()
}

/// Calls `check` with every built-in board and what is expected of it. Fails if a board has no expectation.
fn for_every_board<T>(expected: &[(&str, T)], check: impl Fn(&Board, &T)) {
    for (name, _) in BUILT_IN {
        let found = expected.iter().find(|(board, _)| board == name);
        let (_, expected) = found.unwrap_or_else(|| panic!("nothing is expected of {name}"));
        check(&Board::load(name).unwrap(), expected);
    }
    assert_eq!(expected.len(), BUILT_IN.len(), "an expectation of a board that is not built in");
}

/// Compares the motor pads with ArduPilot's `hwdef.dat`. It is a second source, because the board files were not
/// written from it.
#[test]
fn motor_pads_match_ardupilot() {
    let expected = [
        (
            "speedybee-f405-v4",
            "PB6 TIM4_CH1 TIM4 PWM(1)\nPB7 TIM4_CH2 TIM4 PWM(2)\nPB0 TIM3_CH3 TIM3 PWM(3)\nPB1 TIM3_CH4 TIM3 PWM(4)",
        ),
        (
            "speedybee-f405-mini",
            "PB6 TIM4_CH1 TIM4 PWM(1)\nPB7 TIM4_CH2 TIM4 PWM(2)\nPB1 TIM3_CH4 TIM3 PWM(3)\nPB0 TIM3_CH3 TIM3 PWM(4)",
        ),
        (
            "matek-f405-te",
            "PC9 TIM8_CH4 TIM8 PWM(1)\nPC8 TIM8_CH3 TIM8 PWM(2)\nPB15 TIM1_CH3N TIM1 PWM(3)\nPA8 TIM1_CH1 TIM1 PWM(4)",
        ),
    ];
    for_every_board(&expected, |board, lines| {
        let ours = board.motors.iter().enumerate().map(|(n, motor)| {
            let connection = &motor.connection;
            let (pin, timer) = (connection.pin, &connection.peripheral);
            let not = if motor.complementary { "N" } else { "" };
            format!("{pin} {timer}_CH{}{not} {timer} PWM({})", motor.channel, n + 1)
        });
        assert_eq!(ours.collect::<Vec<_>>().join("\n"), *lines);
    });
}

/// Compares the pins of the sensors, the receiver, the battery and the LED, and the battery's ratio, with the same
/// files.
#[test]
fn sensor_pins_match_ardupilot() {
    let expected = [
        ("speedybee-f405-v4", ("PA5 PA6 PA7 PA4 PB8 PB9 PA3 PC0 PC13", 11.0)),
        ("speedybee-f405-mini", ("PA5 PA6 PA7 PA4 PB8 PB9 PA3 PC0 PC13", 11.0)),
        ("matek-f405-te", ("PA5 PB4 PA7 PC14 PB8 PB7 PA3 PC4 PB12", 21.0)),
    ];
    for_every_board(&expected, |board, (pins, ratio)| {
        let bus = board.imu.bus.iter().map(|connection| connection.pin);
        let rest = [
            board.imu.select,
            board.magnetometer.scl.pin,
            board.magnetometer.sda.pin,
            board.receiver.pin,
            board.battery.pin,
        ];
        let all =
            bus.chain(rest).chain(board.led.map(|led| led.pin)).chain(board.imu.deselect.iter().copied());
        let all: Vec<String> = all.map(|pin| pin.to_string()).collect();
        assert_eq!(all.join(" "), *pins);
        assert_eq!(board.battery.ratio, *ratio);
    });
}

/// Compares the IMU's axes with ArduPilot's rotations of the same chip, about the axes forward, right, down.
#[test]
fn imu_axes_match_ardupilot_rotations() {
    // ROTATION_PITCH_180_YAW_270, ROTATION_PITCH_180_YAW_90, ROTATION_YAW_90.
    let pitched = |[x, y, z]: [i32; 3]| [-x, y, -z];
    let yawed_90 = |[x, y, z]: [i32; 3]| [-y, x, z];
    let yawed_270 = |[x, y, z]: [i32; 3]| [y, -x, z];
    let chip = [1, 2, 3];
    let expected = [
        ("speedybee-f405-v4", yawed_270(pitched(chip))),
        ("speedybee-f405-mini", yawed_90(pitched(chip))),
        ("matek-f405-te", yawed_90(chip)),
    ];
    for_every_board(&expected, |board, expected| {
        assert_eq!(board.imu.axes.body_from_chip(chip), *expected, "{}", board.name);
    });
}

#[test]
fn timers_determine_dma_streams() {
    let board = Board::load("matek-f405-te").unwrap();
    let of = |stream: Stream| (stream.controller, stream.number, stream.channel);
    assert_eq!(board.imu.streams.map(of), [(2, 0, 3), (2, 3, 3)]);
    let timers: Vec<_> = board.timers.iter().map(|timer| (timer.name.as_str(), of(timer.stream))).collect();
    assert_eq!(timers, [("TIM8", (2, 1, 7)), ("TIM1", (2, 5, 6))]);
    for (name, _) in BUILT_IN {
        let board = Board::load(name).unwrap();
        let streams = board.imu.streams.into_iter().chain(board.timers.iter().map(|timer| timer.stream));
        let streams: Vec<_> = streams.map(|stream| (stream.controller, stream.number)).collect();
        let distinct: std::collections::BTreeSet<_> = streams.iter().collect();
        assert_eq!(distinct.len(), streams.len(), "{name}: {streams:?}");
    }
}

#[test]
fn wrong_board_files_are_refused_with_reason() {
    let v4 = "speedybee-f405-v4";
    for (old, new, error) in [
        ("\"PC13\"", "\"PC4\"", "x.toml:34: led.pin = PC4: already used by imu.ready"),
        (
            "\"PC13\"",
            "\"PA14\"",
            "x.toml:34: led.pin = PA14: must not be a pin of the debug probe (PA13, PA14)",
        ),
        (
            "\"PC13\"",
            "\"PE3\"",
            "x.toml:34: led.pin = PE3: must be a pin of the STM32F405RG: PA0 to PC15, or PD2",
        ),
        (
            "\"PC13\"",
            "\"PC013\"",
            "x.toml:34: led.pin = PC013: must be a pin of the STM32F405RG: PA0 to PC15, or PD2",
        ),
        (
            "{ pin = \"PB0\", timer = \"TIM3\"",
            "{ pin = \"PC2\", timer = \"TIM3\"",
            "x.toml:41: motors.M3.timer = TIM3: must be a timer with a channel at PC2; no motor timer has one",
        ),
        (
            "{ pin = \"PB0\", timer = \"TIM3\"",
            "{ pin = \"PB0\", timer = \"TIM4\"",
            "x.toml:41: motors.M3.timer = TIM4: must be a timer with a channel at PB0: TIM1, TIM3 or TIM8",
        ),
        (
            "{ pin = \"PB0\", timer = \"TIM3\"",
            "{ pin = \"PA2\", timer = \"TIM5\"",
            "x.toml:41: motors.M3.timer = TIM5: must not be TIM5, which counts the firmware's microseconds",
        ),
        (
            "{ pin = \"PB0\", timer = \"TIM3\"",
            "{ pin = \"PC9\", timer = \"TIM3\"",
            "x.toml:42: motors.M4.pin = PB1: uses channel 4 of TIM3, already used by M3",
        ),
        ("rear-left", "rear-right", "x.toml:41: motors.M3.rotor = rear-right: already used by M1"),
        ("M3 =", "M5 =", "x.toml:38: motors = M5: must be one of M1, M2, M3, M4 (did you mean `M1`?)"),
        ("\"PA6\"", "\"PB5\"", "x.toml:14: imu.miso = PB5: must be a pin with MISO of SPI1: PA6, PB4"),
        ("\"SPI1\"", "\"SPI2\"", "x.toml:12: imu.spi = SPI2: must be one of SPI1 (did you mean `SPI1`?)"),
        (
            "\"USART2\"",
            "\"USART1\"",
            "x.toml:27: receiver.rx = PA3: must be a pin with RX of USART1: PA10, PB7",
        ),
        (
            "pin = \"PC0\"",
            "pin = \"PC6\"",
            "x.toml:30: battery.pin = PC6: must be a pin with an ADC1 channel: PA0 to PA7, PB0, PB1, PC0 to PC5",
        ),
        ("ratio = 11.0", "ratio = 0.5", "x.toml:31: battery.ratio = 0.5: must be from 1 to 50 V/V"),
        ("crystal_mhz = 8", "crystal_mhz = 2", "x.toml:8: crystal_mhz = 2: must be from 4 to 26 MHz"),
        (
            "stm32f405",
            "stm32f411",
            "x.toml:7: mcu = stm32f411: must be one of stm32f405 (did you mean `stm32f405`?)",
        ),
    ] {
        assert_eq!(refused(v4, old, new), error);
    }
    assert!(refused(v4, "[led]", "[lde]").contains("did you mean `led`"));
    assert!(parsed("").is_err());
    let named = Board::load("matek-f405").unwrap_err().to_string();
    assert!(named.contains("did you mean `matek-f405-te`"), "{named}");
}

/// Checks that the timers of every board get their own streams, and that a conflict names the requests.
#[test]
fn each_dma_stream_is_assigned_once() {
    let request = |name: &str, options: &[(u8, u8)]| chip::StreamRequest {
        name: name.into(),
        options: options
            .iter()
            .map(|&(controller, number)| Stream { controller, number, channel: 0 })
            .collect(),
    };
    let numbers = |requests: &[chip::StreamRequest]| {
        chip::assign(requests)
            .map(|streams| streams.iter().map(|s| (s.controller, s.number)).collect::<Vec<_>>())
    };
    // The first request takes its second choice.
    let flexible = request("a", &[(1, 1), (1, 7)]);
    assert_eq!(numbers(&[flexible.clone(), request("b", &[(1, 1)])]), Ok(vec![(1, 7), (1, 1)]));
    let both = [request("SPI3 receive", &[(1, 2)]), request("TIM3 update", &[(1, 2)])];
    assert_eq!(numbers(&both), Err("SPI3 receive and TIM3 update need the same DMA1 stream 2".into()));
    // All motor timers are used at once, with the IMU.
    let all: Vec<chip::StreamRequest> = chip::spi1_requests()
        .into_iter()
        .chain(chip::timers().into_iter().map(chip::timer_request))
        .collect();
    let streams = numbers(&all).unwrap();
    let distinct: std::collections::BTreeSet<_> = streams.iter().collect();
    assert_eq!(distinct.len(), all.len());
}
