//! Counts the instructions of the flight code's alternatives on QEMU's Cortex-M4F, beside those of the flight code
//! itself: see the module `instruction_counter`, and the figures in `studies/src/cost/m4.toml`.
//!
//! Every function is called out of line, and its count includes the call: "call alone" is a function that returns its
//! argument. Inlined into a caller that shares its constants, a function takes less: `sin_cos` takes 35 instructions
//! in a loop (`icount`), and 56 here.
//!
//! A line of output is `icount,<figure>,<inputs>,<instructions in all>,<most for one input>`; a following line
//! `code,<figure>,<address>` gives the address of the figure's code in flash.
#![no_std]
#![no_main]

mod instruction_counter;

use core::f32::consts::PI;
use core::fmt::Display;
use core::ops::Range;
use core::time::Duration;

use alternatives::Real;
use alternatives::integration::{Coning, EulerAngles};
use alternatives::prefilter::{Pt1, butterworth_4};
use cortex_m_semihosting::hprintln;
// This program logs nothing, but the linker script of this package's images needs a logger.
use defmt_rtt as _;
use fixed_input::{FLIGHT, PERIOD_US};
use flight_core::ConfigError;
use flight_core::arithmetic;
use flight_core::calibration::{SensorCalibration, SensorFields, SensorModel};
use flight_core::estimator::{Estimator, EstimatorParams, Filter, Kinematics, Weight};
use flight_core::geometry::{Quaternion, Vec3, vec3};
use flight_core::prefilter::{Biquad, Prefilter};
use flight_core::with_filter;
use instruction_counter::InstructionCounter;
use micromath::F32Ext;
use nalgebra::Vector3;
use panic_semihosting as _;
use uf_ahrs::{Ahrs, Madgwick, MadgwickParams, Mahony, MahonyParams, Vqf, VqfParams};

/// Slots whose samples are the inputs: the table's first ones in flight. Their number can be divided by two and three.
const SLOTS: Range<u32> = FLIGHT..FLIGHT + 1_200;
/// Number of inputs of a function.
const POINTS: u32 = 1_024;
/// Sample period, s.
const DT_S: f32 = PERIOD_US as f32 * 1.0e-6;
/// Sample rate, Hz.
const RATE_HZ: f64 = 1.0e6 / PERIOD_US as f64;
/// Cutoff of the prefilters, Hz. It is the cutoff of the paper.
const CUTOFF_HZ: f64 = 30.0;

#[cortex_m_rt::entry]
fn main() -> ! {
    let counter = InstructionCounter::start();
    functions(&counter);
    if let Err(error) = samples(&counter) {
        panic!("{error}");
    }
    instruction_counter::exit()
}

/// Counts `stage`, which calls the function at `code`, on each of `inputs`.
fn row<I, O>(
    counter: &InstructionCounter,
    name: impl Display,
    code: *const (),
    inputs: impl Iterator<Item = I>,
    stage: impl FnMut(&I) -> O,
) {
    counter.stage(&name, inputs, stage);
    hprintln!("code,{},{:p}", name, code);
}

/// Counts `name: |x| body` for functions of one number or of a pair, on their inputs.
macro_rules! functions {
    ($counter:ident, $inputs:expr; $($name:literal: |$x:ident: $type:ty| $body:expr;)*) => {$({
        #[inline(never)]
        fn measured($x: $type) -> impl Copy {
            $body
        }
        row($counter, concat!("arithmetic ", $name), measured as *const (), $inputs, |x| measured((*x).into()));
    })*};
}

/// Returns `POINTS` numbers, evenly spaced over a range without its ends.
fn over(range: Range<f32>) -> impl Iterator<Item = f32> {
    let step = (range.end - range.start) / POINTS as f32;
    (0..POINTS).map(move |n| range.start + (n as f32 + 0.5) * step)
}

/// Returns points in all directions around the origin, near and far.
fn around() -> impl Iterator<Item = (f32, f32)> {
    over(-PI..PI).enumerate().map(|(n, angle)| {
        let (sin, cos) = arithmetic::sin_cos(angle);
        let radius = [0.01, 1.0, 50.0][n % 3];
        (radius * sin, radius * cos)
    })
}

fn in_f64(inputs: impl Iterator<Item = f32>) -> impl Iterator<Item = f64> {
    inputs.map(f64::from)
}

/// Counts sine, cosine and tangent on ±π, arc sine and cosine on ±1, and the square root on 0 to 100. These are the
/// ranges of a tilt, its sine, and a specific force squared.
fn functions(counter: &InstructionCounter) {
    let turn = || over(-PI..PI);
    let unit = || over(-1.0..1.0);
    let square = || over(0.0..100.0);
    // The part of each count that is the call and its argument.
    functions!(counter, turn(); "call alone": |x: f32| x;);
    functions!(counter, turn();
        "sin flight-core": |x: f32| arithmetic::sin_cos(x).0;
        "sin libm f32": |x: f32| libm::sinf(x);
        "sin micromath": |x: f32| F32Ext::sin(x);
        "cos flight-core": |x: f32| arithmetic::sin_cos(x).1;
        "cos libm f32": |x: f32| libm::cosf(x);
        "cos micromath": |x: f32| F32Ext::cos(x);
        "sin_cos flight-core": |x: f32| arithmetic::sin_cos(x);
        "sin_cos libm f32": |x: f32| libm::sincosf(x);
        "sin_cos micromath": |x: f32| F32Ext::sin_cos(x);
        "tan libm f32": |x: f32| libm::tanf(x);
        "tan micromath": |x: f32| F32Ext::tan(x);
    );
    functions!(counter, in_f64(turn());
        "sin libm f64": |x: f64| libm::sin(x);
        "cos libm f64": |x: f64| libm::cos(x);
        "sin_cos libm f64": |x: f64| libm::sincos(x);
        "tan libm f64": |x: f64| libm::tan(x);
    );
    functions!(counter, around();
        "atan2 flight-core": |p: (f32, f32)| arithmetic::atan2(p.0, p.1);
        "atan2 libm f32": |p: (f32, f32)| libm::atan2f(p.0, p.1);
        "atan2 micromath": |p: (f32, f32)| F32Ext::atan2(p.0, p.1);
    );
    functions!(counter, around().map(|(y, x)| (f64::from(y), f64::from(x)));
        "atan2 libm f64": |p: (f64, f64)| libm::atan2(p.0, p.1);
    );
    functions!(counter, unit();
        "asin libm f32": |x: f32| libm::asinf(x);
        "asin micromath": |x: f32| F32Ext::asin(x);
        "acos libm f32": |x: f32| libm::acosf(x);
        "acos micromath": |x: f32| F32Ext::acos(x);
    );
    functions!(counter, in_f64(unit());
        "asin libm f64": |x: f64| libm::asin(x);
        "acos libm f64": |x: f64| libm::acos(x);
    );
    functions!(counter, square();
        "sqrt flight-core": |x: f32| arithmetic::sqrt(x);
        "sqrt libm f32": |x: f32| libm::sqrtf(x);
        "sqrt micromath": |x: f32| F32Ext::sqrt(x);
    );
    functions!(counter, in_f64(square());
        "sqrt libm f64": |x: f64| libm::sqrt(x);
    );
}

/// Counts the algorithms that take samples: integration, estimators, prefilters.
fn samples(counter: &InstructionCounter) -> Result<(), ConfigError> {
    let params = fixed_input::config().params;
    let gyro = SensorModel::new(SensorFields::GYRO, params.gyro, SensorCalibration::NONE)?;
    let accel = SensorModel::new(SensorFields::ACCEL, params.accel, SensorCalibration::NONE)?;
    let mag = SensorModel::new(SensorFields::MAG, params.mag, SensorCalibration::NONE)?;
    let readings = move || {
        SLOTS.map(move |slot| {
            let imu = fixed_input::imu(slot);
            Reading {
                gyro: gyro.apply(imu.gyro),
                accel: accel.apply(imu.accel),
                mag: mag.apply(fixed_input::mag(slot).counts),
            }
        })
    };
    let turns = move || readings().map(|r| r.gyro * DT_S);
    integration(counter, "f32", turns);
    integration(counter, "f64", || turns().map(|v| vec3(f64::from(v.x), f64::from(v.y), f64::from(v.z))));
    prefilters(counter, readings)?;
    estimators(counter, readings)?;
    others(counter, readings);
    Ok(())
}

/// The readings of a slot's three sensors, in SI units.
#[derive(Clone, Copy)]
struct Reading {
    gyro: Vec3<f32>,
    accel: Vec3<f32>,
    mag: Vec3<f32>,
}

/// Counts the integration for each gyroscope sample. An algorithm with two or three samples turns the attitude only
/// with every second or third.
fn integration<T: Real, I: Iterator<Item = Vec3<T>>>(
    counter: &InstructionCounter,
    float: &str,
    turns: impl Fn() -> I,
) {
    #[inline(never)]
    fn euler<T: Real>(e: &mut EulerAngles<T>, turn: &Vec3<T>) {
        e.step(*turn);
    }
    #[inline(never)]
    fn coning<T: Real, const N: usize>(c: &mut Coning<T, N>, turn: &Vec3<T>) {
        c.step(*turn);
    }
    let mut e = EulerAngles { angles: Vec3::<T>::ZERO };
    row(
        counter,
        format_args!("integration Euler angles {float}"),
        euler::<T> as *const (),
        turns(),
        |turn| euler(&mut e, turn),
    );
    let mut c = Coning::<T, 1>::new(Quaternion::IDENTITY);
    row(
        counter,
        format_args!("integration 1 sample {float}"),
        coning::<T, 1> as *const (),
        turns(),
        |turn| coning(&mut c, turn),
    );
    let mut c = Coning::<T, 2>::new(Quaternion::IDENTITY);
    row(
        counter,
        format_args!("integration 2 samples {float}"),
        coning::<T, 2> as *const (),
        turns(),
        |turn| coning(&mut c, turn),
    );
    let mut c = Coning::<T, 3>::new(Quaternion::IDENTITY);
    row(
        counter,
        format_args!("integration 3 samples {float}"),
        coning::<T, 3> as *const (),
        turns(),
        |turn| coning(&mut c, turn),
    );
}

/// Counts the prefilters for each sample of nine channels.
fn prefilters<I: Iterator<Item = Reading>>(
    counter: &InstructionCounter,
    readings: impl Fn() -> I,
) -> Result<(), ConfigError> {
    #[inline(never)]
    fn none(r: &Reading) -> Reading {
        *r
    }
    #[inline(never)]
    fn pt1([gyro, accel, mag]: &mut [Pt1; 3], r: &Reading) -> Reading {
        Reading { gyro: gyro.step(r.gyro), accel: accel.step(r.accel), mag: mag.step(r.mag) }
    }
    #[inline(never)]
    fn second([gyro, accel, mag]: &mut [Prefilter; 3], r: &Reading) -> Reading {
        Reading { gyro: gyro.step(r.gyro), accel: accel.step(r.accel), mag: mag.step(r.mag) }
    }
    #[inline(never)]
    fn fourth([first, second]: &mut [[Prefilter; 3]; 2], r: &Reading) -> Reading {
        let [gyro, accel, mag] = first;
        let r = Reading { gyro: gyro.step(r.gyro), accel: accel.step(r.accel), mag: mag.step(r.mag) };
        let [gyro, accel, mag] = second;
        Reading { gyro: gyro.step(r.gyro), accel: accel.step(r.accel), mag: mag.step(r.mag) }
    }

    row(counter, "prefilter none", none as *const (), readings(), none);
    let mut filters = [Pt1::new(CUTOFF_HZ, RATE_HZ); 3];
    row(counter, "prefilter PT1", pt1 as *const (), readings(), |r| pt1(&mut filters, r));
    let bank = |section: Biquad| [Prefilter::new(Some(section)); 3];
    let mut filters = bank(Biquad::butterworth(CUTOFF_HZ as f32, RATE_HZ as f32)?);
    row(counter, "prefilter 2nd order", second as *const (), readings(), |r| second(&mut filters, r));
    let mut filters = butterworth_4(CUTOFF_HZ, RATE_HZ).map(bank);
    row(counter, "prefilter 4th order", fourth as *const (), readings(), |r| fourth(&mut filters, r));
    Ok(())
}

/// Counts the presets of flight-core, and the paper's filter on a quaternion.
fn estimators<I: Iterator<Item = Reading>>(
    counter: &InstructionCounter,
    readings: impl Fn() -> I,
) -> Result<(), ConfigError> {
    #[inline(never)]
    fn nine(estimator: &mut Estimator, r: &Reading) {
        estimator.update(r.gyro, r.accel, Some(r.mag), DT_S);
    }
    #[inline(never)]
    fn six(estimator: &mut Estimator, r: &Reading) {
        estimator.update(r.gyro, r.accel, None, DT_S);
    }
    /// The same function for one kind of filter only. It is not run: its address gives the code size.
    #[inline(never)]
    fn nine_only<F: Filter>(filter: &mut F, r: &Reading) {
        filter.update(r.gyro, r.accel, Some(r.mag), DT_S);
    }
    #[inline(never)]
    fn six_only<F: Filter>(filter: &mut F, r: &Reading) {
        filter.update(r.gyro, r.accel, None, DT_S);
    }
    fn code<F: Filter>(_: &F) -> [*const (); 2] {
        [nine_only::<F> as *const (), six_only::<F> as *const ()]
    }
    let quaternion = EstimatorParams::complementary(Kinematics::Quaternion, Weight::PAPER);
    for (name, params) in EstimatorParams::PRESETS.into_iter().chain([("paper on a quaternion", quaternion)])
    {
        let mut estimator = Estimator::new(&params)?;
        let [code_nine, code_six] = with_filter!(estimator.filter(), filter => code(filter));
        let nine_axis = format_args!("estimator {name} 9-axis");
        row(counter, nine_axis, code_nine, readings(), |r| nine(&mut estimator, r));
        let mut estimator = Estimator::new(&params)?;
        let six_axis = format_args!("estimator {name} 6-axis");
        row(counter, six_axis, code_six, readings(), |r| six(&mut estimator, r));
    }
    Ok(())
}

/// Counts the filters of `uf-ahrs` with their default parameters, in their axes: z up, and the magnetic field turned
/// likewise.
fn others<I: Iterator<Item = Reading>>(counter: &InstructionCounter, readings: impl Fn() -> I) {
    #[inline(never)]
    fn nine<F: Ahrs>(filter: &mut F, [gyro, accel, mag]: &[Vector3<f32>; 3]) {
        filter.update(*gyro, *accel, *mag);
    }
    #[inline(never)]
    fn six<F: Ahrs>(filter: &mut F, [gyro, accel, _]: &[Vector3<f32>; 3]) {
        filter.update_imu(*gyro, *accel);
    }
    fn both<F: Ahrs, I: Iterator<Item = [Vector3<f32>; 3]>>(
        counter: &InstructionCounter,
        name: &str,
        new: impl Fn() -> F,
        readings: impl Fn() -> I,
    ) {
        let mut f = new();
        row(counter, format_args!("estimator {name} 9-axis"), nine::<F> as *const (), readings(), |r| {
            nine(&mut f, r)
        });
        let mut f = new();
        row(counter, format_args!("estimator {name} 6-axis"), six::<F> as *const (), readings(), |r| {
            six(&mut f, r)
        });
    }
    let period = Duration::from_micros(u64::from(PERIOD_US));
    let up = |v: Vec3<f32>| Vector3::new(v.x, -v.y, -v.z);
    let readings = || readings().map(move |r| [up(r.gyro), up(r.accel), up(r.mag)]);
    both(counter, "Mahony", || Mahony::new(period, MahonyParams::default()), readings);
    both(counter, "Madgwick", || Madgwick::new(period, MadgwickParams::default()), readings);
    both(counter, "VQF", || Vqf::new(period, VqfParams::default()), readings);
}
