//! A vehicle at rest on the ground, with faults that a test can switch on.

use flight_core::arming::Event;
use flight_core::calibration::Calibration;
use flight_core::rc::{CENTRE_TICKS, HIGH_TICKS, LOW_TICKS};
use flight_core::sample::{Battery, BenchCommand, Health, ImuSample, Input, LinkStatus, RcFrame};
use flight_core::{ArmState, Config, FlightController, Params};

/// Throttle low, all other sticks centred.
pub const CENTRED: [u16; 4] = [LOW_TICKS, CENTRE_TICKS, CENTRE_TICKS, CENTRE_TICKS];
/// The arm gesture.
pub const ARM: [u16; 4] = [LOW_TICKS, CENTRE_TICKS, CENTRE_TICKS, HIGH_TICKS];
/// The disarm gesture.
pub const DISARM: [u16; 4] = [LOW_TICKS, CENTRE_TICKS, CENTRE_TICKS, LOW_TICKS];

/// Period of receiver frames, ms.
const FRAME_MS: u64 = 20;

/// The default configuration, with a calibration.
pub fn config() -> Config {
    Config { params: Params::default(), calibration: Some(Calibration::NONE) }
}

/// The vehicle at rest, its flight controller, and the outputs so far.
pub struct StillVehicle {
    controller: FlightController,
    ms: u64,
    frame: Option<RcFrame>,
    bench: Option<(BenchCommand, u64)>,
    pub battery_v: Option<f32>,
    pub health: Health,
    pub sensor_dead: bool,
    pub invalid_code: bool,
    pub axis_stuck: bool,
    pub all_zeros: bool,
    pub shaken: bool,
    pub tilt_deg: f64,
    pub misses_a_deadline_every_ms: Option<u64>,
    /// State changes and refusals so far.
    pub events: Vec<Event>,
    /// Whether a motor permit was ever issued.
    pub turned: bool,
    /// The last pulses sent to the ESCs, µs.
    pub pulses_us: [f32; 4],
}

impl StillVehicle {
    pub fn new(config: &Config) -> Self {
        Self {
            controller: FlightController::new(config).unwrap(),
            ms: 0,
            frame: None,
            bench: None,
            battery_v: Some(12.0),
            health: Health::default(),
            sensor_dead: false,
            invalid_code: false,
            axis_stuck: false,
            all_zeros: false,
            shaken: false,
            tilt_deg: 0.0,
            misses_a_deadline_every_ms: None,
            events: vec![],
            turned: false,
            pulses_us: [1_000.0; 4],
        }
    }

    pub fn state(&self) -> ArmState {
        self.controller.state()
    }

    fn frame(&mut self) -> &mut RcFrame {
        self.frame.get_or_insert(RcFrame {
            channels: CENTRED,
            arm_switch: LOW_TICKS,
            mode_switch: LOW_TICKS,
            status: LinkStatus::Good,
        })
    }

    pub fn sticks(&mut self, channels: [u16; 4]) -> &mut Self {
        self.frame().channels = channels;
        self
    }

    pub fn arm_switch(&mut self, ticks: u16) -> &mut Self {
        self.frame().arm_switch = ticks;
        self
    }

    pub fn link_status(&mut self, status: LinkStatus) -> &mut Self {
        self.frame().status = status;
        self
    }

    pub fn silence(&mut self) -> &mut Self {
        self.frame = None;
        self
    }

    pub fn bench_every_ms(&mut self, command: Option<BenchCommand>, ms: u64) -> &mut Self {
        self.bench = command.map(|command| (command, ms));
        self
    }

    pub fn run_ms(&mut self, ms: u64) -> &mut Self {
        for _ in 0..ms {
            let frame = self.frame.filter(|_| self.ms.is_multiple_of(FRAME_MS));
            self.step(frame);
        }
        self
    }

    /// Runs one step, with this frame from the receiver.
    pub fn step(&mut self, rc: Option<RcFrame>) {
        let ms = self.ms;
        if self.misses_a_deadline_every_ms.is_some_and(|every| ms.is_multiple_of(every)) {
            self.health.missed_deadlines += 1;
        }
        let input = Input {
            time_us: ms * 1_000,
            imu: (!self.sensor_dead).then(|| self.sample()),
            mag: None,
            rc,
            battery: self.battery_v.map(|voltage_v| Battery { voltage_v }),
            bench: self.bench.and_then(|(command, every)| ms.is_multiple_of(every).then_some(command)),
            health: self.health,
        };
        let output = self.controller.step(&input);
        self.events.extend(output.event);
        self.turned |= output.permit.is_some();
        self.pulses_us = match output.permit {
            Some(permit) => permit.apply(output.pulses_us, 1_000.0),
            None => {
                assert_eq!(output.pulses_us, [1_000.0; 4], "pulses without a permit");
                [1_000.0; 4]
            }
        };
        self.ms += 1;
    }

    fn sample(&self) -> ImuSample {
        if self.invalid_code {
            return ImuSample { gyro: [i16::MIN; 3], accel: [i16::MIN; 3] };
        }
        if self.all_zeros {
            return ImuSample::default();
        }
        // The noise is one count with a period of seven milliseconds, in which no axis stands still.
        let noise = |axis: u64| ((self.ms + axis) % 7 % 3) as i16 - 1;
        let g = 2_048.0;
        let (sin, cos) = (libm::sin(self.tilt_deg.to_radians()), libm::cos(self.tilt_deg.to_radians()));
        let turn = if self.shaken && (self.ms / 100).is_multiple_of(2) { 164 } else { 0 };
        let mut sample = ImuSample {
            gyro: [noise(0) + turn, noise(1), noise(2)],
            // Rolled to the right, the specific force points up, which is to the left in body axes.
            accel: [noise(3), (-g * sin) as i16 + noise(4), (-g * cos) as i16 + noise(5)],
        };
        if self.axis_stuck {
            sample.gyro[1] = 3;
        }
        sample
    }
}
