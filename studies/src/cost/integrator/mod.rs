//! The study `integrator`: methods to integrate the vehicle's motion.

mod elliptic;
mod methods;
mod replay;
pub(super) mod top;

use super::timing::shortest_ns;
use super::{Axis, Options, Progress, Setting, Study};
use input::InputError;
use sim_host::attitude_error::AttitudeError;
use sim_host::dynamics::State;

use methods::{Fixed, dormand_prince};
use replay::{REFERENCE_STEPS, REFERENCE_TOLERANCE, Replay};
use top::Top;

/// Time for which a top is integrated, s.
const SECONDS: f64 = 10.0;
const FLIGHT: &str = "flight of the scene steps";

fn angle(a: &State, b: &State) -> f64 {
    AttitudeError::between(a.attitude, b.attitude).total_rad
}

/// Returns the state after [`SECONDS`] in steps of a fixed length.
fn integrated(top: &Top, method: Fixed, steps: u32) -> State {
    let h = SECONDS / f64::from(steps);
    (0..steps).fold(top.at(0.0), |state, k| method.step(top, f64::from(k) * h, &state, h))
}

fn row(problem: &'static str, series: &str, name: &str, error: f64) -> Setting {
    Setting {
        problem,
        series: series.into(),
        setting: format!("{series}, {name}"),
        error: Some(error),
        error_unit: "rad",
        ..Setting::default()
    }
}

fn on_tops(options: &Options, progress: Progress) -> Vec<Setting> {
    let steps: &[u32] = if options.quick {
        &[500, 2_000, 5_000, 10_000]
    } else {
        &[500, 1_000, 2_000, 5_000, 10_000, 20_000, 50_000, 100_000]
    };
    let tolerances: &[i32] =
        if options.quick { &[-6, -9, -12] } else { &[-4, -5, -6, -7, -8, -9, -10, -11, -12] };
    let mut settings = Vec::new();
    for (k, (problem, top)) in top::tops().into_iter().enumerate() {
        let (start, end) = (top.at(0.0), top.at(SECONDS));
        for method in Fixed::ALL {
            for &steps in steps {
                let error = angle(&integrated(&top, method, steps), &end);
                let name = format!("{} ms", 1e3 * SECONDS / f64::from(steps));
                let time = shortest_ns(options, || {
                    std::hint::black_box(integrated(std::hint::black_box(&top), method, steps));
                });
                settings.push(Setting {
                    host_ns: time.map(|ns| ns / SECONDS),
                    also: vec![("evaluations", f64::from(steps * method.evaluations()) / SECONDS)],
                    ..row(problem, method.name(), &name, error)
                });
            }
        }
        for &power in tolerances {
            let tolerance = libm::pow(10.0, f64::from(power));
            let run = || dormand_prince(&top, (0.0, SECONDS), &start, tolerance, 0.0);
            let (state, evaluations) = run();
            let time = shortest_ns(options, || {
                std::hint::black_box(run());
            });
            settings.push(Setting {
                host_ns: time.map(|ns| ns / SECONDS),
                also: vec![("evaluations", f64::from(evaluations) / SECONDS)],
                ..row(problem, "Dormand-Prince 5(4)", &format!("tolerance 1e{power}"), angle(&state, &end))
            });
        }
        progress(0.2 * (k + 1) as f64);
    }
    settings
}

fn in_flight(options: &Options, progress: Progress) -> Result<Vec<Setting>, InputError> {
    let replay = Replay::fly()?;
    // Fixed steps are judged by the adaptive method, and the adaptive method by fixed steps.
    let (for_fixed, _) = replay.adaptive(REFERENCE_TOLERANCE);
    let for_adaptive = replay.fixed(Fixed::Rkmk4, REFERENCE_STEPS);
    let worst = |states: &[State], reference: &[State]| {
        states.iter().zip(reference).map(|(a, b)| angle(a, b)).fold(0.0, f64::max)
    };
    let seconds = replay.seconds();
    let mut settings = Vec::new();
    // 1 ms to 0.1 ms.
    let fixed: &[u32] = if options.quick { &[1, 2] } else { &[1, 2, 4, 5, 10] };
    for method in Fixed::ALL {
        for &steps in fixed {
            let error = worst(&replay.fixed(method, steps), &for_fixed);
            let time = shortest_ns(options, || {
                std::hint::black_box(replay.fixed(method, steps));
            });
            settings.push(Setting {
                host_ns: time.map(|ns| ns / seconds),
                also: vec![("evaluations", 1e3 * f64::from(steps * method.evaluations()))],
                default: method == Fixed::Rk4 && steps == 1,
                ..row(FLIGHT, method.name(), &format!("{} ms", 1.0 / f64::from(steps)), error)
            });
        }
        progress(0.6 + 0.1 * settings.len() as f64 / fixed.len() as f64);
    }
    for &power in if options.quick { &[-6, -10][..] } else { &[-4, -6, -8, -10, -12][..] } {
        let run = || replay.adaptive(libm::pow(10.0, f64::from(power)));
        let (states, evaluations) = run();
        let time = shortest_ns(options, || {
            std::hint::black_box(run());
        });
        settings.push(Setting {
            host_ns: time.map(|ns| ns / seconds),
            also: vec![("evaluations", f64::from(evaluations) / seconds)],
            ..row(
                FLIGHT,
                "Dormand-Prince 5(4)",
                &format!("tolerance 1e{power}"),
                worst(&states, &for_adaptive),
            )
        });
    }
    Ok(settings)
}

/// Runs the study.
///
/// # Errors
/// The built-in scene `steps` cannot be read; this does not happen.
pub fn study(options: &Options, progress: Progress) -> Result<Study, InputError> {
    let mut settings = on_tops(options, progress);
    settings.extend(in_flight(options, progress)?);
    Ok(Study {
        name: "integrator",
        title: "Integrating the vehicle's motion",
        about: "The error is the angle between the computed and the true attitude: for a free asymmetric top after 10 s, \
                and for the vehicle in flight the largest of 16 comparisons, one a second."
            .into(),
        reference: "The top: Jacobi's elliptic functions for the rates and a quadrature for the precession; no \
                    differential equation is solved. The flight: the commands to the rotors as flown. Fixed steps are \
                    judged by Dormand-Prince with a tolerance of 1e-13, and Dormand-Prince by RKMK4 with steps of 1/8 ms. \
                    The two agree to 1e-11 rad."
            .into(),
        per: "a simulated second",
        axis: Axis::Host,
        axis_title: "time on this machine, ns per simulated second",
        settings,
        remarks: vec![
            "Rounding limits every method: to 1e-12 rad in 10 s, and to about 1e-9 for the top about its intermediate axis. \
             There the period depends on how much the momentum exceeds that of the separatrix, which is a millionth of it, so \
             that rounding is amplified a million times."
                .into(),
            "In flight a step cannot be longer than the millisecond between two commands, and an adaptive method must \
             restart at each command. So its advantage for a free body does not exist in flight."
                .into(),
        ],
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the convergence order from the errors of two step lengths, a factor of two apart: the median of the
    /// tops.
    fn order(method: Fixed, steps: u32) -> f64 {
        let mut orders = top::tops().map(|(_, top)| {
            let error = |steps| angle(&integrated(&top, method, steps), &top.at(SECONDS));
            libm::log2(error(steps) / error(2 * steps))
        });
        orders.sort_by(f64::total_cmp);
        println!("{method:?}: {orders:?}");
        orders[1]
    }

    #[test]
    fn adaptive_method_reaches_the_end_state() {
        for (name, top) in top::tops() {
            let (state, _) = dormand_prince(&top, (0.0, SECONDS), &top.at(0.0), 1e-10, 0.0);
            let error = angle(&state, &top.at(SECONDS));
            assert!(error < 1e-6, "{name}: {error}");
        }
    }

    #[test]
    fn convergence_orders_match_the_textbook() {
        for (method, steps, expected) in
            [(Fixed::SemiImplicitEuler, 20_000, 1.0), (Fixed::Rk4, 2_000, 4.0), (Fixed::Rkmk4, 2_000, 4.0)]
        {
            let order = order(method, steps);
            assert!((order - expected).abs() < 0.2, "{method:?}: order {order}");
        }
    }
}
