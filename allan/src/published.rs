//! Tests of the statistics and their bounds against published figures.
//!
//! The data are those of NIST SP 1065 (Riley 2008), section 12.4: nine frequencies from NBS Monograph 140,
//! annex 8.E (ten points of phase), and 1,000 frequencies from a congruential generator. Tables 30 and 31 have their
//! deviations. The bounds of the long series are from Stable32 1.60, as stored with the tests of allantools
//! (`tests/phasedat/phase_dat_*_octave.txt`; `PHASE.DAT` is the long series as phase), and from SP 1065's table 32.

use super::confidence::{Estimate, LEVEL, bounds};
use super::statistic::variances;
use super::{Phase, Statistic, noise};

const SHORT: [f64; 9] = [892.0, 809.0, 823.0, 798.0, 671.0, 644.0, 883.0, 903.0, 677.0];

fn long() -> Vec<f64> {
    let mut n: u64 = 1_234_567_890;
    let next = |_| {
        let value = n as f64 / 2_147_483_647.0;
        n = 16_807 * n % 2_147_483_647;
        value
    };
    (0..1000).map(next).collect()
}

fn deviation(phase: &Phase, statistic: Statistic, m: usize) -> (f64, usize) {
    let [variance] = variances(phase, statistic, &[m], 1, &|_, _| ())[..] else { panic!() };
    (variance.value.sqrt(), variance.terms)
}

/// Returns the sums of the same data, given as rate and as angle.
fn both(rate: &[f64]) -> [Phase; 2] {
    let mut angle = vec![0.0];
    rate.iter().for_each(|y| angle.push(angle[angle.len() - 1] + y));
    [Phase::of_rate(rate.to_vec(), 1.0), Phase::of_angle(angle, 1.0)]
}

#[test]
fn deviations_of_10_points_equal_nbs14() {
    for phase in both(&SHORT) {
        for (statistic, printed) in [
            (Statistic::Standard, ["91.22945", "115.8082"]),
            (Statistic::Overlapping, ["91.22945", "85.95287"]),
            (Statistic::Modified, ["91.22945", "74.78849"]),
            (Statistic::Hadamard, ["70.80607", "85.61487"]),
            (Statistic::Total, ["91.22945", "93.90379"]),
        ] {
            for (m, printed) in [1, 2].into_iter().zip(printed) {
                let digits = printed.split_once('.').unwrap().1.len();
                let ours = format!("{:.digits$}", deviation(&phase, statistic, m).0);
                assert_eq!(ours, printed, "{statistic:?} {m}");
            }
        }
    }
}

#[test]
fn deviations_of_1000_points_equal_nist_sp_1065() {
    for phase in both(&long()) {
        for (statistic, printed) in [
            (Statistic::Standard, ["2.922319e-1", "9.965736e-2", "3.897804e-2"]),
            (Statistic::Overlapping, ["2.922319e-1", "9.159953e-2", "3.241343e-2"]),
            (Statistic::Modified, ["2.922319e-1", "6.172376e-2", "2.170921e-2"]),
            (Statistic::Hadamard, ["2.943883e-1", "9.581083e-2", "3.237638e-2"]),
            (Statistic::Total, ["2.922319e-1", "9.134743e-2", "3.406530e-2"]),
        ] {
            for (m, printed) in [1, 10, 100].into_iter().zip(printed) {
                assert_eq!(
                    format!("{:.6e}", deviation(&phase, statistic, m).0),
                    printed,
                    "{statistic:?} {m}"
                );
            }
        }
    }
}

#[test]
fn bounds_equal_those_of_stable32() {
    let phase = Phase::of_rate(long(), 1.0);
    for (statistic, rows) in [
        (
            Statistic::Standard,
            &[
                (999, 2.8515e-1, 2.9223e-1, 2.9987e-1),
                (499, 1.9787e-1, 2.0510e-1, 2.1319e-1),
                (249, 1.4201e-1, 1.4943e-1, 1.5815e-1),
                (124, 1.0254e-1, 1.1013e-1, 1.1971e-1),
                (61, 5.6510e-2, 6.2381e-2, 7.0567e-2),
                (30, 4.9153e-2, 5.6233e-2, 6.7635e-2),
                (14, 2.7109e-2, 3.2550e-2, 4.3537e-2),
                (6, 2.6481e-2, 3.3855e-2, 5.5744e-2),
            ][..],
        ),
        (
            Statistic::Overlapping,
            &[
                (999, 2.8515e-1, 2.9223e-1, 2.9987e-1),
                (997, 1.9520e-1, 2.0102e-1, 2.0738e-1),
                (993, 1.3931e-1, 1.4479e-1, 1.5098e-1),
                (985, 1.0038e-1, 1.0570e-1, 1.1198e-1),
                (969, 5.7696e-2, 6.1915e-2, 6.7217e-2),
                (937, 4.3654e-2, 4.8082e-2, 5.4202e-2),
                (873, 3.1755e-2, 3.6237e-2, 4.3377e-2),
                (745, 2.3045e-2, 2.7674e-2, 3.7027e-2),
            ],
        ),
        (
            Statistic::Modified,
            &[
                (999, 2.8515e-1, 2.9223e-1, 2.9987e-1),
                (996, 1.5336e-1, 1.5821e-1, 1.6355e-1),
                (990, 1.0322e-1, 1.0780e-1, 1.1304e-1),
                (978, 6.9840e-2, 7.4192e-2, 7.9481e-2),
                (954, 3.8022e-2, 4.1376e-2, 4.5809e-2),
                (906, 3.0466e-2, 3.4255e-2, 3.9933e-2),
                (810, 2.3687e-2, 2.7871e-2, 3.5511e-2),
                (618, 1.4874e-2, 1.8669e-2, 2.8584e-2),
            ],
        ),
        (
            Statistic::Hadamard,
            &[
                (998, 2.8635e-1, 2.9439e-1, 3.0315e-1),
                (995, 1.9491e-1, 2.0125e-1, 2.0825e-1),
                (989, 1.3777e-1, 1.4368e-1, 1.5043e-1),
                (977, 1.0388e-1, 1.0987e-1, 1.1704e-1),
                (953, 5.6173e-2, 6.0638e-2, 6.6369e-2),
                (905, 4.0664e-2, 4.5095e-2, 5.1382e-2),
                (809, 2.9271e-2, 3.3824e-2, 4.1477e-2),
                (617, 2.3761e-2, 2.9147e-2, 4.1367e-2),
            ],
        ),
        (
            Statistic::Total,
            &[
                (999, 2.8707e-1, 2.9223e-1, 2.9768e-1),
                (999, 1.9592e-1, 2.0089e-1, 2.0625e-1),
                (999, 1.3947e-1, 1.4444e-1, 1.4998e-1),
                (999, 1.0039e-1, 1.0540e-1, 1.1126e-1),
                (999, 5.7732e-2, 6.1788e-2, 6.6839e-2),
                (999, 4.4255e-2, 4.8580e-2, 5.4484e-2),
                (999, 3.1639e-2, 3.5905e-2, 4.2546e-2),
                (999, 2.6406e-2, 3.1259e-2, 4.0383e-2),
                (999, 1.0734e-2, 1.3369e-2, 1.9924e-2),
            ],
        ),
    ] {
        for (k, &(terms, lower, sigma, upper)) in rows.iter().enumerate() {
            let m = 1 << k;
            let found = deviation(&phase, statistic, m);
            assert_eq!(found.1, terms, "{statistic:?} {m}");
            // The power law is identified if there are at least 30 averages; otherwise it is taken as white noise.
            // Stable32 found white noise at all m.
            let alpha = noise::exponent(&phase, m, statistic).unwrap_or(0);
            assert_eq!(alpha, 0, "{statistic:?} {m}");
            let edf = Estimate { statistic, alpha, m, sums: 1001 }.edf();
            let (from, to) = bounds(found.0, edf, 0.683);
            for (ours, printed) in [(from, lower), (found.0, sigma), (to, upper)] {
                // Stable32's χ² is an approximation with an error of up to 5·10⁻⁴.
                assert!((ours / printed - 1.0).abs() < 5e-4, "{statistic:?} {m}: {ours:e} for {printed:e}");
            }
        }
    }
}

/// SP 1065 uses a simpler formula for the edf (its table 5), 146.177; its χ² is rounded to about 1e-3.
#[test]
fn bounds_of_table_32_follow_from_its_degrees_of_freedom() {
    let (lower, upper) = bounds(9.159953e-2, 146.177, 0.95);
    assert!((lower / 8.223942e-2 - 1.0).abs() < 1e-3 && (upper / 1.035201e-1 - 1.0).abs() < 1e-3);
    let ours = Estimate { statistic: Statistic::Overlapping, alpha: 0, m: 10, sums: 1001 }.edf();
    assert!((ours / 146.177 - 1.0).abs() < 0.1, "{ours}");
}

/// The expected values are from allantools 2024.6 and scipy 1.17.
#[test]
fn edf_and_quantiles_equal_those_of_other_programs() {
    use Statistic::{Hadamard, Modified, Overlapping, Standard};
    for (statistic, alpha, m, sums, expected) in [
        (Overlapping, 0, 10, 1001, 135.0714051003793),
        (Modified, 0, 10, 1001, 94.6342584913727),
        (Hadamard, 0, 10, 1001, 113.69890813206813),
        (Standard, 0, 10, 1001, 66.98757687537804),
        (Overlapping, 0, 100, 1001, 12.814933422103863),
        (Overlapping, -2, 100, 1001, 7.753683175041299),
        (Overlapping, 1, 10, 1001, 247.30683347246276),
        (Overlapping, 2, 10, 1001, 507.1731225296442),
        (Overlapping, -1, 7, 1001, 163.57505138838792),
        (Modified, -1, 100, 10001, 93.06510705243349),
        (Hadamard, -2, 300, 1001, 1.1047571556965818),
        (Overlapping, 1, 300, 1001, 19.314998037067376),
        (Overlapping, 0, 1000, 1_000_001, 1497.7518759394727),
    ] {
        let ours = Estimate { statistic, alpha, m, sums }.edf();
        assert!((ours / expected - 1.0).abs() < 1e-9, "{statistic:?} {alpha} {m}: {ours} for {expected}");
    }
    for (edf, low, high) in [
        (0.5, 8.55619728e-4, 9.64265962e-1),
        (1.0, 0.0400695, 1.98699671),
        (2.3, 0.47846399, 4.14658384),
        (146.177, 129.11784453, 163.23656202),
        (1e5, 99552.78789551, 100447.21210509),
    ] {
        let (a, b) = bounds(1.0, edf, LEVEL);
        for (ours, expected) in [(edf / (b * b), low), (edf / (a * a), high)] {
            assert!((ours / expected - 1.0).abs() < 1e-5, "{edf}: {ours} for {expected}");
        }
    }
}

/// A mean of 10⁶ σ does not reduce the precision.
#[test]
fn large_mean_does_not_change_the_deviations() {
    use random::NormalStream;
    let mut stream = NormalStream::new(5, "mean", 0);
    let small: Vec<f64> = (0..2_000_000).map(|_| stream.draw()).collect();
    let large = small.iter().map(|y| y + 1e6).collect();
    let (small, large) = (Phase::of_rate(small, 1.0), Phase::of_rate(large, 1.0));
    for statistic in [Statistic::Standard, Statistic::Overlapping, Statistic::Modified, Statistic::Hadamard] {
        for m in [1, 64, 4096, 262_144] {
            let (a, b) = (deviation(&small, statistic, m).0, deviation(&large, statistic, m).0);
            // Adding the mean rounds the samples by 1e-10 σ.
            assert!((a / b - 1.0).abs() < 1e-9, "{statistic:?} {m}: {a} {b}");
        }
    }
}

#[test]
fn result_does_not_depend_on_number_of_threads() {
    use random::NormalStream;
    let mut stream = NormalStream::new(6, "threads", 0);
    let phase = Phase::of_rate((0..2_500_000).map(|_| stream.draw()).collect(), 1.0);
    let factors: Vec<usize> = (1..80).map(|k| k * 37).collect();
    for statistic in [Statistic::Overlapping, Statistic::Modified, Statistic::Total] {
        let on = |threads| variances(&phase, statistic, &factors[..40], threads, &|_, _| ());
        assert_eq!(on(1), on(3));
    }
}

#[test]
fn blocks_and_segments_give_the_direct_sum() {
    let y: Vec<f64> = (0..1_200_000_u64).map(|k| (k * k % 1009) as f64).collect();
    let phase = Phase::of_rate(y, 1.0);
    let x = phase.sums();
    let m = 3000;
    let by_hand =
        |n: usize, term: &dyn Fn(usize) -> f64| (0..n).map(term).map(|t| t * t).sum::<f64>() / n as f64;
    let p = x.len();
    let second = |k: usize| x[k + 2 * m] - 2.0 * x[k + m] + x[k];
    let overlapping = by_hand(p - 2 * m, &second) / (2.0 * (m * m) as f64);
    let third = |k: usize| x[k + 3 * m] - 3.0 * x[k + 2 * m] + 3.0 * x[k + m] - x[k];
    let hadamard = by_hand(p - 3 * m, &third) / (6.0 * (m * m) as f64);
    for (statistic, expected) in [(Statistic::Overlapping, overlapping), (Statistic::Hadamard, hadamard)] {
        let ours = deviation(&phase, statistic, m).0;
        assert!((ours * ours / expected - 1.0).abs() < 1e-12, "{statistic:?}");
    }
}
