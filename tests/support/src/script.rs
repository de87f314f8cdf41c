//! Turns bytes into a configuration and a flight. Any bytes are valid, and most flights get into the air.
//!
//! A script begins with changes to the default configuration. Then the vehicle lies still and arms as a pilot would, or
//! does not. Phases follow, in each of which an input is normal, missing, or arbitrary.

use flight_core::calibration::{Calibration, Sensitivity, SensorCalibration};
use flight_core::estimator::{EstimatorParams, Kinematics, Weight};
use flight_core::geometry::{Mat3, Vec3};
use flight_core::rc::{ArmBy, CENTRE_TICKS, HIGH_TICKS, LOW_TICKS};
use flight_core::sample::{Battery, BenchCommand, Health, ImuSample, Input, LinkStatus, MagSample, RcFrame};
use flight_core::{Config, Params, STANDARD_GRAVITY};

use crate::invariants::CheckedController;

/// Values that a number may have by mistake.
pub const SPECIAL: [f32; 14] = [
    0.0,
    -0.0,
    -1.0,
    f32::NAN,
    f32::INFINITY,
    f32::NEG_INFINITY,
    f32::MAX,
    f32::MIN,
    f32::MIN_POSITIVE,
    1.0e-45, // the smallest positive f32
    -1.0e-45,
    1.0e-30,
    1.0e30,
    f32::EPSILON,
];
/// Powers of ten from 1e-8 to 1e8.
pub const POWERS: [f32; 17] =
    [1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 0.1, 1.0, 10.0, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8];
/// Two filters that no preset has, and the presets.
pub const ESTIMATORS: [EstimatorParams; 2 + EstimatorParams::PRESETS.len()] = {
    let of_no_preset = EstimatorParams::complementary(Kinematics::Quaternion, Weight::Fixed { alpha: 0.97 });
    let mut all = [of_no_preset; 2 + EstimatorParams::PRESETS.len()];
    all[1] = EstimatorParams::complementary(Kinematics::Euler, Weight::TimeConstant { tau_s: 10.0 });
    let mut n = 0;
    while n < EstimatorParams::PRESETS.len() {
        all[2 + n] = EstimatorParams::PRESETS[n].1;
        n += 1;
    }
    all
};

/// A source of bytes, followed by endless zeros.
pub struct Bytes<'a>(&'a [u8]);

impl<'a> Bytes<'a> {
    pub fn new(bytes: &'a [u8]) -> Self {
        Self(bytes)
    }

    fn has_more(&self) -> bool {
        !self.0.is_empty()
    }

    fn u8(&mut self) -> u8 {
        let Some((first, rest)) = self.0.split_first() else { return 0 };
        self.0 = rest;
        *first
    }

    fn u16(&mut self) -> u16 {
        u16::from_le_bytes([self.u8(), self.u8()])
    }

    fn u32(&mut self) -> u32 {
        u32::from(self.u16()) | u32::from(self.u16()) << 16
    }

    fn one_in(&mut self, n: u8) -> bool {
        self.u8() % n == n - 1
    }

    /// Returns a number to replace `usual`.
    fn number(&mut self, usual: f32) -> f32 {
        match self.u8() % 8 {
            0..5 => {
                // Larger or smaller by up to 2¹⁵.
                let exponent = u32::from(self.u8() % 31) + 127 - 15;
                let base = if usual == 0.0 { 1.0 } else { usual };
                base * f32::from_bits(exponent << 23) * (1.0 + f32::from(self.u8()) / 256.0)
            }
            5 => -self.number(usual).abs(),
            6 => SPECIAL[usize::from(self.u8()) % SPECIAL.len()],
            _ => f32::from_bits(self.u32()),
        }
    }
}

fn vector(v: &mut Vec3<f32>) -> [&mut f32; 3] {
    [&mut v.x, &mut v.y, &mut v.z]
}

fn matrix(m: &mut Mat3<f32>) -> impl Iterator<Item = &mut f32> {
    m.rows.iter_mut().flat_map(vector)
}

/// Returns references to every number of a configuration.
pub fn numbers(config: &mut Config) -> Vec<&mut f32> {
    let Config { params: p, calibration } = config;
    let mut all = vec![&mut p.imu_rate_hz, &mut p.mag_rate_hz];
    for Sensitivity { per_count, mounting } in [&mut p.gyro, &mut p.accel, &mut p.mag] {
        all.push(per_count);
        all.extend(matrix(mounting));
    }
    all.extend(&mut p.prefilter_cutoff_hz);
    all.extend(p.estimator.settings().map(|setting| setting.value));
    let a = &mut p.airframe;
    all.extend([&mut a.thrust_coefficient, &mut a.torque_coefficient, &mut a.forward_m, &mut a.right_m]);
    all.extend(vector(&mut a.inertia_kg_m2));
    all.extend([&mut a.idle_rad_s, &mut a.max_rad_s]);
    let c = &mut p.control;
    all.extend([&mut c.max_tilt_rad, &mut c.max_stick_rate_rad_s, &mut c.max_yaw_rate_rad_s]);
    all.extend([&mut c.max_tilt_rate_rad_s, &mut c.tilt_p, &mut c.heading_p, &mut c.begin_throttle]);
    for gains in [&mut c.rate_p, &mut c.rate_i, &mut c.rate_d, &mut c.max_integral_rad_s2] {
        all.extend(vector(gains));
    }
    all.extend([&mut p.esc.stop_us, &mut p.esc.full_us]);
    all.extend([&mut p.min_arm_voltage_v, &mut p.critical_voltage_v]);
    all.extend([
        &mut p.descent.throttle,
        &mut p.descent.seconds,
        &mut p.bench.max_thrust,
        &mut p.bench.max_s,
    ]);
    if let Some(Calibration { gyro, accel, mag }) = calibration {
        for SensorCalibration { bias, matrix: m } in [gyro, accel, mag] {
            all.extend(vector(bias));
            all.extend(matrix(m));
        }
    }
    all
}

fn config(bytes: &mut Bytes) -> Config {
    let mut config = Config { params: Params::default(), calibration: Some(Calibration::NONE) };
    config.params.estimator = ESTIMATORS[usize::from(bytes.u8()) % ESTIMATORS.len()];
    if bytes.one_in(8) {
        config.params.prefilter_cutoff_hz = None;
    }
    if bytes.one_in(4) {
        config.params.arm_by = ArmBy::Switch;
    }
    if bytes.one_in(16) {
        config.calibration = None;
    }
    if bytes.one_in(16) {
        config.params.channels.arm = bytes.u8();
    }
    config.params.stuck_check.gyro = !bytes.one_in(4);
    // Mostly no change: a refused configuration does not fly.
    for _ in 0..(bytes.u8() % 8).saturating_sub(4) {
        let index = usize::from(bytes.u8());
        let mut numbers = numbers(&mut config);
        let index = index % numbers.len();
        *numbers[index] = bytes.number(*numbers[index]);
    }
    config
}

/// How the three counts of a sensor are generated in a phase.
#[derive(Clone, Copy, Debug)]
enum Counts {
    /// At rest, level, pointing north.
    AtRest,
    None,
    /// The sensor's code for an invalid sample.
    Invalid,
    Random,
    /// At the ends of the range.
    Ends,
    Always([i16; 3]),
}

impl Counts {
    fn read(bytes: &mut Bytes) -> Self {
        match bytes.u8() % 16 {
            0..8 => Self::AtRest,
            8 | 9 => Self::Random,
            10 | 11 => Self::Ends,
            12 => Self::None,
            13 => Self::Invalid,
            _ => Self::Always([bytes.u16() as i16, bytes.u16() as i16, bytes.u16() as i16]),
        }
    }

    fn at(self, at_rest: [i16; 3], random: &mut Random) -> Option<[i16; 3]> {
        match self {
            Self::AtRest => Some(at_rest.map(|n| n.saturating_add((random.next() % 3) as i16 - 1))),
            Self::None => None,
            Self::Invalid => Some([i16::MIN; 3]),
            Self::Random => Some([(); 3].map(|()| random.next() as i16)),
            Self::Ends => Some([(); 3].map(|()| if random.next() & 1 == 0 { i16::MIN } else { i16::MAX })),
            Self::Always(counts) => Some(counts),
        }
    }
}

/// Xorshift (Marsaglia 2003).
#[derive(Clone, Copy, Debug)]
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0 >> 32
    }
}

/// A part of the flight in which the inputs are of one kind.
#[derive(Clone, Copy, Debug)]
struct Phase {
    steps: u16,
    /// Time from step to step, µs, modulo 2⁶⁴, so that time can also run backwards.
    dt_us: u64,
    gyro: Counts,
    accel: Counts,
    mag: Counts,
    frame: Option<RcFrame>,
    /// Steps from one receiver frame to the next, and from one magnetometer sample to the next.
    every: u16,
    battery: Option<Battery>,
    bench: Option<BenchCommand>,
    health: Health,
}

const CENTRED: RcFrame = RcFrame {
    channels: [LOW_TICKS, CENTRE_TICKS, CENTRE_TICKS, CENTRE_TICKS],
    arm_switch: LOW_TICKS,
    mode_switch: LOW_TICKS,
    status: LinkStatus::Good,
};
/// The arm gesture, with the arm switch on.
const ARM: RcFrame = RcFrame {
    channels: [LOW_TICKS, CENTRE_TICKS, CENTRE_TICKS, HIGH_TICKS],
    arm_switch: HIGH_TICKS,
    ..CENTRED
};

impl Phase {
    const AT_REST: Self = Self {
        steps: 120,
        dt_us: 10_000,
        gyro: Counts::AtRest,
        accel: Counts::AtRest,
        mag: Counts::AtRest,
        frame: Some(CENTRED),
        every: 2,
        battery: Some(Battery { voltage_v: 12.0 }),
        bench: None,
        health: Health { usb: false, maintenance: false, watchdog_reset: false, missed_deadlines: 0 },
    };
    const ARM_GESTURE: Self = Self { steps: 170, frame: Some(ARM), ..Self::AT_REST };

    fn read(bytes: &mut Bytes) -> Self {
        let dt_us = match bytes.u8() % 16 {
            0..6 => 10_000,
            6..10 => 1_000,
            10..13 => u64::from(bytes.u16()),
            13 => u64::from(bytes.u32()),
            14 => u64::from(bytes.u16()).wrapping_neg(),
            _ => u64::from(bytes.u32()) << 32 | u64::from(bytes.u32()),
        };
        let frame = match bytes.u8() % 16 {
            0 => None,
            1 => Some(CENTRED),
            2 => Some(ARM),
            3 => Some(RcFrame { channels: [LOW_TICKS, CENTRE_TICKS, CENTRE_TICKS, LOW_TICKS], ..CENTRED }),
            4 => Some(RcFrame { status: LinkStatus::FrameLost, ..ARM }),
            5 => Some(RcFrame { status: LinkStatus::Failsafe, ..ARM }),
            6 => Some(RcFrame {
                channels: [(); 4].map(|()| bytes.u16()),
                arm_switch: bytes.u16(),
                mode_switch: bytes.u16(),
                status: LinkStatus::Good,
            }),
            // Sticks as in flight.
            mode => Some(RcFrame {
                channels: [(); 4].map(|()| LOW_TICKS + u16::from(bytes.u8()) * 7),
                mode_switch: if mode < 12 { LOW_TICKS } else { HIGH_TICKS },
                ..ARM
            }),
        };
        let battery = match bytes.u8() % 8 {
            0 => None,
            1 => Some(bytes.number(9.0)),
            2 => Some(8.0),
            _ => Some(12.0),
        };
        let bench = match bytes.u8() % 8 {
            0 => Some(BenchCommand { rotor: bytes.u8(), thrust: bytes.number(0.05) }),
            1 => Some(BenchCommand { rotor: 1 + bytes.u8() % 4, thrust: 0.05 }),
            _ => None,
        };
        Self {
            steps: 1 + u16::from(bytes.u8()),
            dt_us,
            gyro: Counts::read(bytes),
            accel: Counts::read(bytes),
            mag: Counts::read(bytes),
            frame,
            every: 1 + u16::from(bytes.u8() % 8),
            battery: battery.map(|voltage_v| Battery { voltage_v }),
            bench,
            health: Health {
                usb: bytes.one_in(16),
                maintenance: bytes.one_in(16),
                watchdog_reset: bytes.one_in(8),
                missed_deadlines: if bytes.one_in(8) { bytes.u32() } else { 0 },
            },
        }
    }
}

/// A configuration and the phases of a flight.
#[derive(Clone, Debug)]
pub struct Script {
    pub config: Config,
    seed: u64,
    start_us: u64,
    phases: Vec<Phase>,
}

impl Script {
    pub fn read(bytes: &mut Bytes) -> Self {
        let config = config(bytes);
        let seed = u64::from(bytes.u32());
        let start_us = if bytes.one_in(8) { u64::MAX - u64::from(bytes.u32()) } else { 0 };
        let mut phases = vec![];
        if !bytes.one_in(4) {
            phases.extend([Phase::AT_REST, Phase::ARM_GESTURE]);
        }
        // Always one flying phase, so that an empty script flies too: sticks up and forward.
        phases.push(Phase {
            frame: Some(RcFrame { channels: [1_500, 1_100, 1_300, 900], ..ARM }),
            ..Phase::AT_REST
        });
        while bytes.has_more() && phases.len() < 16 {
            phases.push(Phase::read(bytes));
        }
        Self { config, seed, start_us, phases }
    }

    pub fn with_config(self, config: Config) -> Self {
        Self { config, ..self }
    }

    pub fn fly(&self, controller: &mut CheckedController) {
        let Params { accel, mag, .. } = &self.config.params;
        // The casts saturate at the converters' range.
        let level = [0, 0, (-STANDARD_GRAVITY / accel.per_count) as i16];
        let north = [25.0, 3.0, 41.0].map(|ut| (ut / mag.per_count) as i16);
        let mut random = Random(self.seed | 1 << 40);
        let mut time_us = self.start_us;
        for phase in &self.phases {
            for n in 0..phase.steps {
                let due = n.is_multiple_of(phase.every);
                let gyro = phase.gyro.at([0; 3], &mut random);
                let accel = phase.accel.at(level, &mut random);
                controller.step(&Input {
                    time_us,
                    imu: gyro.zip(accel).map(|(gyro, accel)| ImuSample { gyro, accel }),
                    mag: phase.mag.at(north, &mut random).filter(|_| due).map(|counts| MagSample { counts }),
                    rc: phase.frame.filter(|_| due),
                    battery: phase.battery,
                    bench: phase.bench,
                    health: phase.health,
                });
                time_us = time_us.wrapping_add(phase.dt_us);
            }
            controller.check_state_is_finite();
        }
    }
}
