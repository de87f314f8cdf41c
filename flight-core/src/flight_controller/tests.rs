//! Tests of the complete chain: what a step processes, what it omits, and how it handles time. `tests/any_input`
//! tests the output for any input, and the `tests` crate tests whole flights.

use super::*;
use crate::Params;
use crate::estimator::EstimatorParams;
use crate::imu_check::StuckCheck;
use crate::rc::{CENTRE_TICKS, HIGH_TICKS, LOW_TICKS};
use crate::sample::{Battery, BenchCommand, Health, LinkStatus, MagSample};
use proptest::prelude::*;

/// Sensors without noise and no prefilter: the readings are the known rates.
fn params() -> Params {
    Params {
        stuck_check: StuckCheck { gyro: false, accel: false },
        prefilter_cutoff_hz: None,
        ..Params::default()
    }
}

/// A sample of a vehicle that is level and at rest: 1 g, in counts of 16 g/32,768.
const LEVEL: ImuSample = ImuSample { gyro: [0; 3], accel: [0, 0, -2048] };
/// A field of 25 µT north and 41 µT down, in counts of 1/30 µT.
const NORTH: MagSample = MagSample { counts: [750, 0, 1230] };

const CENTRED: RcFrame = RcFrame {
    channels: [LOW_TICKS, CENTRE_TICKS, CENTRE_TICKS, CENTRE_TICKS],
    arm_switch: LOW_TICKS,
    mode_switch: LOW_TICKS,
    status: LinkStatus::Good,
};
const ARM: RcFrame = RcFrame { channels: [LOW_TICKS, CENTRE_TICKS, CENTRE_TICKS, HIGH_TICKS], ..CENTRED };
const DISARM: RcFrame = RcFrame { channels: [LOW_TICKS, CENTRE_TICKS, CENTRE_TICKS, LOW_TICKS], ..CENTRED };

/// Returns a frame with centred sticks and a throttle near this share, and the exact share.
fn throttle(share: f32) -> (RcFrame, f32) {
    let ticks = (share * 1639.0) as u16;
    let [_, roll, pitch, yaw] = CENTRED.channels;
    (RcFrame { channels: [LOW_TICKS + ticks, roll, pitch, yaw], ..CENTRED }, f32::from(ticks) / 1639.0)
}

/// A flight controller and its inputs, with steps of one millisecond.
struct Harness {
    controller: FlightController,
    time_us: u64,
    sample: ImuSample,
    field: Option<MagSample>,
    frame: RcFrame,
    battery_v: f32,
    health: Health,
    bench: Option<BenchCommand>,
}

impl Harness {
    fn new(params: Params) -> Self {
        let config = Config { params, calibration: Some(Calibration::NONE) };
        Self {
            controller: FlightController::new(&config).unwrap(),
            time_us: 0,
            sample: LEVEL,
            field: None,
            frame: CENTRED,
            battery_v: 12.0,
            health: Health::default(),
            bench: None,
        }
    }

    fn input(&self) -> Input {
        Input {
            time_us: self.time_us,
            imu: Some(self.sample),
            mag: self.field,
            rc: self.time_us.is_multiple_of(20_000).then_some(self.frame),
            battery: Some(Battery { voltage_v: self.battery_v }),
            bench: self.bench,
            health: self.health,
        }
    }

    /// Runs `ms` steps of one millisecond. Returns the last output and the last event.
    fn run(&mut self, ms: u32) -> (Output, Option<Event>) {
        let mut last_event = None;
        for _ in 1..ms {
            self.time_us += 1_000;
            last_event = self.controller.step(&self.input()).event.or(last_event);
        }
        self.time_us += 1_000;
        let output = self.controller.step(&self.input());
        let last_event = output.event.or(last_event);
        (output, last_event)
    }

    /// Rests, then requests arming. Returns the last event.
    fn request_arming(&mut self) -> Option<Event> {
        self.run(1_500);
        self.frame = ARM;
        self.run(1_600).1
    }

    /// Returns an armed vehicle with this throttle.
    fn flying(params: Params, share: f32) -> Self {
        let mut harness = Self::new(params);
        let armed = harness.request_arming();
        assert_eq!(armed.map(|event| event.to), Some(ArmState::Armed), "{armed:?}");
        harness.frame = throttle(share).0;
        harness.run(100);
        harness
    }
}

/// Returns the pulse for a share of the maximum thrust, 1,000 to 2,000 µs: thrust is proportional to the square of
/// the speed.
fn pulse_us(share: f32) -> f32 {
    1_000.0 + 1_000.0 * share.sqrt()
}

fn all_near(pulses_us: [f32; 4], expected_us: f32) -> bool {
    pulses_us.iter().all(|us| (us - expected_us).abs() < 0.5)
}

#[test]
fn vehicle_arms_flies_by_the_sticks_and_disarms() {
    let mut harness = Harness::new(params());
    assert_eq!(harness.controller.state(), ArmState::Disarmed);
    let (output, _) = harness.run(1_500);
    assert_eq!((output.pulses_us, output.permit.is_none()), ([1_000.0; 4], true));
    harness.frame = ARM;
    // The gesture takes 1 s from the first frame with a link, and the checks take another 0.5 s.
    assert_eq!(harness.run(1_000).0.state, ArmState::Disarmed);
    assert_eq!(harness.run(100).0.state, ArmState::Arming);
    assert_eq!(harness.run(500).0.state, ArmState::Armed);
    for share in [0.5, 0.3, 0.8] {
        let (frame, share) = throttle(share);
        harness.frame = frame;
        let (output, _) = harness.run(50);
        assert!(output.permit.is_some() && all_near(output.pulses_us, pulse_us(share)), "{output:?}");
        assert_eq!(harness.controller.state(), ArmState::Armed);
    }
    harness.frame = DISARM;
    let (output, event) = harness.run(700);
    assert_eq!(event.map(|event| (event.to, event.cause)), Some((ArmState::Disarmed, Cause::Pilot)));
    assert_eq!((output.pulses_us, output.permit.is_none()), ([1_000.0; 4], true));
}

#[test]
fn every_obstacle_to_arming_is_reported() {
    type Change = fn(&mut Harness);
    let obstacles: [(Cause, Change); 5] = [
        (Cause::BatteryLow, |harness| harness.battery_v = 10.4),
        (Cause::BenchLock, |harness| harness.health.usb = true),
        // The vehicle is rolled 30° to the right, so y and z read the sine and the cosine of 30° times gravity.
        (Cause::NotLevel, |harness| harness.sample.accel = [0, -1024, -1774]),
        // 366 °/s.
        (Cause::NotStill, |harness| harness.sample.gyro = [6_000, 0, 0]),
        (Cause::ThrottleUp, |harness| harness.frame = throttle(0.2).0),
    ];
    for (cause, change) in obstacles {
        // Armed by the switch, so that any throttle is possible.
        let mut harness = Harness::new(Params { arm_by: ArmBy::Switch, ..params() });
        change(&mut harness);
        harness.run(1_400);
        harness.frame.arm_switch = HIGH_TICKS;
        let (_, event) = harness.run(1_200);
        let refused = Event { from: ArmState::Disarmed, to: ArmState::Disarmed, cause };
        assert_eq!(event, Some(refused));
    }
    // At 24° arming is permitted.
    let mut harness = Harness::new(params());
    harness.sample.accel = [0, -833, -1871];
    assert_eq!(harness.request_arming().map(|event| event.to), Some(ArmState::Armed));

    let mut harness = Harness::new(params());
    harness.controller = FlightController::new(&Config { params: params(), calibration: None }).unwrap();
    assert_eq!(harness.request_arming().map(|event| event.cause), Some(Cause::NoCalibration));

    // Zeroed first, then turning steadily or with a stuck gyroscope: the zero exists but is no longer valid.
    for counts in [6_000, i16::MAX, -400] {
        let mut harness = Harness::new(params());
        harness.run(1_500);
        harness.sample.gyro = [0, 0, counts];
        // 2 s, so that the mean contains only these readings.
        harness.run(2_000);
        harness.frame = ARM;
        let (_, event) = harness.run(1_200);
        assert_eq!(event.map(|event| event.cause), Some(Cause::NotStill), "{counts}");
    }
}

#[test]
fn missed_deadline_prevents_arming_for_a_second() {
    for (ms, permitted) in [(800, false), (1_200, true)] {
        let mut harness = Harness::new(Params { arm_by: ArmBy::Switch, ..params() });
        harness.run(1_500);
        harness.frame.arm_switch = HIGH_TICKS;
        // The request takes effect about a second later.
        harness.run(1_100 - ms.min(1_100));
        harness.health.missed_deadlines = 3;
        let (_, event) = harness.run(ms);
        let cause = event.map(|event| event.cause);
        assert_eq!(cause == Some(Cause::Overload), !permitted, "{ms} ms: {event:?}");
    }
}

#[test]
fn watchdog_reset_counts_only_in_the_first_step() {
    let mut harness = Harness::new(params());
    harness.health.watchdog_reset = true;
    assert_eq!(harness.run(1).0.state, ArmState::Terminated);
    let mut harness = Harness::new(params());
    harness.run(1);
    harness.health.watchdog_reset = true;
    assert_eq!(harness.run(10).0.state, ArmState::Disarmed);
}

/// The counts of the gyroscope show whether a step was processed.
#[test]
fn step_needs_later_time_or_a_clock_set_back() {
    let at = |controller: &mut FlightController, time_us: u64, counts: i16| {
        let imu = Some(ImuSample { gyro: [counts, 0, 0], ..LEVEL });
        controller.step(&Input { time_us, imu, ..Input::default() });
        let radians = f64::from(controller.rates_rad_s().x);
        (radians.to_degrees() * 16.4).round() as i16
    };
    let started = || {
        let config = Config { params: params(), calibration: None };
        let mut controller = FlightController::new(&config).unwrap();
        assert_eq!(at(&mut controller, 1_000_000, 1_000), 1_000);
        controller
    };
    let mut controller = started();
    assert_eq!(at(&mut controller, 1_000_000, 2_000), 1_000, "the same time again");
    assert_eq!(at(&mut controller, 999_990, 2_000), 1_000);
    // If the time stamp is earlier by at most the permitted age of an IMU sample, the previous time stays valid.
    assert_eq!(at(&mut controller, 900_000, 2_000), 1_000);
    assert_eq!(at(&mut controller, 950_000, 2_000), 1_000);
    assert_eq!(at(&mut controller, 1_000_001, 2_000), 2_000);
    // The time stamp is earlier by more than that: time continues from the new value.
    let mut controller = started();
    assert_eq!(at(&mut controller, 899_999, 2_000), 1_000);
    assert_eq!(at(&mut controller, 900_000, 2_000), 2_000);
}

#[test]
fn sensor_is_lost_after_100_ms_and_then_restarts() {
    // 20° to the right.
    let tilted = ImuSample { accel: [0, -700, -1924], ..LEVEL };
    for (silent_us, lost) in [(99_999, false), (100_000, false), (100_001, true), (500_000, true)] {
        let mut harness = Harness::flying(params(), 0.5);
        harness.time_us += silent_us;
        let state = harness.controller.step(&Input { imu: None, ..harness.input() }).state;
        assert_eq!(state == ArmState::Terminated, lost, "{silent_us} µs: {state:?}");

        // On the ground the first sample after a loss sets the attitude; without a loss it is one sample in a mean
        // over 2 s.
        let mut harness = Harness::new(Params { estimator: EstimatorParams::FLIGHT, ..params() });
        harness.run(2_000);
        harness.time_us += silent_us;
        harness.controller.step(&Input { imu: Some(tilted), ..harness.input() });
        let roll = harness.controller.attitude().to_euler().roll.to_degrees();
        let expected = if lost { 20.0 } else { 20.0 * 0.1 / 2.1 };
        assert!((roll - expected).abs() < 0.1, "{silent_us} µs: {roll}°");
    }
    // A sample with the code for invalid data does not count.
    let mut harness = Harness::flying(params(), 0.5);
    harness.sample = ImuSample { gyro: [i16::MIN; 3], accel: [i16::MIN; 3] };
    assert_eq!(harness.run(100).0.state, ArmState::Armed);
    assert_eq!(harness.run(1).0.state, ArmState::Terminated);
}

#[test]
fn pulses_stay_between_samples_and_no_time_is_lost() {
    let mut harness = Harness::flying(params(), 0.5);
    let (before, _) = harness.run(1);
    harness.frame = throttle(0.7).0;
    for _ in 0..25 {
        harness.time_us += 1_000;
        let output = harness.controller.step(&Input { imu: None, ..harness.input() });
        assert_eq!(output.pulses_us, before.pulses_us);
    }
    assert!(all_near(harness.run(1).0.pulses_us, pulse_us(throttle(0.7).1)));

    // 1 rad/s for 1.5 s, with every sample or every third: the heading is the elapsed time.
    for every in [1, 3] {
        let mut harness = Harness::new(params());
        harness.run(1);
        harness.sample.gyro = [0, 0, 940];
        for n in 0..1_500 {
            harness.time_us += 1_000;
            let imu = (n % every == every - 1).then_some(harness.sample);
            harness.controller.step(&Input { imu, ..harness.input() });
        }
        let yaw = harness.controller.attitude().to_euler().yaw;
        let expected = 1.5 * (940.0_f32 / 16.4).to_radians();
        assert!((yaw - expected).abs() < 1e-3, "every {every}: {yaw}, not {expected}");
    }
}

/// A frame that arrives with a magnetometer sample is deferred by one step, but not twice.
#[test]
fn sticks_are_deferred_once_by_a_magnetometer_sample() {
    let mut harness = Harness::flying(params(), 0.5);
    let mut step = |frame: Option<f32>, field: bool| {
        harness.time_us += 1_000;
        let input = Input {
            rc: frame.map(|share| throttle(share).0),
            mag: field.then_some(NORTH),
            ..harness.input()
        };
        harness.controller.step(&input).pulses_us
    };
    let is = |pulses_us, share| all_near(pulses_us, pulse_us(throttle(share).1));
    assert!(is(step(Some(0.6), false), 0.6), "at once");
    assert!(is(step(Some(0.7), true), 0.6), "deferred");
    assert!(is(step(None, false), 0.7), "applied");
    assert!(is(step(Some(0.6), true), 0.7), "deferred");
    assert!(is(step(Some(0.5), true), 0.5), "the next frame is newer and is not deferred again");
    assert!(is(step(None, false), 0.5));
    assert!(is(step(Some(0.6), true), 0.5), "deferred");
    assert!(is(step(Some(0.7), false), 0.7), "the newer frame");
    assert!(is(step(None, false), 0.7));
}

/// Rolled by 10°: angle mode corrects this, rate mode keeps it.
#[test]
fn switch_selects_the_mode_except_in_a_descent() {
    let mut harness = Harness::new(params());
    harness.sample.accel = [0, -356, -2017];
    harness.request_arming();
    harness.frame = RcFrame { mode_switch: HIGH_TICKS, ..throttle(0.6).0 };
    let (output, _) = harness.run(100);
    assert!(all_near(output.pulses_us, pulse_us(throttle(0.6).1)), "{output:?}");
    harness.frame.mode_switch = LOW_TICKS;
    let levels = |pulses_us: [f32; 4]| {
        let [front_left, front_right, rear_right, rear_left] = pulses_us;
        front_left + 50.0 < front_right && rear_left + 50.0 < rear_right
    };
    assert!(levels(harness.run(100).0.pulses_us));
    // The battery is critical, so the setpoint is level at any position of the switch.
    harness.frame.mode_switch = HIGH_TICKS;
    harness.battery_v = 8.5;
    let (output, event) = harness.run(3_200);
    assert_eq!(event.map(|event| event.cause), Some(Cause::BatteryCritical));
    assert!(levels(output.pulses_us), "{output:?}");
}

#[test]
fn descent_limits_the_throttle() {
    let mut harness = Harness::flying(params(), 0.8);
    harness.battery_v = 8.5;
    assert!(all_near(harness.run(2_900).0.pulses_us, pulse_us(throttle(0.8).1)));
    let (output, _) = harness.run(200);
    assert_eq!(output.state, ArmState::Descent);
    assert!(all_near(output.pulses_us, pulse_us(0.475)), "{output:?}");
    // The pilot can command less.
    harness.frame = throttle(0.3).0;
    assert!(all_near(harness.run(50).0.pulses_us, pulse_us(throttle(0.3).1)));
    // Without a pilot it is the descent throttle.
    let mut harness = Harness::flying(params(), 0.3);
    harness.frame.status = LinkStatus::Failsafe;
    let (output, event) = harness.run(50);
    assert_eq!(event.map(|event| (event.to, event.cause)), Some((ArmState::Descent, Cause::RcLost)));
    assert!(all_near(output.pulses_us, pulse_us(0.475)), "{output:?}");
}

#[test]
fn upside_down_is_stopped_in_angle_mode_only() {
    for (mode_switch, stopped) in [(LOW_TICKS, true), (HIGH_TICKS, false)] {
        let mut harness = Harness::flying(params(), 0.5);
        harness.frame.mode_switch = mode_switch;
        harness.run(50);
        // The vehicle makes half a turn in 0.5 s. Then it falls freely, which shows no tilt.
        harness.sample = ImuSample { gyro: [5_904, 0, 0], accel: [0; 3] };
        harness.run(500);
        harness.sample.gyro = [0; 3];
        let (output, event) = harness.run(700);
        assert_eq!(output.state == ArmState::Terminated, stopped, "{event:?}");
        assert_eq!(event.is_some_and(|event| event.cause == Cause::TiltLimit), stopped);
    }
}

#[test]
fn one_motor_turns_on_the_bench() {
    for rotor in 1..=4_u8 {
        let mut harness = Harness::new(params());
        harness.run(10);
        harness.bench = Some(BenchCommand { rotor, thrust: 0.05 });
        let (output, _) = harness.run(10);
        assert_eq!(output.state, ArmState::Bench);
        for (index, us) in output.pulses_us.into_iter().enumerate() {
            let expected = if index + 1 == usize::from(rotor) { pulse_us(0.05) } else { 1_000.0 };
            assert!((us - expected).abs() < 0.01, "rotor {rotor}: {output:?}");
        }
        let allowed = output.permit.unwrap().apply([2_000.0; 4], 1_000.0);
        assert!((allowed[usize::from(rotor) - 1] - pulse_us(0.1)).abs() < 0.01);
        harness.bench = None;
        assert_eq!(harness.run(251).0.pulses_us, [1_000.0; 4]);
    }
}

#[test]
fn maintenance_only_on_the_ground() {
    let mut harness = Harness::new(params());
    harness.run(10);
    harness.health.maintenance = true;
    assert_eq!(harness.run(1).0.state, ArmState::Maintenance);
    let mut harness = Harness::flying(params(), 0.5);
    harness.health.maintenance = true;
    assert_eq!(harness.run(10).0.state, ArmState::Armed);
}

#[test]
fn stuck_axis_stops_the_motors() {
    let mut harness = Harness::flying(params(), 0.5);
    let checked = Params { stuck_check: StuckCheck { gyro: true, accel: false }, ..params() };
    harness.controller.imu_check = ImuCheck::new(checked.stuck_check, checked.imu_rate_hz);
    assert_eq!(harness.run(150).1.map(|event| event.cause), Some(Cause::ImuStuck));
}

proptest! {
    // Each case is ten seconds of flight.
    #![proptest_config(ProptestConfig { cases: 24, ..ProptestConfig::default() })]

    /// The rates and the bias together are the reading of the gyroscope: at rest, and in flight, where one filter
    /// keeps estimating the bias.
    #[test]
    fn rates_plus_bias_equal_the_reading(
        bias in prop::array::uniform3(-180..180_i16),
        drift in prop::array::uniform3(-40..40_i16),
        robust in any::<bool>(),
    ) {
        let estimator = if robust { EstimatorParams::ROBUST } else { EstimatorParams::FLIGHT };
        let mut harness = Harness::new(Params { estimator, ..params() });
        harness.sample.gyro = bias;
        let armed = harness.request_arming();
        prop_assert_eq!(armed.map(|event| event.to), Some(ArmState::Armed));
        let read = |counts: [i16; 3]| counts.map(|n| (f64::from(n) / 16.4).to_radians());
        let found = |v: Vec3<f32>| <[f32; 3]>::from(v).map(f64::from);
        for (zero, read) in found(harness.controller.gyro_bias_rad_s()).into_iter().zip(read(bias)) {
            prop_assert!((zero - read).abs() < 1e-5, "{} {}", zero, read);
        }
        // The vehicle is at rest but counts as flying, so zeroing has stopped. The robust filter turns a drift into a
        // tilt error, and the tilt error into a bias.
        let before = harness.controller.gyro_bias_rad_s();
        harness.frame = throttle(0.5).0;
        for (axis, drift) in harness.sample.gyro.iter_mut().zip(drift) {
            *axis += drift;
        }
        harness.run(7_000);
        let after = harness.controller.gyro_bias_rad_s();
        let rates = found(harness.controller.rates_rad_s());
        for ((rate, bias), read) in rates.into_iter().zip(found(after)).zip(read(harness.sample.gyro)) {
            prop_assert!((rate + bias - read).abs() < 1e-5, "{} {} {}", rate, bias, read);
        }
        let moved = drift[0].abs() + drift[1].abs() > 10;
        prop_assert!((before != after) == robust || !moved);
        // 40 counts are 0.043 rad/s, whether the bias is estimated slowly or not at all; an error of twice that would
        // exceed the bound.
        let tilt = harness.controller.attitude().down().z.clamp(-1.0, 1.0).acos();
        prop_assert!(tilt < 7.0 * 0.043 * 1.5, "{}", tilt);
    }
}

/// Without a field, the heading of the robust filter follows the gyroscope minus its zero.
#[test]
fn every_filter_gets_rates_minus_the_zero() {
    for (_, estimator) in EstimatorParams::PRESETS {
        let mut harness = Harness::new(Params { estimator, ..params() });
        harness.sample.gyro = [0, 0, 300];
        harness.run(2_000);
        let before = harness.controller.attitude().to_euler().yaw;
        harness.run(4_000);
        let turned = harness.controller.attitude().to_euler().yaw - before;
        assert!(turned.abs() < 1e-3, "{turned}");
    }
}
