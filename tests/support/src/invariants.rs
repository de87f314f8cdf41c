//! The invariants of the flight controller for any input, checked after each step against the inputs themselves.

use std::collections::BTreeSet;

use flight_core::arming::table::rows;
use flight_core::bench::BENCH_SILENT_US;
use flight_core::flight_controller::IMU_LOST_US;
use flight_core::rc::link::RC_LOST_US;
use flight_core::sample::LinkStatus;
use flight_core::{ArmState, Config, FlightController, Input};

/// A flight controller whose invariants are checked in every step.
pub struct CheckedController {
    controller: FlightController,
    config: Config,
    last: Last,
    /// Names of the states reached so far.
    pub states: BTreeSet<&'static str>,
}

/// The outputs of the last step, and the times of the last inputs.
struct Last {
    step_us: Option<u64>,
    /// Elapsed time, µs, unaffected when the clock is set back. The times below use this scale.
    now_us: u64,
    state: ArmState,
    pulses_us: [f32; 4],
    permitted: bool,
    imu_us: Option<u64>,
    frame_us: Option<u64>,
    bench_us: Option<u64>,
    battery: Option<(u64, f32)>,
}

impl CheckedController {
    /// Returns `None` if the configuration is refused.
    pub fn new(config: &Config) -> Option<Self> {
        let controller = FlightController::new(config).ok()?;
        let last = Last {
            step_us: None,
            now_us: 0,
            state: ArmState::Disarmed,
            pulses_us: [config.params.esc.stop_us; 4],
            permitted: false,
            imu_us: None,
            frame_us: None,
            bench_us: None,
            battery: None,
        };
        Some(Self { controller, config: *config, last, states: BTreeSet::new() })
    }

    /// Runs one step and checks every invariant after it.
    pub fn step(&mut self, input: &Input) {
        let output = self.controller.step(input);
        let permitted = output.permit.is_some();
        let stop_us = self.config.params.esc.stop_us;
        let full_us = self.config.params.esc.full_us;
        let (state, pulses_us) = (output.state, output.pulses_us);

        let attitude = self.controller.attitude();
        assert!((attitude.norm_squared() - 1.0).abs() < 1e-3, "{attitude:?} is not a rotation");
        let rates = <[f32; 3]>::from(self.controller.rates_rad_s());
        assert!(rates.iter().all(|rate| rate.is_finite()), "{rates:?} rad/s");
        let bias = self.controller.gyro_bias_rad_s();
        assert!(bias.norm() <= 0.3501, "a bias of {bias:?} rad/s");

        for us in pulses_us {
            assert!(us >= stop_us && us <= full_us, "{us} µs in {state:?}");
        }
        if !permitted {
            assert_eq!(pulses_us, [stop_us; 4], "pulses without a permit in {state:?}");
        }
        match (state, output.permit) {
            (ArmState::Armed | ArmState::Descent, permit) => {
                let airframe = &self.config.params.airframe;
                let idle_us = stop_us + (full_us - stop_us) * (airframe.idle_rad_s / airframe.max_rad_s);
                assert!(pulses_us.iter().all(|us| *us >= idle_us - 0.01), "{pulses_us:?}, idle is {idle_us}");
                let allowed_us = permit.expect("a permit in every flying state").apply(pulses_us, stop_us);
                assert_eq!(allowed_us, pulses_us);
            }
            (ArmState::Bench, Some(permit)) => {
                let limit_us = stop_us + (full_us - stop_us) * self.config.params.bench.max_thrust.sqrt();
                let allowed_us = permit.apply([full_us; 4], stop_us);
                let turning = allowed_us.iter().filter(|us| **us != stop_us).count();
                assert!(turning <= 1 && allowed_us.iter().all(|us| *us <= limit_us + 0.01), "{allowed_us:?}");
                assert!(pulses_us.iter().zip(allowed_us).all(|(us, limit_us)| *us <= limit_us));
            }
            (ArmState::Bench, None) => {}
            (_, permit) => assert!(permit.is_none(), "a permit in {state:?}"),
        }

        if let Some(event) = output.event {
            assert_eq!((event.from, event.to), (self.last.state, state));
            let row = rows(event.from).iter().find(|row| row.to == event.to && row.cause == event.cause);
            assert!(row.is_some(), "{event:?} is in no row of the arming table");
        } else {
            assert_eq!(state, self.last.state, "a state change without an event");
        }

        let since_last = self.last.step_us.map(|last_us| input.time_us.checked_sub(last_us));
        if let Some(None | Some(0)) = since_last {
            // Time that stands or runs backwards: the input is ignored and the last output stands. A clock that was set
            // back by more than `IMU_LOST_US` becomes the new reference.
            if self.last.step_us.is_some_and(|last_us| last_us - input.time_us > u64::from(IMU_LOST_US)) {
                self.last.step_us = Some(input.time_us);
            }
            assert_eq!(
                (state, pulses_us, permitted),
                (self.last.state, self.last.pulses_us, self.last.permitted)
            );
            return;
        }
        self.last.now_us = self.last.now_us.saturating_add(since_last.flatten().unwrap_or(0));
        self.record_inputs(input);
        self.check_motors_may_turn(input, state, permitted);
        self.last.step_us = Some(input.time_us);
        (self.last.state, self.last.pulses_us, self.last.permitted) = (state, pulses_us, permitted);
        self.states.insert(state.name());
    }

    fn record_inputs(&mut self, input: &Input) {
        let last = &mut self.last;
        let now_us = last.now_us;
        if input.imu.is_some_and(|sample| sample.gyro.iter().chain(&sample.accel).any(|n| *n != i16::MIN)) {
            last.imu_us = Some(now_us);
        }
        if input.rc.is_some_and(|frame| frame.status == LinkStatus::Good) {
            last.frame_us = Some(now_us);
        }
        if input.bench.is_some_and(|c| (1..=4).contains(&c.rotor) && c.thrust >= 0.0 && c.thrust <= 1.0) {
            last.bench_us = Some(now_us);
        }
        if let Some(battery) = input.battery {
            last.battery = Some((now_us, battery.voltage_v));
        }
    }

    /// Checks that no motor turns where the input times alone forbid it.
    fn check_motors_may_turn(&self, input: &Input, state: ArmState, permitted: bool) {
        let last = &self.last;
        let age_us = |at_us: Option<u64>| at_us.map_or(u64::MAX, |at_us| last.now_us - at_us);
        if state.flies() {
            assert!(!input.health.usb, "{state:?} with USB plugged in");
            let imu_us = age_us(last.imu_us);
            assert!(imu_us <= u64::from(IMU_LOST_US), "{state:?} with a last sample {imu_us} µs old");
        }
        if state == ArmState::Armed {
            let frame_us = age_us(last.frame_us);
            assert!(frame_us <= u64::from(RC_LOST_US), "armed with a last frame {frame_us} µs old");
        }
        if state == ArmState::Armed && last.state == ArmState::Arming {
            assert!(self.config.calibration.is_some(), "armed without a calibration");
            assert!(!input.health.maintenance, "armed in maintenance");
            let (at_us, voltage_v) = last.battery.expect("a battery voltage before arming");
            assert!(voltage_v >= self.config.params.min_arm_voltage_v, "armed on {voltage_v} V");
            assert!(last.now_us - at_us <= 2_000_000, "armed on a battery voltage older than 2 s");
        }
        if state == ArmState::Bench && permitted {
            let command_us = age_us(last.bench_us);
            assert!(
                command_us <= u64::from(BENCH_SILENT_US),
                "a motor turns on the bench {command_us} µs after the last command"
            );
        }
    }

    /// Checks that no number in the whole state is NaN or infinite, including those that do not reach the outputs.
    pub fn check_state_is_finite(&self) {
        // The measured battery voltage is stored as it came; it is only ever compared.
        let state = format!("{:?}", self.controller);
        let words = state.split([' ', ',', '(', ')', '[', ']', '{', '}']);
        let mut field = "";
        for word in words.filter(|word| !word.is_empty()) {
            let number = matches!(word, "NaN" | "inf" | "-inf");
            assert!(!number || field == "voltage_v:", "{field} {word} in {state}");
            if word.ends_with(':') {
                field = word;
            }
        }
    }
}
