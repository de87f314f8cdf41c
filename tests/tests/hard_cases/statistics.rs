//! Records so long, with so large a mean, or with so much low-frequency noise that a plain sum loses the result.

use allan::{Phase, Point, Statistic, Taus, deviations};
use flight_core::geometry::{Quaternion, Vec3, vec3};
use random::NormalStream;
use sim_host::dynamics::{State, VehicleParams};
use sim_host::effects::sensor::AccelBiasInstability;
use sim_host::effects::{BuildContext, EffectParams, Snapshot};

/// Returns the overlapping Allan deviations at octaves.
fn octaves(samples: Vec<f64>, interval_s: f64) -> Vec<Point> {
    let phase = Phase::of_rate(samples, interval_s);
    let factors = Taus::Octave.factors(Statistic::Overlapping.largest_factor(phase.samples()));
    deviations(&phase, Statistic::Overlapping, &factors, 2, &|_, _| ())
}

/// Checks that every deviation differs from the expected one by at most 4.5 of its standard deviations, a share of
/// 1/√(2 edf) each, plus the share `known`.
fn check_deviations(points: &[Point], known: f64, expected: impl Fn(f64) -> f64) {
    for p in points.iter().filter(|p| p.edf > 5.0) {
        let off = p.deviation / expected(p.tau_s) - 1.0;
        let within = 4.5 / (2.0 * p.edf).sqrt() + known;
        assert!(off.abs() < within, "τ = {} s: relative error {off}, bound {within}", p.tau_s);
    }
}

/// Checks white noise of σ = 1 on a mean of 10⁶: σ(τ) is 1/√m at every m, and equals that of the noise without the
/// mean.
fn white_on_a_large_mean(samples: usize) {
    let deviations = |mean: f64| {
        let mut noise = NormalStream::new(8, "long", 0);
        octaves((0..samples).map(|_| mean + noise.draw()).collect(), 1.0)
    };
    let (without, with) = (deviations(0.0), deviations(1e6));
    assert!(with.last().unwrap().tau_s > samples as f64 / 6.0);
    check_deviations(&with, 0.0, |m| 1.0 / m.sqrt());
    for (without, with) in without.iter().zip(&with) {
        // The last digit of the mean, 1.2e-10 σ, is part of each sample.
        let difference = with.deviation / without.deviation - 1.0;
        assert!(difference.abs() < 1e-8, "τ = {} s: relative difference {difference:e}", with.tau_s);
    }
}

#[test]
fn noise_on_a_mean_of_1e6_sigma_keeps_its_deviation() {
    white_on_a_large_mean(4_000_000);
}

#[test]
#[ignore = "10⁸ samples: 0.8 GB, nearly a minute; .ci/nightly runs it"]
fn hundred_million_samples_on_a_mean_of_1e6_sigma() {
    white_on_a_large_mean(100_000_000);
}

#[test]
fn flicker_noise_is_flat_over_six_decades() {
    // 4·10⁷ samples at 10 Hz are 46 days. The generator's spectrum is within 7 % of 1/f (see its documentation), its
    // deviation within 3.5 %. Below four samples the deviation is that of a sampled process.
    let (rate_hz, samples) = (10.0, 40_000_000);
    let vehicle = VehicleParams::OS4;
    let duration_s = samples as f64 / rate_hz;
    let context =
        BuildContext { name: "accel.bias_instability", seed: 3, rate_hz, duration_s, vehicle: &vehicle };
    let mut flicker = AccelBiasInstability { b_m_s2: [1.0; 3] }.build(&context);
    let state = State {
        position: Vec3::ZERO,
        velocity: Vec3::ZERO,
        attitude: Quaternion::IDENTITY,
        rates: Vec3::ZERO,
    };
    let at = Snapshot {
        time_s: 0.0,
        state: &state,
        specific_force: vec3(0.0, 0.0, -9.80665),
        angular_acceleration: Vec3::ZERO,
        rotors: [0.0; 4],
    };
    let points = octaves((0..samples).map(|_| flicker.apply(Vec3::ZERO, &at).x).collect(), 1.0 / rate_hz);
    let level: Vec<Point> = points.into_iter().filter(|p| p.tau_s >= 0.4 && p.edf > 5.0).collect();
    let decades = (level.last().unwrap().tau_s / level[0].tau_s).log10();
    assert!(decades > 5.9, "{decades} decades");
    let plateau = (2.0 * std::f64::consts::LN_2 / std::f64::consts::PI).sqrt();
    check_deviations(&level, 0.035, |_| plateau);
}
