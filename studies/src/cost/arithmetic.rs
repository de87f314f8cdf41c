//! The study `arithmetic`: the functions of the fast loop, in four implementations.

use std::f32::consts::PI;
use std::hint::black_box;

use flight_core::arithmetic;
use twofloat::TwoFloat;

use super::timing::shortest_ns;
use super::{Axis, Options, Progress, Setting, Study, m4};
use input::InputError;

/// A function of one number, or of two.
type Function = fn(f32, f32) -> f64;

/// The implementations, by their names in `m4.toml`.
const KINDS: [&str; 4] = ["flight-core", "libm f32", "micromath", "libm f64"];

struct Problem {
    /// Its name in `m4.toml`.
    name: &'static str,
    title: &'static str,
    unit: &'static str,
    /// In the order of [`KINDS`].
    functions: [Function; 4],
    exact: fn(f32, f32) -> TwoFloat,
    /// Whether the error is relative to the value.
    relative: bool,
    inputs: fn(usize) -> Vec<(f32, f32)>,
}

fn two(x: f32) -> TwoFloat {
    TwoFloat::from(f64::from(x))
}

/// Returns every `stride`-th float of [2⁻²⁰, π] with both signs: dense where floats are dense.
fn angles(stride: usize) -> Vec<(f32, f32)> {
    let bits = libm::powf(2.0, -20.0).to_bits()..=PI.to_bits();
    bits.step_by(stride).map(f32::from_bits).flat_map(|x| [(x, 0.0), (-x, 0.0)]).collect()
}

/// Returns points in all directions, with radii from 1e-6 to 1e6.
fn points(stride: usize) -> Vec<(f32, f32)> {
    let count = 180_000_000 / stride;
    (0..count)
        .map(|k| {
            let angle = (k as f64 / count as f64 - 0.5) * std::f64::consts::TAU;
            let radius = libm::pow(10.0, (k % 13) as f64 - 6.0);
            ((radius * libm::sin(angle)) as f32, (radius * libm::cos(angle)) as f32)
        })
        .collect()
}

/// Returns every `stride`-th float of [2⁻²⁰, 2²⁰].
fn positive(stride: usize) -> Vec<(f32, f32)> {
    let bits = libm::powf(2.0, -20.0).to_bits()..=libm::powf(2.0, 20.0).to_bits();
    bits.step_by(stride).map(|bits| (f32::from_bits(bits), 0.0)).collect()
}

const PROBLEMS: [Problem; 4] = [
    Problem {
        name: "sin",
        title: "sine, ±π",
        unit: "rad",
        functions: [
            |x, _| arithmetic::sin_cos(x).0.into(),
            |x, _| libm::sinf(x).into(),
            |x, _| micromath::F32(x).sin().0.into(),
            |x, _| libm::sin(x.into()),
        ],
        exact: |x, _| two(x).sin(),
        relative: false,
        inputs: angles,
    },
    Problem {
        name: "cos",
        title: "cosine, ±π",
        unit: "rad",
        functions: [
            |x, _| arithmetic::sin_cos(x).1.into(),
            |x, _| libm::cosf(x).into(),
            |x, _| micromath::F32(x).cos().0.into(),
            |x, _| libm::cos(x.into()),
        ],
        exact: |x, _| two(x).cos(),
        relative: false,
        inputs: angles,
    },
    Problem {
        name: "atan2",
        title: "atan2, all around",
        unit: "rad",
        functions: [
            |y, x| arithmetic::atan2(y, x).into(),
            |y, x| libm::atan2f(y, x).into(),
            |y, x| micromath::F32(y).atan2(micromath::F32(x)).0.into(),
            |y, x| libm::atan2(y.into(), x.into()),
        ],
        exact: |y, x| two(y).atan2(two(x)),
        relative: false,
        inputs: points,
    },
    Problem {
        name: "sqrt",
        title: "square root",
        unit: "of the value",
        functions: [
            |x, _| arithmetic::sqrt(x).into(),
            |x, _| libm::sqrtf(x).into(),
            |x, _| micromath::F32(x).sqrt().0.into(),
            |x, _| libm::sqrt(x.into()),
        ],
        exact: |x, _| two(x).sqrt(),
        relative: true,
        inputs: positive,
    },
];

/// Returns the spacing of the f32 numbers at a value.
fn ulp(value: f64) -> f64 {
    let nearest = (value.abs() as f32).max(f32::MIN_POSITIVE);
    f64::from(f32::from_bits(nearest.to_bits() + 1)) - f64::from(nearest)
}

/// Returns the largest error, absolute or relative, and in units of the last place of an f32.
fn worst(problem: &Problem, function: Function, inputs: &[(f32, f32)], exact: &[TwoFloat]) -> (f64, f64) {
    inputs.iter().zip(exact).fold((0.0, 0.0), |(error, ulps), (&(a, b), exact)| {
        // Subtract the high part first, which is nearly exact, then the low part.
        let off = ((function(a, b) - exact.hi()) - exact.lo()).abs();
        // −π and π are the same angle.
        let off = if problem.name == "atan2" { off.min((off - std::f64::consts::TAU).abs()) } else { off };
        let value = exact.hi();
        let scaled = if problem.relative { off / value.abs() } else { off };
        (f64::max(error, scaled), f64::max(ulps, off / ulp(value)))
    })
}

/// Runs the study.
///
/// # Errors
/// None.
pub fn study(options: &Options, progress: Progress) -> Result<Study, InputError> {
    let stride = if options.quick { 9_973 } else { 997 };
    let mut settings = Vec::new();
    for (n, problem) in PROBLEMS.iter().enumerate() {
        let inputs = (problem.inputs)(stride);
        let exact: Vec<TwoFloat> = inputs.iter().map(|&(a, b)| (problem.exact)(a, b)).collect();
        // Use only as many inputs as fit into the cache.
        let timed = &inputs[..inputs.len().min(2000)];
        for (kind, function) in KINDS.iter().zip(problem.functions) {
            let (error, ulps) = worst(problem, function, &inputs, &exact);
            let time = shortest_ns(options, || {
                let function = black_box(function);
                black_box(timed.iter().map(|&(a, b)| function(a, b)).sum::<f64>());
            });
            let figure = m4::figure(&format!("arithmetic {} {kind}", problem.name));
            settings.push(Setting {
                problem: problem.title,
                series: (*kind).into(),
                setting: (*kind).into(),
                error: Some(error),
                error_unit: problem.unit,
                host_ns: time.map(|ns| ns / timed.len() as f64),
                m4_instructions: figure.map(|figure| figure.instructions),
                flash_bytes: figure.and_then(|figure| figure.flash_bytes),
                also: vec![("error_ulp", ulps)],
                default: *kind == "flight-core",
                ..Setting::default()
            });
        }
        progress((n + 1) as f64 / PROBLEMS.len() as f64);
    }
    Ok(Study {
        name: "arithmetic",
        title: "Functions of the fast loop",
        about: "The error is the largest over the range: for sine and cosine as components of a unit vector, so in rad; for \
                the square root relative to its value. In units of the last place it is large where the value is near 0, \
                which does not affect an attitude."
            .into(),
        reference: "Double-double arithmetic (the crate twofloat, at least 22 digits), which is itself tested against \
                    published digits. None of the four implementations uses it."
            .into(),
        per: "a call",
        axis: Axis::M4,
        axis_title: "instructions on the Cortex-M4F",
        settings,
        remarks: vec![
            "`flight-core` computes sine and cosine together: its instructions for one are those for both."
                .into(),
            "Times include a call through a pointer, which takes most of them: on this machine the implementations hardly \
             differ."
                .into(),
            "`libm f32` is exact to the last place because it computes in f64, which this chip does in software: it costs \
             25 times as much as `flight-core` for a third of the error. For `flight-core` the square root is a single \
             instruction, and correctly rounded: `libm f32` and `micromath` cost more and are not more accurate."
                .into(),
        ],
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reference_has_the_published_digits() {
        // sin 1, cos 1 (OEIS A049469, A049470), atan 2 (A105199), √2 (A002193): the nearest f64, and the remainder.
        for (ours, digits, rest) in [
            (two(1.0).sin(), 0.841_470_984_807_896_5, 1.776_845_092_935_536e-18),
            (two(1.0).cos(), 0.540_302_305_868_139_8, -4.760_954_612_604_417e-17),
            (two(2.0).atan2(two(1.0)), 1.107_148_717_794_090_4, 9.404_471_373_566_38e-17),
            (two(2.0).sqrt(), std::f64::consts::SQRT_2, -9.667_293_313_452_913e-17),
        ] {
            let off = (ours.hi() - digits) + (ours.lo() - rest);
            assert!(off.abs() < 1e-22, "{ours:?}: {off:e} from {digits} + {rest:e}");
        }
    }

    #[test]
    fn kernel_errors_match_their_documentation() {
        let options = Options { quick: true, timed: false, recordings: None };
        let study = study(&options, &|_| ()).unwrap();
        let error = |problem: usize, kind: &str| {
            let of = study.of(PROBLEMS[problem].title).find(|s| s.series == kind).unwrap();
            (of.error.unwrap(), of.figure("error_ulp").unwrap())
        };
        assert!(error(0, "flight-core").1 <= 2.0 && error(1, "flight-core").1 <= 2.0);
        assert!(error(2, "flight-core").0 <= 4e-7);
        assert!(error(3, "flight-core").1 <= 0.5 && error(3, "libm f32").1 <= 0.5);
        // The reference tells poor and good implementations apart.
        assert!(error(0, "micromath").0 > 1e-4 && error(0, "libm f64").0 < 2e-16);
    }
}
