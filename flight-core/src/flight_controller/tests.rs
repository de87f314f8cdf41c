//! The chain as it is joined: what a step takes, what it leaves out, and what it does with time. What comes out of
//! anything that may come in stands in `tests/any_input`, and whole flights in the `tests` crate.

use super::*;
use crate::Params;
use crate::estimator::EstimatorParams;
use crate::imu_check::StuckCheck;
use crate::rc::{CENTRE_TICKS, HIGH_TICKS, LOW_TICKS};
use crate::sample::{Battery, BenchCommand, Health, LinkStatus, MagSample};
use proptest::prelude::*;

/// A sensor without noise behind no prefilter: what it reads is what is known of the rates.
fn params() -> Params {
    Params {
        stuck_check: StuckCheck { gyro: false, accel: false },
        prefilter_cutoff_hz: None,
        ..Params::default()
    }
}

/// 1 g in counts of 16 g over 32,768.
const LEVEL: ImuSample = ImuSample { gyro: [0; 3], accel: [0, 0, -2048] };
/// 25 and 41 µT in counts of a thirtieth.
const NORTH: MagSample = MagSample { counts: [750, 0, 1230] };

const CENTRED: RcFrame = RcFrame {
    channels: [LOW_TICKS, CENTRE_TICKS, CENTRE_TICKS, CENTRE_TICKS],
    arm_switch: LOW_TICKS,
    mode_switch: LOW_TICKS,
    status: LinkStatus::Good,
};
const ARM: RcFrame = RcFrame { channels: [LOW_TICKS, CENTRE_TICKS, CENTRE_TICKS, HIGH_TICKS], ..CENTRED };
const DISARM: RcFrame = RcFrame { channels: [LOW_TICKS, CENTRE_TICKS, CENTRE_TICKS, LOW_TICKS], ..CENTRED };

/// A throttle near this share, sticks centred; and the share that it is.
fn throttle(share: f32) -> (RcFrame, f32) {
    let ticks = (share * 1639.0) as u16;
    let [_, roll, pitch, yaw] = CENTRED.channels;
    (RcFrame { channels: [LOW_TICKS + ticks, roll, pitch, yaw], ..CENTRED }, f32::from(ticks) / 1639.0)
}

/// A flight controller and what surrounds it, a millisecond a step.
struct World {
    controller: FlightController,
    time_us: u64,
    sample: ImuSample,
    field: Option<MagSample>,
    frame: RcFrame,
    battery_v: f32,
    health: Health,
    bench: Option<BenchCommand>,
}

impl World {
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

    /// Runs milliseconds; the last output, and the last event of all of them.
    fn run(&mut self, ms: u32) -> (Output, Option<Event>) {
        let mut told = None;
        for _ in 1..ms {
            self.time_us += 1_000;
            told = self.controller.step(&self.input()).event.or(told);
        }
        self.time_us += 1_000;
        let output = self.controller.step(&self.input());
        let told = output.event.or(told);
        (output, told)
    }

    /// Lies still, and asks for the motors: what is told last.
    fn ask(&mut self) -> Option<Event> {
        self.run(1_500);
        self.frame = ARM;
        self.run(1_600).1
    }

    /// In the air, with this throttle.
    fn flying(params: Params, share: f32) -> Self {
        let mut world = Self::new(params);
        let armed = world.ask();
        assert_eq!(armed.map(|event| event.to), Some(ArmState::Armed), "{armed:?}");
        world.frame = throttle(share).0;
        world.run(100);
        world
    }
}

/// The pulse of a share of the largest thrust, 1,000 to 2,000 µs: thrust goes with the square of the speed.
fn pulse_us(share: f32) -> f32 {
    1_000.0 + 1_000.0 * share.sqrt()
}

fn all_near(pulses_us: [f32; 4], expected_us: f32) -> bool {
    pulses_us.iter().all(|us| (us - expected_us).abs() < 0.5)
}

#[test]
fn it_arms_after_a_rest_flies_by_the_sticks_and_stops() {
    let mut world = World::new(params());
    assert_eq!(world.controller.state(), ArmState::Disarmed);
    let (output, _) = world.run(1_500);
    assert_eq!((output.pulses_us, output.permit.is_none()), ([1_000.0; 4], true));
    world.frame = ARM;
    // A second of gesture from the first frame that is not late, and half a second of checking.
    assert_eq!(world.run(1_000).0.state, ArmState::Disarmed);
    assert_eq!(world.run(100).0.state, ArmState::Arming);
    assert_eq!(world.run(500).0.state, ArmState::Armed);
    for share in [0.5, 0.3, 0.8] {
        let (frame, share) = throttle(share);
        world.frame = frame;
        let (output, _) = world.run(50);
        assert!(output.permit.is_some() && all_near(output.pulses_us, pulse_us(share)), "{output:?}");
        assert_eq!(world.controller.state(), ArmState::Armed);
    }
    world.frame = DISARM;
    let (output, told) = world.run(700);
    assert_eq!(told.map(|event| (event.to, event.cause)), Some((ArmState::Disarmed, Cause::Pilot)));
    assert_eq!((output.pulses_us, output.permit.is_none()), ([1_000.0; 4], true));
}

#[test]
fn whatever_stands_against_arming_is_told() {
    type Change = fn(&mut World);
    let obstacles: [(Cause, Change); 5] = [
        (Cause::BatteryLow, |world| world.battery_v = 10.4),
        (Cause::BenchLock, |world| world.health.usb = true),
        // 30° to the right: gravity's sine and cosine.
        (Cause::NotLevel, |world| world.sample.accel = [0, -1024, -1774]),
        // 366 °/s.
        (Cause::NotStill, |world| world.sample.gyro = [6_000, 0, 0]),
        (Cause::ThrottleUp, |world| world.frame = throttle(0.2).0),
    ];
    for (cause, change) in obstacles {
        // By the switch, so that the throttle may be anywhere.
        let mut world = World::new(Params { arm_by: ArmBy::Switch, ..params() });
        change(&mut world);
        world.run(1_400);
        world.frame.arm_switch = HIGH_TICKS;
        let (_, told) = world.run(1_200);
        let refused = Event { from: ArmState::Disarmed, to: ArmState::Disarmed, cause };
        assert_eq!(told, Some(refused));
    }
    // At 24° it may.
    let mut world = World::new(params());
    world.sample.accel = [0, -833, -1871];
    assert_eq!(world.ask().map(|event| event.to), Some(ArmState::Armed));

    let mut world = World::new(params());
    world.controller = FlightController::new(&Config { params: params(), calibration: None }).unwrap();
    assert_eq!(world.ask().map(|event| event.cause), Some(Cause::NoCalibration));

    // Zeroed, and then turned about steadily, or broken: the zero is still known, and of no use.
    for counts in [6_000, i16::MAX, -400] {
        let mut world = World::new(params());
        world.run(1_500);
        world.sample.gyro = [0, 0, counts];
        // Two seconds, so that all of the mean is of that.
        world.run(2_000);
        world.frame = ARM;
        let (_, told) = world.run(1_200);
        assert_eq!(told.map(|event| event.cause), Some(Cause::NotStill), "{counts}");
    }
}

#[test]
fn a_missed_deadline_stands_against_arming_for_a_second() {
    for (ms, may) in [(800, false), (1_200, true)] {
        let mut world = World::new(Params { arm_by: ArmBy::Switch, ..params() });
        world.run(1_500);
        world.frame.arm_switch = HIGH_TICKS;
        // The request is heard about a second later.
        world.run(1_100 - ms.min(1_100));
        world.health.missed_deadlines = 3;
        let (_, told) = world.run(ms);
        let cause = told.map(|event| event.cause);
        assert_eq!(cause == Some(Cause::Overload), !may, "{ms} ms: {told:?}");
    }
}

#[test]
fn a_watchdogs_reset_counts_in_the_first_step() {
    let mut world = World::new(params());
    world.health.watchdog_reset = true;
    assert_eq!(world.run(1).0.state, ArmState::Terminated);
    let mut world = World::new(params());
    world.run(1);
    world.health.watchdog_reset = true;
    assert_eq!(world.run(10).0.state, ArmState::Disarmed);
}

/// The gyroscope's counts show whether a step has been taken.
#[test]
fn time_goes_on_or_is_set_back_and_nothing_else() {
    let at = |controller: &mut FlightController, time_us: u64, counts: i16| {
        let imu = Some(ImuSample { gyro: [counts, 0, 0], ..LEVEL });
        controller.step(&Input { time_us, imu, ..Input::default() });
        let radians = f64::from(controller.rates_rad_s().x);
        (radians.to_degrees() * 16.4).round() as i16
    };
    let begun = || {
        let config = Config { params: params(), calibration: None };
        let mut controller = FlightController::new(&config).unwrap();
        assert_eq!(at(&mut controller, 1_000_000, 1_000), 1_000);
        controller
    };
    let mut controller = begun();
    assert_eq!(at(&mut controller, 1_000_000, 2_000), 1_000, "the same time once more");
    assert_eq!(at(&mut controller, 999_990, 2_000), 1_000);
    // Back by what an inertial sample may be old, and the clock is still the one of before.
    assert_eq!(at(&mut controller, 900_000, 2_000), 1_000);
    assert_eq!(at(&mut controller, 950_000, 2_000), 1_000);
    assert_eq!(at(&mut controller, 1_000_001, 2_000), 2_000);
    // By more, and it goes on from there.
    let mut controller = begun();
    assert_eq!(at(&mut controller, 899_999, 2_000), 1_000);
    assert_eq!(at(&mut controller, 900_000, 2_000), 2_000);
}

#[test]
fn a_sensor_is_lost_after_a_tenth_of_a_second_and_then_begun_anew() {
    // 20° to the right.
    let tilted = ImuSample { accel: [0, -700, -1924], ..LEVEL };
    for (silent_us, lost) in [(99_999, false), (100_000, false), (100_001, true), (500_000, true)] {
        let mut world = World::flying(params(), 0.5);
        world.time_us += silent_us;
        let state = world.controller.step(&Input { imu: None, ..world.input() }).state;
        assert_eq!(state == ArmState::Terminated, lost, "{silent_us} µs: {state:?}");

        // On the ground the first sample after it sets the attitude, or counts as one among two seconds.
        let mut world = World::new(params());
        world.run(2_000);
        world.time_us += silent_us;
        world.controller.step(&Input { imu: Some(tilted), ..world.input() });
        let roll = world.controller.attitude().to_euler().roll.to_degrees();
        let expected = if lost { 20.0 } else { 20.0 * 0.1 / 2.1 };
        assert!((roll - expected).abs() < 0.1, "{silent_us} µs: {roll}°");
    }
    // The code for no sample is none.
    let mut world = World::flying(params(), 0.5);
    world.sample = ImuSample { gyro: [i16::MIN; 3], accel: [i16::MIN; 3] };
    assert_eq!(world.run(100).0.state, ArmState::Armed);
    assert_eq!(world.run(1).0.state, ArmState::Terminated);
}

#[test]
fn between_samples_the_pulses_stay_and_the_next_one_covers_the_time() {
    let mut world = World::flying(params(), 0.5);
    let (before, _) = world.run(1);
    world.frame = throttle(0.7).0;
    for _ in 0..25 {
        world.time_us += 1_000;
        let output = world.controller.step(&Input { imu: None, ..world.input() });
        assert_eq!(output.pulses_us, before.pulses_us);
    }
    assert!(all_near(world.run(1).0.pulses_us, pulse_us(throttle(0.7).1)));

    // 1 rad/s for a second and a half, every sample or every third: the heading is the time.
    for every in [1, 3] {
        let mut world = World::new(params());
        world.run(1);
        world.sample.gyro = [0, 0, 940];
        for n in 0..1_500 {
            world.time_us += 1_000;
            let imu = (n % every == every - 1).then_some(world.sample);
            world.controller.step(&Input { imu, ..world.input() });
        }
        let yaw = world.controller.attitude().to_euler().yaw;
        let expected = 1.5 * (940.0_f32 / 16.4).to_radians();
        assert!((yaw - expected).abs() < 1e-3, "every {every}: {yaw}, not {expected}");
    }
}

/// A frame that comes with a field waits for the next step, but not for a second time.
#[test]
fn sticks_wait_for_one_step_where_the_magnetometer_has_its_turn() {
    let mut world = World::flying(params(), 0.5);
    let mut step = |frame: Option<f32>, field: bool| {
        world.time_us += 1_000;
        let input =
            Input { rc: frame.map(|share| throttle(share).0), mag: field.then_some(NORTH), ..world.input() };
        world.controller.step(&input).pulses_us
    };
    let is = |pulses_us, share| all_near(pulses_us, pulse_us(throttle(share).1));
    assert!(is(step(Some(0.6), false), 0.6), "at once");
    assert!(is(step(Some(0.7), true), 0.6), "waits");
    assert!(is(step(None, false), 0.7), "and comes");
    assert!(is(step(Some(0.6), true), 0.7), "waits");
    assert!(is(step(Some(0.5), true), 0.5), "the next one is newer, and one waits no longer");
    assert!(is(step(None, false), 0.5));
    assert!(is(step(Some(0.6), true), 0.5), "waits");
    assert!(is(step(Some(0.7), false), 0.7), "the newer one");
    assert!(is(step(None, false), 0.7));
}

/// Rolled by 10°, which angle mode takes away and rate mode keeps.
#[test]
fn the_mode_is_the_switchs_until_a_descent() {
    let mut world = World::new(params());
    world.sample.accel = [0, -356, -2017];
    world.ask();
    world.frame = RcFrame { mode_switch: HIGH_TICKS, ..throttle(0.6).0 };
    let (output, _) = world.run(100);
    assert!(all_near(output.pulses_us, pulse_us(throttle(0.6).1)), "{output:?}");
    world.frame.mode_switch = LOW_TICKS;
    let levels = |pulses_us: [f32; 4]| {
        let [front_left, front_right, rear_right, rear_left] = pulses_us;
        front_left + 50.0 < front_right && rear_left + 50.0 < rear_right
    };
    assert!(levels(world.run(100).0.pulses_us));
    // An empty battery: level, whatever the switch says.
    world.frame.mode_switch = HIGH_TICKS;
    world.battery_v = 8.5;
    let (output, told) = world.run(3_200);
    assert_eq!(told.map(|event| event.cause), Some(Cause::BatteryCritical));
    assert!(levels(output.pulses_us), "{output:?}");
}

#[test]
fn a_descent_has_no_more_than_its_throttle() {
    let mut world = World::flying(params(), 0.8);
    world.battery_v = 8.5;
    assert!(all_near(world.run(2_900).0.pulses_us, pulse_us(throttle(0.8).1)));
    let (output, _) = world.run(200);
    assert_eq!(output.state, ArmState::Descent);
    assert!(all_near(output.pulses_us, pulse_us(0.475)), "{output:?}");
    // Less, if the pilot says so.
    world.frame = throttle(0.3).0;
    assert!(all_near(world.run(50).0.pulses_us, pulse_us(throttle(0.3).1)));
    // And by itself, if nobody does.
    let mut world = World::flying(params(), 0.3);
    world.frame.status = LinkStatus::Failsafe;
    let (output, told) = world.run(50);
    assert_eq!(told.map(|event| (event.to, event.cause)), Some((ArmState::Descent, Cause::RcLost)));
    assert!(all_near(output.pulses_us, pulse_us(0.475)), "{output:?}");
}

#[test]
fn who_is_on_its_back_is_stopped_in_angle_mode_only() {
    for (mode_switch, stopped) in [(LOW_TICKS, true), (HIGH_TICKS, false)] {
        let mut world = World::flying(params(), 0.5);
        world.frame.mode_switch = mode_switch;
        world.run(50);
        // Half a turn in half a second, and then nothing that shows that it is one.
        world.sample = ImuSample { gyro: [5_904, 0, 0], accel: [0; 3] };
        world.run(500);
        world.sample.gyro = [0; 3];
        let (output, told) = world.run(700);
        assert_eq!(output.state == ArmState::Terminated, stopped, "{told:?}");
        assert_eq!(told.is_some_and(|event| event.cause == Cause::TiltLimit), stopped);
    }
}

#[test]
fn one_motor_turns_on_the_bench() {
    for rotor in 1..=4_u8 {
        let mut world = World::new(params());
        world.run(10);
        world.bench = Some(BenchCommand { rotor, thrust: 0.05 });
        let (output, _) = world.run(10);
        assert_eq!(output.state, ArmState::Bench);
        for (index, us) in output.pulses_us.into_iter().enumerate() {
            let expected = if index + 1 == usize::from(rotor) { pulse_us(0.05) } else { 1_000.0 };
            assert!((us - expected).abs() < 0.01, "rotor {rotor}: {output:?}");
        }
        let allowed = output.permit.unwrap().apply([2_000.0; 4], 1_000.0);
        assert!((allowed[usize::from(rotor) - 1] - pulse_us(0.1)).abs() < 0.01);
        world.bench = None;
        assert_eq!(world.run(251).0.pulses_us, [1_000.0; 4]);
    }
}

#[test]
fn maintenance_is_for_who_is_on_the_ground() {
    let mut world = World::new(params());
    world.run(10);
    world.health.maintenance = true;
    assert_eq!(world.run(1).0.state, ArmState::Maintenance);
    let mut world = World::flying(params(), 0.5);
    world.health.maintenance = true;
    assert_eq!(world.run(10).0.state, ArmState::Armed);
}

#[test]
fn a_stuck_axis_stops_the_motors() {
    let mut world = World::flying(params(), 0.5);
    let checked = Params { stuck_check: StuckCheck { gyro: true, accel: false }, ..params() };
    world.controller.imu_check = ImuCheck::new(checked.stuck_check, checked.imu_rate_hz);
    assert_eq!(world.run(150).1.map(|event| event.cause), Some(Cause::ImuStuck));
}

proptest! {
    // Ten seconds of flight each.
    #![proptest_config(ProptestConfig { cases: 24, ..ProptestConfig::default() })]

    /// What is known of the rates, and what is taken for bias, are together what the gyroscope reads: at rest, and in
    /// flight, where one filter goes on learning.
    #[test]
    fn rates_and_bias_are_the_reading(
        bias in prop::array::uniform3(-180..180_i16),
        drift in prop::array::uniform3(-40..40_i16),
        robust in any::<bool>(),
    ) {
        let estimator = if robust { EstimatorParams::ROBUST } else { EstimatorParams::FLIGHT };
        let mut world = World::new(Params { estimator, ..params() });
        world.sample.gyro = bias;
        let armed = world.ask();
        prop_assert_eq!(armed.map(|event| event.to), Some(ArmState::Armed));
        let read = |counts: [i16; 3]| counts.map(|n| (f64::from(n) / 16.4).to_radians());
        let found = |v: Vec3<f32>| <[f32; 3]>::from(v).map(f64::from);
        for (zero, read) in found(world.controller.gyro_bias_rad_s()).into_iter().zip(read(bias)) {
            prop_assert!((zero - read).abs() < 1e-5, "{} {}", zero, read);
        }
        // It lies at rest and is still taken to fly: nothing is zeroed any more. Of a drift the robust filter makes a
        // tilt, and of the tilt a bias.
        let before = world.controller.gyro_bias_rad_s();
        world.frame = throttle(0.5).0;
        for (axis, drift) in world.sample.gyro.iter_mut().zip(drift) {
            *axis += drift;
        }
        world.run(7_000);
        let after = world.controller.gyro_bias_rad_s();
        let rates = found(world.controller.rates_rad_s());
        for ((rate, bias), read) in rates.into_iter().zip(found(after)).zip(read(world.sample.gyro)) {
            prop_assert!((rate + bias - read).abs() < 1e-5, "{} {} {}", rate, bias, read);
        }
        let moved = drift[0].abs() + drift[1].abs() > 10;
        prop_assert!((before != after) == robust || !moved);
        // With 40 counts, 0.043 rad/s, learnt slowly or not at all; doubled, it would be twice that.
        let tilt = world.controller.attitude().down().z.clamp(-1.0, 1.0).acos();
        prop_assert!(tilt < 7.0 * 0.043 * 1.5, "{}", tilt);
    }
}

/// Without a field the robust filter's heading goes by the gyroscope less its zero.
#[test]
fn the_zero_is_taken_from_what_every_filter_gets() {
    for (_, estimator) in EstimatorParams::PRESETS {
        let mut world = World::new(Params { estimator, ..params() });
        world.sample.gyro = [0, 0, 300];
        world.run(2_000);
        let before = world.controller.attitude().to_euler().yaw;
        world.run(4_000);
        let turned = world.controller.attitude().to_euler().yaw - before;
        assert!(turned.abs() < 1e-3, "{turned}");
    }
}
