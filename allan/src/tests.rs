//! Tests of the fit on simulated records with known errors.

use flight_core::geometry::vec3;
use flight_core::prefilter::{Biquad, Prefilter};

use super::*;
use random::NormalStream;

fn white(seed: u64, sigma: f64) -> impl FnMut() -> f64 {
    let mut stream = NormalStream::new(seed, "allan", 0);
    move || sigma * stream.draw()
}

fn fit_of(samples: Vec<f64>, rate_hz: f64, step: Option<f64>) -> Fit {
    let phase = Phase::of_rate(samples, 1.0 / rate_hz);
    let factors = Taus::Octave.factors(Statistic::Overlapping.largest_factor(phase.samples()));
    fitted(&deviations(&phase, Statistic::Overlapping, &factors, 1, &|_, _| ()), phase.length_s(), step)
}

fn values(fit: &Fit) -> [Option<f64>; 5] {
    std::array::from_fn(|i| fit.found[i].value())
}

fn about(value: Option<f64>, expected: f64, within: f64) -> bool {
    value.is_some_and(|value| (value / expected - 1.0).abs() < within)
}

const N: f64 = 0.03;
const RATE_HZ: f64 = 100.0;

fn hour() -> std::ops::Range<usize> {
    0..360_000
}

#[test]
fn white_noise_gives_only_n_with_the_right_uncertainty() {
    let mut squares = 0.0;
    let seeds = 100;
    for seed in 0..seeds {
        let mut w = white(seed, N * RATE_HZ.sqrt());
        let fit = fit_of(hour().map(|_| w()).collect(), RATE_HZ, None);
        let [q, n, b, k, r] = values(&fit);
        assert_eq!([q, b, k, r], [None; 4], "seed {seed}: {fit:?}");
        let Found::Value { uncertainty, .. } = fit.found[1] else { panic!("{fit:?}") };
        let z = (n.unwrap() - N) / uncertainty;
        assert!(z.abs() < 4.0, "seed {seed}: {fit:?}");
        squares += z * z;
    }
    let rms = (squares / seeds as f64).sqrt();
    println!("errors of N are {rms:.2} of their uncertainty");
    assert!((0.2..1.3).contains(&rms), "{rms}");
}

#[test]
fn quantized_angle_gives_q_if_rounding_is_noise() {
    let fit_with = |quantum: f64| {
        let mut w = white(1, N * RATE_HZ.sqrt());
        let (mut angle, mut last) = (0.0, 0.0);
        let samples = hour().map(|_| {
            angle += w() / RATE_HZ;
            let read = (angle / quantum).round() * quantum;
            let rate = (read - last) * RATE_HZ;
            last = read;
            rate
        });
        fit_of(samples.collect(), RATE_HZ, None)
    };
    // The angle changes by 0.003 a sample, so a quantum takes fewer than three samples.
    let quantum = 0.008;
    let fit = fit_with(quantum);
    let [q, n, ..] = values(&fit);
    assert!(about(q, quantum / 12_f64.sqrt(), 0.1) && about(n, N, 0.03), "{fit:?}");
    // A quantum takes hundreds of samples: at short τ the rounding error depends on the angle, and the model does not
    // hold. N is still right.
    let [q, n, ..] = values(&fit_with(0.05));
    assert!(q.is_none() && about(n, N, 0.05), "{q:?} {n:?}");
}

#[test]
fn random_walk_and_ramp_are_found_with_white_noise() {
    let (k, r) = (0.002, 4e-5);
    let mut w = white(2, 1.0);
    let mut bias = 0.0;
    let samples: Vec<f64> = hour()
        .map(|_| {
            bias += k / RATE_HZ.sqrt() * w();
            bias + N * RATE_HZ.sqrt() * w()
        })
        .collect();
    let [q, n, _, found, _] = values(&fit_of(samples.clone(), RATE_HZ, None));
    assert!(q.is_none() && about(n, N, 0.03) && about(found, k, 0.3), "{n:?} {found:?}");
    let ramp = hour().map(|i| r * i as f64 / RATE_HZ + N * RATE_HZ.sqrt() * w());
    let [_, n, _, walk, found] = values(&fit_of(ramp.collect(), RATE_HZ, None));
    assert!(about(n, N, 0.03) && about(found, r, 0.1) && walk.is_none(), "{n:?} {walk:?} {found:?}");
}

#[test]
fn low_pass_filter_does_not_change_the_coefficients() {
    for (cutoff_hz, rate_hz) in [(30.0, 1000.0), (5.0, 100.0), (40.0, 100.0)] {
        let mut w = white(3, N * f64::sqrt(rate_hz));
        let filter = Biquad::butterworth(cutoff_hz, rate_hz as f32).unwrap();
        let mut filter = Prefilter::new(Some(filter));
        let samples =
            (0..(1800.0 * rate_hz) as usize).map(|_| f64::from(filter.step(vec3(w() as f32, 0.0, 0.0)).x));
        let fit = fit_of(samples.collect(), rate_hz, None);
        let [q, n, b, k, r] = values(&fit);
        assert!(about(n, N, 0.03) && [q, b, k, r] == [None; 4], "{cutoff_hz} Hz: {fit:?}");
        assert!(fit.note.is_some() && fit.range_s.unwrap().0 > 1.5 / rate_hz, "{fit:?}");
    }
}

#[test]
fn converter_steps_are_noise_or_give_no_fit() {
    let sigma = N * RATE_HZ.sqrt();
    for (steps, shown) in [(0.5, true), (1.5, true), (8.0, false)] {
        let step = steps * sigma;
        let mut w = white(4, sigma);
        let samples = hour().map(|_| ((w() + 0.23 * step) / step).round() * step);
        let fit = fit_of(samples.collect(), RATE_HZ, Some(step));
        if shown {
            // The rounding is noise of step²/12 a sample, and is part of the sensor's noise.
            let expected = N * (1.0 + steps * steps / 12.0).sqrt();
            let [q, n, b, k, r] = values(&fit);
            assert!(about(n, expected, 0.03) && [q, b, k, r] == [None; 4], "{steps}: {fit:?}");
        } else {
            let Found::Hidden { reason, .. } = &fit.found[1] else { panic!("{fit:?}") };
            assert!(reason.contains("steps") && values(&fit) == [None; 5], "{reason}");
        }
    }
}

#[test]
fn hidden_coefficient_has_a_right_upper_bound() {
    let mut w = white(5, N * RATE_HZ.sqrt());
    let mut bias = 0.0;
    let mut v = white(6, 1e-5 / RATE_HZ.sqrt());
    let samples = hour().map(|_| {
        bias += v();
        bias + w()
    });
    let fit = fit_of(samples.collect(), RATE_HZ, None);
    let Found::Hidden { at_most: Some(at_most), .. } = fit.found[3] else { panic!("{fit:?}") };
    assert!((1e-5..1e-3).contains(&at_most), "{at_most}");
}

#[test]
fn short_record_gives_a_reason() {
    let fit = fit_of(vec![1.0, 2.0, 4.0], 10.0, None);
    let Found::Hidden { reason, .. } = &fit.found[0] else { panic!("{fit:?}") };
    assert!(reason.starts_with("too short"), "{reason}");
}
