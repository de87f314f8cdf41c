//! `flight-core` in a program without the standard library: three seconds on the ground, then the arm gesture.
//!
//! ```sh
//! cargo run -p no-std-loop                        # on the host
//! cargo run --profile flash -p no-std-loop --target thumbv7em-none-eabihf --config .cargo/qemu.toml   # on QEMU
//! ```
//!
//! Both print the same lines. A program on a board takes `time_us` from a timer and the counts from the IMU, and sends the
//! pulses to the ESCs. It must send them only with a permit: [`MotorPermit::apply`](flight_core::MotorPermit::apply).
#![cfg_attr(target_os = "none", no_std, no_main)]
#![forbid(unsafe_code)]

use flight_core::rc::{CENTRE_TICKS, HIGH_TICKS, LOW_TICKS};
use flight_core::sample::{Battery, Health, ImuSample, LinkStatus, RcFrame};
use flight_core::{ArmState, Calibration, Config, FlightController, Input, Params};

/// Period of the control loop, µs.
const PERIOD_US: u64 = 1_000;
/// One standard gravity in counts of an accelerometer with a full scale of ±16 g.
const ONE_G: i16 = 2_048;

/// Steps a flight controller for six seconds, and calls `report` with each new arm state and its time, µs.
///
/// The vehicle lies level and does not move. From the third second on, the throttle is low and the yaw stick is at its
/// right stop: the arm gesture.
fn run(mut report: impl FnMut(u64, ArmState)) {
    let config = Config { params: Params::default(), calibration: Some(Calibration::NONE) };
    let mut controller = FlightController::new(&config).expect("the default parameters are in range");
    let mut state = controller.state();
    for step in 0..6_000 {
        let time_us = step * PERIOD_US;
        let yaw = if time_us < 3_000_000 { CENTRE_TICKS } else { HIGH_TICKS };
        // A real sensor is never exactly still: a constant reading counts as a stuck sensor.
        let noise = (step % 3) as i16 - 1;
        let input = Input {
            time_us,
            // Level and at rest: the accelerometer measures specific force, which points up, and z points down.
            imu: Some(ImuSample { gyro: [noise, -noise, noise], accel: [noise, noise, noise - ONE_G] }),
            mag: None,
            // The receiver sends 50 frames a second.
            rc: (step % 20 == 0).then_some(RcFrame {
                channels: [LOW_TICKS, CENTRE_TICKS, CENTRE_TICKS, yaw],
                arm_switch: LOW_TICKS,
                mode_switch: LOW_TICKS,
                status: LinkStatus::Good,
            }),
            battery: Some(Battery { voltage_v: 12.0 }),
            bench: None,
            health: Health::default(),
        };
        let output = controller.step(&input);
        if output.state != state {
            state = output.state;
            report(time_us, state);
        }
    }
}

#[cfg(not(target_os = "none"))]
fn main() {
    run(|time_us, state| println!("{time_us:7} us  {}", state.name()));
}

#[cfg(target_os = "none")]
mod board {
    use cortex_m_semihosting::{debug, hprintln};
    use panic_semihosting as _;

    #[cortex_m_rt::entry]
    fn main() -> ! {
        super::run(|time_us, state| hprintln!("{time_us:7} us  {}", state.name()));
        debug::exit(debug::EXIT_SUCCESS);
        loop {
            cortex_m::asm::wfi();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arm_gesture_arms() {
        let mut states = Vec::new();
        run(|time_us, state| states.push((time_us, state)));
        let [(checking_us, ArmState::Arming), (armed_us, ArmState::Armed)] = states[..] else {
            panic!("{states:?}")
        };
        // The gesture is held for 1 s before the checks begin.
        assert!((4_000_000..4_040_000).contains(&checking_us), "{checking_us}");
        assert!(armed_us > checking_us && armed_us < 5_000_000, "{armed_us}");
    }
}
