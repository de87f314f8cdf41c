//! Counts the instructions of the processing stages on QEMU's Cortex-M4F: see the module `instruction_counter`.
//!
//! A stage's count includes its call, as the compiler has generated it.
//!
//! A line of output is `icount,<stage>,<inputs>,<instructions in all>,<most for one input>`. One more line for each
//! preset of the estimator, `attitudes,<preset>,<digest>`, shows that it computes the same as on the host.
#![no_std]
#![no_main]

mod instruction_counter;

use core::hint::black_box;

use cortex_m_semihosting::hprintln;
// This program logs nothing, but the linker script of this package's images needs a logger.
use defmt_rtt as _;
use fixed_input::{FLIGHT, PERIOD_US, STEPS};
use flight_core::arithmetic::{atan2, sin_cos, sqrt, wrap_pi};
use flight_core::calibration::{SensorCalibration, SensorFields, SensorModel};
use flight_core::control::Controller;
use flight_core::esc::Esc;
use flight_core::esc::protocol::{DSHOT_SLOTS, DshotThrottle, dshot_duty_pairs};
use flight_core::estimator::{Estimator, EstimatorParams};
use flight_core::geometry::Vec3;
use flight_core::mixer::{Mixer, Saturation, Wrench};
use flight_core::prefilter::{Biquad, Prefilter, Section};
use flight_core::rc::{CENTRE_TICKS, FlightMode, Sticks};
use flight_core::sample::RcFrame;
use flight_core::{ConfigError, FlightController, Input, Output, Params};
use instruction_counter::{InstructionCounter, Total};
use panic_semihosting as _;
use receiver::{Protocol, Receiver};

/// Slots that are the inputs of a stage: the table's first ones in flight.
const INPUTS: core::ops::Range<u32> = FLIGHT..FLIGHT + 1_200;
/// Sample period, s.
const DT_S: f32 = PERIOD_US as f32 * 1.0e-6;

#[cortex_m_rt::entry]
fn main() -> ! {
    let counter = InstructionCounter::start();
    kernels(&counter);
    receivers(&counter);
    if let Err(error) = stages(&counter).and_then(|()| steps(&counter)).and_then(|()| attitudes()) {
        panic!("{error}");
    }
    instruction_counter::exit()
}

fn kernels(counter: &InstructionCounter) {
    let angles = || INPUTS.map(|slot| (slot - FLIGHT) as f32 * 5.0e-3 - 3.0);
    counter.stage("sin_cos", angles(), |x| sin_cos(*x));
    counter.stage("atan2", angles(), |x| atan2(*x, 1.0 - *x));
    counter.stage("sqrt", angles(), |x| sqrt(x.abs()));
    counter.stage("wrap_pi", angles(), |x| wrap_pi(3.0 * *x));
}

/// Counts the work of `tick` for each byte of the receiver: repeated centred sticks in both protocols; and the worst
/// case for CRSF, starts of frames that all end with the same byte and are all invalid.
fn receivers(counter: &InstructionCounter) {
    let packed = pack(&[CENTRE_TICKS; 16]);
    let mut crsf = [0; 26];
    crsf[..3].copy_from_slice(&[0xc8, 24, 0x16]);
    crsf[3..25].copy_from_slice(&packed);
    crsf[25] = crc(&crsf[2..25]);
    let mut sbus = [0; 25];
    sbus[0] = 0x0f;
    sbus[1..23].copy_from_slice(&packed);
    let nested: [u8; 64] = core::array::from_fn(|n| if n % 2 == 0 { 0xc8 } else { 63 - n as u8 });

    for (name, protocol, bytes, pause_us) in [
        ("receiver CRSF byte", Protocol::Crsf, &crsf[..], 4_000),
        ("receiver SBUS byte", Protocol::Sbus, &sbus[..], 7_000),
        ("receiver CRSF byte at worst", Protocol::Crsf, &nested[..], 4_000),
    ] {
        let mut receiver = Receiver::new(protocol);
        let times = (0..2_600).map(|n| (n, (n / bytes.len() * pause_us + n % bytes.len() * 24) as u64));
        let inputs = times.map(|(n, time_us)| (bytes[n % bytes.len()], time_us));
        counter.stage(name, inputs, |(byte, time_us)| push(&mut receiver, *byte, *time_us));
    }
}

#[inline(never)]
fn push(receiver: &mut Receiver, byte: u8, time_us: u64) -> Option<receiver::Frame> {
    receiver.push(byte, time_us)
}

/// Packs 16 channels of 11 bits, the lowest bit first.
fn pack(channels: &[u16; 16]) -> [u8; 22] {
    let mut packed = [0; 22];
    for bit in 0..176 {
        packed[bit / 8] |= ((channels[bit / 11] >> (bit % 11) & 1) as u8) << (bit % 8);
    }
    packed
}

/// Computes the CRC-8/DVB-S2.
fn crc(bytes: &[u8]) -> u8 {
    bytes.iter().fold(0, |crc, byte| {
        (0..8).fold(crc ^ byte, |crc, _| crc << 1 ^ if crc & 0x80 != 0 { 0xd5 } else { 0 })
    })
}

/// The readings of a slot's three sensors in SI units, calibrated and prefiltered.
#[derive(Clone, Copy)]
struct Reading {
    gyro: Vec3<f32>,
    accel: Vec3<f32>,
    mag: Vec3<f32>,
}

/// The first two stages, which produce the inputs of the others.
struct Front {
    gyro: SensorModel,
    accel: SensorModel,
    mag: SensorModel,
    filters: [Prefilter; 3],
}

impl Front {
    fn new(params: &Params) -> Result<Self, ConfigError> {
        let cutoff_hz = params.prefilter_cutoff_hz.unwrap_or(30.0);
        let filter = Prefilter::new(Some(Biquad::butterworth(cutoff_hz, params.imu_rate_hz)?));
        Ok(Self {
            gyro: SensorModel::new(SensorFields::GYRO, params.gyro, SensorCalibration::NONE)?,
            accel: SensorModel::new(SensorFields::ACCEL, params.accel, SensorCalibration::NONE)?,
            mag: SensorModel::new(SensorFields::MAG, params.mag, SensorCalibration::NONE)?,
            filters: [filter; 3],
        })
    }

    #[inline(never)]
    fn calibrate(&self, slot: &u32) -> Reading {
        let imu = fixed_input::imu(*slot);
        self.apply(&(imu.gyro, imu.accel, fixed_input::mag(*slot).counts))
    }

    #[inline(never)]
    fn apply(&self, (gyro, accel, mag): &([i16; 3], [i16; 3], [i16; 3])) -> Reading {
        Reading { gyro: self.gyro.apply(*gyro), accel: self.accel.apply(*accel), mag: self.mag.apply(*mag) }
    }

    #[inline(never)]
    fn filter(&mut self, raw: &Reading) -> Reading {
        let [gyro, accel, mag] = &mut self.filters;
        Reading { gyro: gyro.step(raw.gyro), accel: accel.step(raw.accel), mag: mag.step(raw.mag) }
    }
}

/// A biquad of one axis, called once for each sample as in other flight stacks.
#[inline(never)]
fn biquad((design, section): &mut (Biquad, Section), x: f32) -> f32 {
    section.step(design, x)
}

#[inline(never)]
fn update_9_axis(estimator: &mut Estimator, r: &Reading) {
    estimator.update(r.gyro, r.accel, Some(r.mag), DT_S);
}

#[inline(never)]
fn update_6_axis(estimator: &mut Estimator, r: &Reading) {
    estimator.update(r.gyro, r.accel, None, DT_S);
}

#[inline(never)]
fn control(controller: &mut Controller, (estimator, r): &(Estimator, Reading)) -> Vec3<f32> {
    controller.step(estimator.down(), estimator.heading(), r.gyro, Saturation::default(), DT_S)
}

#[inline(never)]
fn sticks(controller: &mut Controller, frame: &RcFrame) {
    controller.set_sticks(&Sticks::from_frame(frame), FlightMode::from_frame(frame));
}

#[inline(never)]
fn mix(mixer: &Mixer, esc: &Esc, wrench: &Wrench) -> [f32; 4] {
    let (squares, _) = mixer.mix(wrench);
    Mixer::speeds(squares).map(|speed| esc.pulse_us(speed))
}

/// Encodes four pulses as the tables that DMA sends: the flight board's outputs do this in each step, and write
/// registers.
#[inline(never)]
fn dshot_frames(pulses_us: &[f32; 4]) -> [[u32; DSHOT_SLOTS]; 2] {
    let [m1, m2, m3, m4] = pulses_us.map(|us| DshotThrottle::from_pulse(us).frame(false));
    [dshot_duty_pairs([m1, m2], 280), dshot_duty_pairs([m3, m4], 280)]
}

fn stages(counter: &InstructionCounter) -> Result<(), ConfigError> {
    let params = fixed_input::config().params;
    let mut front = Front::new(&params)?;

    let counts = INPUTS.map(|slot| {
        let imu = fixed_input::imu(slot);
        (imu.gyro, imu.accel, fixed_input::mag(slot).counts)
    });
    counter.stage("calibration of 3 sensors", counts, |counts| front.apply(counts));
    let sensors = Front::new(&params)?;
    // The first sample sets the states, and is a stage of its own.
    let raw = || INPUTS.map(|slot| sensors.calibrate(&slot));
    front.filter(&sensors.calibrate(&FLIGHT));
    counter.stage("9 prefilters", raw(), |raw| front.filter(raw));
    let mut first = Total::default();
    for raw in raw() {
        let mut fresh = Front::new(&params)?;
        first.add(counter.count(|| fresh.filter(black_box(&raw))).1);
    }
    first.print("first sample of 9 prefilters");
    let mut axis = (Biquad::butterworth(30.0, params.imu_rate_hz)?, Section::default());
    counter.stage("8 biquads one by one", raw(), |raw| (0..8).fold(raw.gyro.x, |x, _| biquad(&mut axis, x)));
    // A step of full scale, its decay through the denormals, and then denormals only: the largest is 1.2e-38, and the
    // filter's gain is 1.
    let mut axis = (axis.0, Section::default());
    let tail = INPUTS.map(|slot| match slot - FLIGHT {
        0..100 => 2_000.0,
        100..600 => 0.0,
        _ => f32::from_bits((slot % 1_000 * 5_000) | (slot << 31)),
    });
    counter.stage("8 biquads down a tail", tail, |x| (0..8).fold(*x, |x, _| biquad(&mut axis, x)));

    for (name, preset) in EstimatorParams::PRESETS {
        for (axes, update) in [(9, update_9_axis as fn(&mut Estimator, &Reading)), (6, update_6_axis)] {
            let mut estimator = Estimator::new(&preset)?;
            let mut front = Front::new(&params)?;
            let readings = INPUTS.map(|slot| {
                let raw = front.calibrate(&slot);
                front.filter(&raw)
            });
            counter
                .stage(format_args!("estimator {name} {axes}-axis"), readings, |r| update(&mut estimator, r));
        }
    }

    let mut controller = Controller::new(&params.control, params.airframe.inertia_kg_m2)?;
    controller.set_sticks(&Sticks { throttle: 0.5, roll: 0.2, pitch: -0.1, yaw: 0.0 }, FlightMode::Angle);
    counter.stage("sticks", INPUTS.map(fixed_input::sticks), |frame| sticks(&mut controller, frame));
    let mut front = Front::new(&params)?;
    let mut estimator = Estimator::new(&params.estimator)?;
    let states = INPUTS.map(|slot| {
        let raw = front.calibrate(&slot);
        let reading = front.filter(&raw);
        update_9_axis(&mut estimator, &reading);
        (estimator, reading)
    });
    counter.stage("control", states, |state| control(&mut controller, state));

    let mixer = Mixer::new(&params.airframe)?;
    let esc = Esc::new(&params.esc, params.airframe.idle_rad_s, params.airframe.max_rad_s)?;
    let wrenches = INPUTS.map(|slot| Wrench {
        thrust_n: (slot % 128) as f32 * 0.1,
        torque_n_m: front.calibrate(&slot).gyro * 0.3,
    });
    counter.stage("mixer and ESC", wrenches, |wrench| mix(&mixer, &esc, wrench));
    let pulses =
        INPUTS.map(|slot| [0.0, 0.25, 0.5, 0.75].map(|share| 1_000.0 + share * (slot % 1_024) as f32));
    counter.stage("4 DShot frames", pulses, dshot_frames);
    Ok(())
}

#[inline(never)]
fn step(controller: &mut FlightController, input: &Input) -> Output {
    controller.step(input)
}

/// Counts the whole step over the whole table, grouped by the inputs of the step.
fn steps(counter: &InstructionCounter) -> Result<(), ConfigError> {
    let mut controller = FlightController::new(&fixed_input::config())?;
    let [mut all, mut disarmed, mut missing, mut six, mut nine] = [Total::default(); 5];
    for slot in 0..STEPS {
        let input = black_box(fixed_input::input(slot));
        let (output, instructions) = counter.count(|| step(&mut controller, black_box(&input)));
        all.add(instructions);
        let kind = match (input.imu, input.mag, &output.permit) {
            (None, ..) => &mut missing,
            (.., None) => &mut disarmed,
            (_, None, _) => &mut six,
            (_, Some(_), _) => &mut nine,
        };
        kind.add(instructions);
    }
    all.print("step");
    disarmed.print("step disarmed");
    missing.print("step without a sample");
    six.print("step in flight 6-axis");
    nine.print("step in flight 9-axis");

    // This is the full load: every sensor has a sample in every step.
    let mut controller = FlightController::new(&fixed_input::config())?;
    let mut every = Total::default();
    for slot in 0..INPUTS.end {
        let mut input = fixed_input::input(slot);
        input.mag = Some(fixed_input::mag(slot));
        let input = black_box(input);
        let (output, instructions) = counter.count(|| step(&mut controller, black_box(&input)));
        if output.permit.is_some() && INPUTS.contains(&slot) {
            every.add(instructions);
        }
    }
    every.print("step in flight 9-axis every time");
    Ok(())
}

fn attitudes() -> Result<(), ConfigError> {
    for (name, preset) in EstimatorParams::PRESETS {
        hprintln!("attitudes,{},{}", name, fixed_input::attitudes_digest(&preset)?);
    }
    Ok(())
}
